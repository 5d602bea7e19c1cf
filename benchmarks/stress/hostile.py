"""Ten thousand bodies that are wrong: none makes the service fail, or keeps it from answering."""

import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPConnection, HTTPException, HTTPResponse
from typing import Any

import orjson

from benchmarks.stress.bodies import to_arguments
from benchmarks.stress.lines import Line
from benchmarks.stress.mutations import Mutant, mutants
from benchmarks.stress.servers import Server, service
from service.schemas.examples import PAPER
from service.schemas.quantities import degrees
from solver import critical_angle

CLIENTS = 4
HANG_SECONDS = 30.0
TASK_SECONDS = 1.0
"""For a query: some bodies are right, and ask for minutes of work."""
SEED = 8
SHOWN = 10


class Tally:
    """What became of the bodies."""

    def __init__(self, bodies: Iterator[Mutant]) -> None:
        self.statuses: Counter[str] = Counter()
        self.failures: list[dict[str, Any]] = []
        self.slowest = 0.0
        self._bodies = bodies
        self._lock = threading.Lock()

    def next(self) -> Mutant | None:
        """Next body; None if there is none left."""
        with self._lock:
            return next(self._bodies, None)

    def note(self, mutant: Mutant, status: int | str, content: bytes, seconds: float) -> None:
        """Note an answer, or why there is none."""
        with self._lock:
            self.statuses[str(status)] += 1
            self.slowest = max(self.slowest, seconds)
            if isinstance(status, str) or status >= 500:
                told = {"path": mutant.path, "body": repr(mutant.body[:2_000]), "answer": repr(content[:500])}
                self.failures.append({"status": status, "seconds": seconds, **told})


def measure_hostile(count: int) -> list[Line]:
    """Line 8."""
    print(f"hostile: {count:,} bodies", file=sys.stderr)
    begin = time.perf_counter()
    with service(task_seconds=str(TASK_SECONDS)) as server:
        tally = Tally(mutants(count, SEED))
        with ThreadPoolExecutor(CLIENTS) as clients:
            for client in [clients.submit(_send_all, server, tally) for _ in range(CLIENTS)]:
                client.result()
        right = _answers_paper(server)
    for failure in tally.failures[:SHOWN]:
        print(failure, file=sys.stderr)
    failed, told = len(tally.failures), "right" if right else "wrong"
    return [
        Line(
            number=8,
            what=f"{count:,} mutated bodies, JSON and JSONL, to all routes that take one",
            required="no 5xx, no hang, and the paper's case is right after them",
            measured=f"{failed} failed, slowest {tally.slowest:.1f} s, the paper's case {told}",
            held=not failed and right,
            details={
                "statuses": dict(tally.statuses),
                "failures": tally.failures[:SHOWN],
                "duration_s": time.perf_counter() - begin,
            },
        )
    ]


def _send_all(server: Server, tally: Tally) -> None:
    connection = server.connect(HANG_SECONDS)
    while (mutant := tally.next()) is not None:
        begin = time.perf_counter()
        try:
            status, content = _send(connection, mutant)
        except (OSError, HTTPException):  # the server may close a connection it has answered on
            connection.close()
            try:
                status, content = _send(connection, mutant)
            except (OSError, HTTPException) as error:
                connection.close()
                tally.note(mutant, type(error).__name__, b"", time.perf_counter() - begin)
                continue
        tally.note(mutant, status, content, time.perf_counter() - begin)
        if status == 202:
            _ask(connection, "POST", orjson.loads(content)["links"]["cancel"]).read()
    connection.close()


def _send(connection: HTTPConnection, mutant: Mutant) -> tuple[int, bytes]:
    headers = {"Content-Type": mutant.media_type} | ({"Prefer": "respond-async"} if mutant.background else {})
    answer = _ask(connection, "POST", mutant.path, mutant.body, headers)
    return answer.status, answer.read()


def _ask(
    connection: HTTPConnection, method: str, path: str, body: bytes = b"", headers: dict[str, str] | None = None
) -> HTTPResponse:
    connection.request(method, path, body, headers or {})
    return connection.getresponse()


def _answers_paper(server: Server) -> bool:
    angle = critical_angle(**to_arguments(PAPER)).angle
    headers = {"Content-Type": "application/json"}
    answer = _ask(server.connect(), "POST", "/cra", orjson.dumps(PAPER), headers)
    found = orjson.loads(answer.read()).get("critical_angle_deg")
    return answer.status == 200 and angle is not None and found == degrees(angle)
