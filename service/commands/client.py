"""A service as the commands talk to it, somewhere else or a private one in this process."""

import json
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias
from urllib.parse import quote

import httpx
import orjson

from service.commands.errors import FAILED, CommandError, RefusedError

KEY = "RICOCHET_API_KEY"
"""Variable with the key of a service: a flag could be read in the list of processes."""
TIMEOUT = httpx.Timeout(120.0, connect=10.0)
"""Longer than a single query may take. [s]"""
PAUSES = (1.0, 2.0, 4.0, 8.0, 10.0, 10.0, 10.0)
"""Before a service that does not answer any more is asked again: it may be starting anew. [s]"""
LONGEST_PAUSE = 60.0
"""Before one that is busy is. [s]"""
BUSY = frozenset({429, 503})
"""Statuses that are over soon."""
PAGE = 1000
JSON = {"Content-Type": "application/json"}

Content: TypeAlias = Callable[[], "bytes | Iterable[bytes]"]
"""Gives the body of a request, once more each time it is sent again."""


@contextmanager
def connect(address: str, **options: Any) -> Iterator["Client"]:
    """Talk to the service at this address.

    Raises
    ------
    CommandError
        If it is no address.
    """
    key = os.environ.get(KEY)
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    try:
        http = httpx.Client(base_url=address, headers=headers, timeout=TIMEOUT, **options)
        if http.base_url.scheme not in {"http", "https"} or not http.base_url.host:
            raise httpx.InvalidURL("must be http://HOST:PORT")
    except (httpx.InvalidURL, ValueError) as error:
        raise CommandError(f"{address}: no address of a service: {error}") from None
    with http:
        yield Client(http, address)


class Client:
    """Asks a service; waits if it is busy, or away for a moment.

    Parameters
    ----------
    http
        With its address and its key.
    address
        For people.
    """

    def __init__(self, http: httpx.Client, address: str) -> None:
        self._http = http
        self._address = address
        self._reached = False

    def compute(self, operation: str, body: dict[str, Any]) -> bytes:
        """Return the answer to one case."""
        content = encoded(body)
        return self._ask("POST", f"/{operation}", lambda: content, JSON).content

    def submit(self, path: str, content: Content, media_type: str, token: str) -> dict[str, Any]:
        """Hand in many cases as a job; sent again with the same token they make no second one."""
        headers = {"Content-Type": media_type, "Prefer": "respond-async", "Idempotency-Key": token}
        return parsed(self._ask("POST", path, content, headers))

    def job(self, name: str) -> dict[str, Any]:
        """Return a job."""
        return parsed(self._ask("GET", path_of(name)))

    def jobs(self) -> list[dict[str, Any]]:
        """Return the jobs, the newest first."""
        found: list[dict[str, Any]] = parsed(self._ask("GET", "/jobs"))["jobs"]
        return found

    def page(self, name: str, cursor: str) -> dict[str, Any]:
        """Return results of a job that are ready, `next` with them if there is more to come."""
        return parsed(self._ask("GET", f"{path_of(name)}/results?limit={PAGE}&cursor={cursor}"))

    def cancel(self, name: str) -> dict[str, Any]:
        """End a job."""
        return parsed(self._ask("POST", f"{path_of(name)}/cancel"))

    def delete(self, name: str) -> None:
        """End a job and forget it."""
        self._ask("DELETE", path_of(name))

    def _ask(
        self, method: str, path: str, content: Content | None = None, headers: dict[str, str] | None = None
    ) -> httpx.Response:
        """Return the answer to a request that may be sent again.

        Raises
        ------
        RefusedError
            If it is a problem.
        CommandError
            If there is no answer.
        """
        for pause in (*PAUSES, None):
            try:
                response = self._http.request(method, path, content=content() if content else None, headers=headers)
            except httpx.TransportError as error:
                if pause is None or not self._reached:
                    why = str(error) or type(error).__name__
                    raise CommandError(f"no service answers at {self._address}: {why}", FAILED) from None
                time.sleep(pause)
                continue
            self._reached = True
            if response.is_success:
                return response
            if pause is None or response.status_code not in BUSY:
                raise refusal(response)
            time.sleep(pause_of(response))
        raise AssertionError("the last try ends it")


def path_of(name: str) -> str:
    """Return the path of a job, whatever somebody calls one."""
    return f"/jobs/{quote(name, safe='')}"


def encoded(body: dict[str, Any]) -> bytes:
    """Return a body as JSON; NaN stays, so that the service names the field that holds it."""
    return json.dumps(body).encode()


def parsed(response: httpx.Response) -> dict[str, Any]:
    """Return the object that a service has answered.

    Raises
    ------
    CommandError
        If it is none: then whatever has answered is something else.
    """
    try:
        content = orjson.loads(response.content)
    except orjson.JSONDecodeError:
        content = None
    if not isinstance(content, dict):
        raise CommandError(f"what answers at {response.url} is no ricochet service", FAILED)
    return content


def refusal(response: httpx.Response) -> RefusedError:
    """Return the problem that a service has answered, or one in its place."""
    problem: Any = None
    if response.headers.get("content-type", "").startswith("application/problem+json"):
        problem = parsed(response)
    return RefusedError(problem or {"title": f"{response.status_code} {response.reason_phrase}"})


def pause_of(response: httpx.Response) -> float:
    """Return how long a busy service wants to be left alone. [s]"""
    told = response.headers.get("Retry-After", "")
    return min(float(told) if told.isdigit() else 1.0, LONGEST_PAUSE)
