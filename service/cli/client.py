"""HTTP client for a service on another machine or in this process."""

import json
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from ipaddress import ip_address
from typing import Any, TypeAlias
from urllib.parse import quote

import httpx
import orjson

from service.cli.arguments import FAILED, CommandError, RefusedError, reason_of

API_KEY = "RICOCHET_API_KEY"
"""Environment variable with the API key. A flag would be visible in the list of processes."""
TIMEOUT = httpx.Timeout(660.0, connect=10.0)
"""Timeouts of a request [s], above the longest limits of an answer: 30 s in the queue, and 600 s for the two studies of
a verdict or a report, with the default settings of the service."""
RETRY_PAUSES = (1.0, 2.0, 4.0, 8.0, 10.0, 10.0, 10.0)
"""Backoff before each retry after a lost connection [s]. The sum of 45 s is enough for a restart of the service, which
takes seconds, unless the service has to compile the solver, which takes about a minute."""
LONGEST_PAUSE = 60.0
"""Longest wait for a `Retry-After` [s]. Without a limit, a wrong value could stop the command for hours."""
BUSY = frozenset({429, 503})
"""Statuses after which a request is retried."""
NOT_IN_KEYS = re.compile(r"[^!-~]|[\"']")
"""Characters that an API key must not contain: all but printable ASCII, because the key is sent in a header, and
quotes, which are usually copied by mistake from an environment file."""
PROXIES = ("ALL_PROXY", "HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY")
"""Environment variables from which httpx reads proxies."""
CERTIFICATES = ("SSL_CERT_FILE", "SSL_CERT_DIR")
"""Environment variables from which httpx reads certificates."""
PAGE_SIZE = 1000
"""Number of items requested per page, the most that a service sends."""
UNFINISHED = frozenset({"accepted", "running"})
"""Statuses of a job that has not ended."""
POLL_SECONDS = 0.2
"""Interval between requests for the state of a job [s]. An arbitrary choice: a progress bar moves five times a
second."""
JSON, PARQUET = "application/json", "application/vnd.apache.parquet"

Content: TypeAlias = Callable[[], "bytes | Iterable[bytes]"]
"""Function that returns a request body. It is called again when a request is repeated, since a stream can be read only
once."""


@contextmanager
def connect(address: str, *, socket: str | None = None, **options: Any) -> Iterator["Client"]:
    """Open a client for the service at an address, or at the path of a Unix domain socket.

    Errors about an invalid address or proxy do not quote the messages of httpx, which may contain passwords.

    Raises
    ------
    CommandError
        If the address is not an HTTP URL, the API key has an invalid character, or a variable for proxies or
        certificates is invalid.
    """
    # A key that was read from a file often ends with a line break, which no header may contain.
    key = os.environ.get(API_KEY, "").strip()
    if stray := NOT_IN_KEYS.search(key):
        raise CommandError(f"{API_KEY}: character {stray.start() + 1} cannot be part of a key; copy the key anew")
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    try:
        url = httpx.URL(address)
    except httpx.InvalidURL:
        # An empty address is refused by the check below, with the same message as other invalid addresses.
        url = httpx.URL()
    if url.scheme not in {"http", "https"} or not url.host:
        raise CommandError(f"{without_secrets(address)}: not the address of a service: must be http://HOST:PORT")
    try:
        transport = httpx.HTTPTransport(**direct) if (direct := direct_transport(url, socket)) else None
        http = httpx.Client(base_url=url, headers=headers, timeout=TIMEOUT, transport=transport, **options)
    except (httpx.InvalidURL, ImportError, OSError, ValueError) as error:
        raise CommandError(wrong_variables(error)) from None
    with http:
        yield Client(http, without_secrets(address), socket)


def set_variables(names: Iterable[str]) -> list[str]:
    """Return which of the named environment variables are set, ignoring case as httpx does."""
    return [name for name in os.environ if name.upper() in names and os.environ[name]]


def direct_transport(url: httpx.URL, socket: str | None) -> dict[str, Any]:
    """Return the options of a transport that bypasses proxies. They are empty unless the service is on this machine."""
    loopback = url.host == "localhost"
    with suppress(ValueError):
        loopback = loopback or ip_address(url.host).is_loopback
    return {"uds": socket, "trust_env": url.scheme == "https"} if loopback or socket else {}


def wrong_variables(error: Exception) -> str:
    """Return the message for invalid proxy or certificate variables.

    It omits their values, which may contain passwords.
    """
    names = set_variables(CERTIFICATES if isinstance(error, OSError) else PROXIES)
    if isinstance(error, ImportError):
        names = [name for name in names if os.environ[name].startswith("socks")]
        detail = "names a SOCKS proxy, which needs the package httpx[socks]"
    elif isinstance(error, OSError):
        detail = f"names no certificates: {reason_of(error)}"
    else:
        detail = "must be the address of a proxy; in NO_PROXY the names of hosts, ::1 without brackets"
    return f"{' or '.join(names) or 'the proxy of the system'} {detail}"


class Client:
    """Client that retries requests while the service is busy or restarting.

    Parameters
    ----------
    http
        HTTP client with the base URL and the API key.
    address
        Address for error messages.
    socket
        Path of the socket of a service in this process.
    """

    def __init__(self, http: httpx.Client, address: str, socket: str | None = None) -> None:
        self._http = http
        self._address = address
        self._socket = socket
        self._reached = False

    def asynchronous(self) -> httpx.AsyncClient:
        """Return an asynchronous client of the same service, whose requests can be cancelled."""
        direct = direct_transport(self._http.base_url, self._socket)
        transport = httpx.AsyncHTTPTransport(**direct) if direct else None
        return httpx.AsyncClient(
            base_url=self._http.base_url, headers=self._http.headers, timeout=TIMEOUT, transport=transport
        )

    async def compute_until_cancelled(
        self, http: httpx.AsyncClient, operation: str, body: dict[str, Any]
    ) -> dict[str, Any]:
        """Return the answer to one case. If the service is busy, raise its problem with a field `retry_after_s`."""
        try:
            response = await http.post(path_to(operation), content=dumps(body), headers={"Content-Type": JSON})
        except httpx.TransportError as lost:
            raise self._unreachable(lost) from None
        if response.is_success:
            return parse(response)
        error = refusal(response)
        wait = {"retry_after_s": retry_pause(response)} if response.status_code in BUSY else {}
        raise RefusedError({**error.problem, **wait})

    def compute(self, operation: str, body: dict[str, Any]) -> bytes:
        """Return the answer to one case as JSON, or a report as HTML."""
        content = dumps(body)
        return self._send("POST", path_to(operation), lambda: content, {"Content-Type": JSON}).content

    def submit(self, path: str, content: Content, media_type: str, token: str) -> dict[str, Any]:
        """Submit many cases as a job. A request repeated with the same token does not create a second job."""
        headers = {"Content-Type": media_type, "Prefer": "respond-async", "Idempotency-Key": token}
        return parse(self._send("POST", path, content, headers))

    def job(self, job_id: str) -> dict[str, Any]:
        """Return the state of a job."""
        return parse(self._send("GET", path_of(job_id)))

    def job_at_its_end(self, job_id: str) -> dict[str, Any]:
        """Wait until a job has ended, and return its state.

        The last result may become available shortly before the end.
        """
        while (job := self.job(job_id))["status"] in UNFINISHED:
            time.sleep(POLL_SECONDS)
        return job

    def jobs(self) -> list[dict[str, Any]]:
        """Return the states of all jobs, the newest first."""
        found: list[dict[str, Any]] = []
        cursor = ""
        while True:
            page = parse(self._send("GET", f"/jobs?limit={PAGE_SIZE}&cursor={cursor}"))
            found += page["jobs"]
            if "next" not in page:
                return found
            cursor = page["next"]

    def result(self, key: str) -> bytes:
        """Return the result stored under a key, as JSON."""
        return self._send("GET", f"/results/{quote(key, safe='')}").content

    def page(self, job_id: str, cursor: str) -> dict[str, Any]:
        """Return one page of the available results of a job. It has `next` if more results may follow."""
        return parse(self._send("GET", f"{path_of(job_id)}/results?limit={PAGE_SIZE}&cursor={cursor}"))

    def parquet(self, job_id: str, limit: int | None = None) -> bytes:
        """Return the summaries of the available results of a job, at most `limit` of them, as a Parquet file."""
        path = f"{path_of(job_id)}/results" + ("" if limit is None else f"?limit={limit}")
        return self._send("GET", path, headers={"Accept": PARQUET}).content

    def cancel(self, job_id: str) -> dict[str, Any]:
        """Cancel a job, and return its state."""
        return parse(self._send("POST", f"{path_of(job_id)}/cancel"))

    def delete(self, job_id: str) -> None:
        """Cancel and delete a job."""
        self._send("DELETE", path_of(job_id))

    def _send(
        self, method: str, path: str, content: Content | None = None, headers: dict[str, str] | None = None
    ) -> httpx.Response:
        """Send a request, retrying it while the service is busy or restarting, and return the response.

        Raises
        ------
        RefusedError
            If the response has the status of an error.
        CommandError
            If there is no response.
        """
        # The last attempt has no pause after it, and its error is final.
        for pause in (*RETRY_PAUSES, None):
            try:
                # A request may be repeated: a computation gives the same answer, and jobs have an idempotency key.
                response = self._http.request(method, path, content=content() if content else None, headers=headers)
            except httpx.TransportError as error:
                # A service that has never answered is more likely absent than restarting, so the request is not
                # retried.
                if pause is None or not self._reached:
                    raise self._unreachable(error) from None
                time.sleep(pause)
                continue
            # Any response, even an error, shows that a service is running.
            self._reached = True
            if response.is_success:
                return response
            if pause is None or response.status_code not in BUSY:
                raise refusal(response)
            time.sleep(retry_pause(response))
        raise AssertionError("the last attempt returns or raises")

    def _unreachable(self, error: httpx.TransportError) -> CommandError:
        quotes = isinstance(error, httpx.LocalProtocolError)  # This error may quote the header with the key.
        reason = type(error).__name__ if quotes else reason_of(error) or type(error).__name__
        if not direct_transport(self._http.base_url, self._socket):
            names = set_variables(("ALL_PROXY", f"{self._http.base_url.scheme.upper()}_PROXY"))
            reason += f" (through the proxy of {' or '.join(names)})" if names else ""
        return CommandError(f"no service answers at {self._address}: {reason}", FAILED)


def without_secrets(address: str) -> str:
    """Return an address without the parts that may contain a password or a key."""
    # Passwords and keys can only be in user information, query and fragment; any other address is shown as typed.
    if not any(mark in address for mark in "@?#"):
        return address
    try:
        url = httpx.URL(address)
    except httpx.InvalidURL:
        return "the address, not shown as it may hold a password"
    return f"{url.scheme}://{url.netloc.decode()}"


def path_to(operation: str) -> str:
    """Return the route of an operation."""
    return f"/{operation.replace('_', '/')}"


def path_of(job_id: str) -> str:
    """Return the path of a job, with reserved characters of its id quoted."""
    return f"/jobs/{quote(job_id, safe='')}"


def dumps(body: dict[str, Any]) -> bytes:
    """Encode a body as JSON. NaN is written as such, so that the service names the field that holds it."""
    return json.dumps(body).encode()


def parse(response: httpx.Response) -> dict[str, Any]:
    """Return the JSON object in a response.

    Raises
    ------
    CommandError
        If the response is not a JSON object, which shows that the server is not a ricochet service.
    """
    try:
        content = orjson.loads(response.content)
    except orjson.JSONDecodeError:
        content = None
    if not isinstance(content, dict):
        raise CommandError(f"the server at {without_secrets(str(response.url))} is not a ricochet service", FAILED)
    return content


def refusal(response: httpx.Response) -> RefusedError:
    """Return an error with the problem document of a response, or with one made from its status."""
    problem: Any = None
    if response.headers.get("content-type", "").startswith("application/problem+json"):
        problem = parse(response)
    problem = problem or {"type": "about:blank", "title": f"{response.status_code} {response.reason_phrase}"}
    # The message names the variable, which is where the user has to change the key.
    if response.status_code == HTTPStatus.UNAUTHORIZED:
        reason = problem.get("detail", "another API key") if os.environ.get(API_KEY) else "not set"
        problem = {**problem, "status": response.status_code, "detail": f"{API_KEY}: {reason}"}
    return RefusedError(problem)


def retry_pause(response: httpx.Response) -> float:
    """Return the time to wait before a request is retried [s]."""
    seconds = response.headers.get("Retry-After", "")
    # `Retry-After` may also be a date, which this service does not send; the pause is then one second.
    return min(float(seconds) if seconds.isdecimal() else 1.0, LONGEST_PAUSE)
