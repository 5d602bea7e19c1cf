"""A client that comes back: when the server is gone, or says that it has no time, it asks again."""

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from types import TracebackType
from typing import Any

import httpx
import orjson

from benchmarks.stress.faults_found import Found

PATIENCE_SECONDS = 120.0
"""For a server that is started anew, on a busy machine."""
PAUSE_SECONDS = 0.2
LATER = {429, 503}
UNDERWAY = {"accepted", "running"}


class Session:
    """Connections of one client with one key. A context manager, which closes them.

    Parameters
    ----------
    found
        Told of answers that should not be.
    answered
        Counts the answers by status, and requests that were broken off.
    """

    def __init__(self, url: str, token: str, found: Found, answered: Counter[str]) -> None:
        headers = {"Authorization": f"Bearer {token}"}
        self._client = httpx.Client(base_url=url, headers=headers, timeout=60.0, trust_env=False)
        self._found = found
        self._answered = answered

    def __enter__(self) -> "Session":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self._client.close()

    def ask(self, method: str, path: str, right: set[int] | None = None, **request: Any) -> httpx.Response:
        """Ask until there is an answer; its status is to be one of these, 200 unless told.

        Raises
        ------
        RuntimeError
            If there is none for too long.
        """
        deadline = time.monotonic() + PATIENCE_SECONDS
        while time.monotonic() < deadline:
            try:
                answer = self._client.request(method, path, **request)
            except httpx.TransportError:
                self._answered["broken off"] += 1
            else:
                self._answered[str(answer.status_code)] += 1
                if answer.status_code not in LATER:
                    told = f"{method} {path} was answered {answer.status_code}: {answer.content[:300]!r}"
                    self._found.claim(answer.status_code in (right or {200}), told)
                    return answer
            time.sleep(PAUSE_SECONDS)
        raise RuntimeError(f"{method} {path} was not answered")

    def get(self, path: str, accept: str = "application/json") -> httpx.Response:
        """Get something in this form."""
        return self.ask("GET", path, headers={"Accept": accept})

    def events(self, path: str) -> Iterator[dict[str, Any]]:
        """Yield the job whenever it changes, to its end, over restarts too: from the event seen last on."""
        deadline, last = time.monotonic() + PATIENCE_SECONDS, ""
        while time.monotonic() < deadline:
            with suppress(httpx.TransportError), self._client.stream("GET", path, headers=seen(last)) as stream:
                if stream.status_code not in LATER:
                    self._found.claim(stream.status_code == 200, f"{path} was answered {stream.status_code}")
                for line in stream.iter_lines():
                    if line.startswith("id:"):
                        last = line[3:].strip()
                    elif line.startswith("data:"):
                        job = orjson.loads(line[5:])
                        yield job
                        if job["status"] not in UNDERWAY:
                            return
            self._answered["event stream broken off"] += 1
            time.sleep(PAUSE_SECONDS)
        raise RuntimeError(f"{path} did not come to an end")


def seen(event: str) -> dict[str, str]:
    """The header of a stream that is taken up again after this event."""
    return {"Last-Event-ID": event} if event else {}
