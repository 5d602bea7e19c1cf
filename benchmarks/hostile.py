"""Longest time for which hostile headers and bodies block the event loop.

    python benchmarks/hostile.py [--requests 2000] [--seed 1]

Three quarters of the requests have a hostile body: the example of a route in the contract (so that new routes are
covered), changed at a random place or as a whole. It is about as long as the service accepts for a single request, or
on half of the requests to routes that accept longer bodies, for a batch. The other requests have a hostile header, one
that a route declares or that the code around the routes reads. Each request is sent on a new connection. After each,
the service reports how long its event loop was blocked: in wall time, and in processor time of its thread, which other
processes on the machine do not affect.

Prints a row for each kind of change, the longest processor time first, and the longest time of all, which should be
below 50 ms. Exits with 1 if an answer was a 500. Takes about two minutes.
"""

import argparse
import asyncio
import json
import multiprocessing
import random
import socket
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from benchmarks.machine import print_machine, print_table
from benchmarks.servers import free_port
from service.api.app import create_app
from service.cli.server import Server
from service.schemas.strike import PAPER
from service.settings import Settings
from service.telemetry import configure_log

TARGET_SECONDS = 0.05
TICK_SECONDS = 0.001
PATIENCE_SECONDS = 30.0
"""Time after which a service that does not report its blocked time is killed and started again. [s]"""
SHORT, LONG = 100 * 1024, 1_900_000
"""Lengths below the limits on the bodies of single requests, 128 KiB, and of batches in JSON, 2 MiB. [bytes]"""
HEADERS = {
    *("accept", "accept-encoding", "access-control-request-headers", "access-control-request-method", "authorization"),
    *("connection", "content-encoding", "content-length", "content-type", "cookie", "expect", "forwarded", "host"),
    *("if-modified-since", "if-none-match", "if-range", "origin", "range", "sec-fetch-site", "traceparent", "baggage"),
    *("transfer-encoding", "upgrade", "x-forwarded-for", "x-forwarded-proto", "x-request-id", "mcp-session-id"),
}
"""Headers that the service, its libraries or a proxy read, in addition to those that routes declare."""
VALUES: dict[str, Callable[[int], bytes]] = {
    "blanks between commas": lambda size: b"," + b" " * size + b",",
    "many blanks between commas": lambda size: b", a" + b" " * (20 * size) + b", ",
    "blanks with a NUL": lambda size: b"a" + b" " * size + b"\0",
    "commas": lambda size: b"," * size,
    "items": lambda size: b"a;q=0.5," * (size // 8),
    "parameters": lambda size: b"a" + b";x=1" * (size // 4),
    "quotes": lambda size: b'a="' * (size // 3),
    "quoted commas": lambda size: b', "' * (size // 3),
    "backslashes": lambda size: b'"' + b"\\" * size,
    "equals signs": lambda size: b"a=" * (size // 2),
    "digits": lambda size: b"1" * size,
    "5 MB": lambda _: b"text/html," * 500_000,
    "brackets": lambda size: b"http://[" + b"[" * (size // 2),
    "an open bracket": lambda _: b"http://[",
    "bytes above 127": lambda size: b"\xff\xfe" * (size // 2),
    "colons": lambda size: b":" * size,
    "percent signs": lambda size: b"%" * size,
    "ranges": lambda size: b"bytes=" + b"0-1," * (size // 4),
    "addresses": lambda size: b"10.0.0.1, " * (size // 10),
    "a request in the value": lambda _: b"x\r\nTransfer-Encoding: chunked\r\n",
    "nothing": lambda _: b"",
}
"""Functions that return a hostile header value; most of the values have about the given size. [bytes]"""

Steps = tuple[str | int, ...]
NAMES = ("velocity_m_s", "strength_facto", "caliber_radius_heda", "nose_shape", "mas_kg", "lengthh_m")


def unknown_fields(size: int) -> dict[str, int]:
    """Return fields with short unknown names, about 11,000 in 100 kB."""
    return {f"f{number}": 0 for number in range(size // 9)}


def misspelt_fields(size: int) -> dict[str, int]:
    """Return fields with misspelt names, for which the service looks for similar names."""
    return {f"{NAMES[number % len(NAMES)]}{number}": 0 for number in range(size // 24)}


def long_names(size: int) -> dict[str, int]:
    """Return fields with unknown names of 1 kB each."""
    return {f"{number:06}" + "velocity_" * 110: 0 for number in range(size // 1000)}


def nulls(size: int) -> dict[str, None]:
    return {f"n{number}": None for number in range(size // 12)}


OBJECTS: dict[str, Callable[[int], dict[str, Any]]] = {
    "unknown fields": unknown_fields,
    "misspelt fields": misspelt_fields,
    "long names": long_names,
    "null fields": nulls,
    "unknown objects": lambda size: {f"o{number}": {"a": {}} for number in range(size // 18)},
}
"""Functions that return fields of about the given size in all, which are added to an object of a body. [bytes]"""
LISTS: dict[str, Callable[[int], Any]] = {
    "strings in a list": lambda size: ["a"] * (size // 4),
    "numbers in a list": lambda size: [1] * (size // 2),
    "lists in a list": lambda size: [[]] * (size // 3),
    "objects in a list": lambda size: [{}] * (size // 3),
    "objects with a field in a list": lambda size: [{"field": "a"}] * (size // 15),
    "nulls in a list": lambda size: [None] * (size // 5),
    "an object for a list": lambda size: {str(number): number for number in range(size // 14)},
    "repeated items": lambda size: [1e300, "x", None, {}, []] * (size // 20),
}
"""Functions that return a value of about the given size, which replaces a value of a body. [bytes]"""
SCALARS: dict[str, Callable[[int], Any]] = {
    "a long text": lambda size: "x" * size,
    "a text of escapes": lambda size: "\0" * (size // 6),
    "a long number": lambda size: int("1" * min(size, 4000)),
    "a text of dots": lambda size: "a." * (size // 2),
    "a text of blanks": lambda size: " " * size + "x",
}
RAW: dict[str, Callable[[int, bytes], bytes]] = {
    "deeply nested lists": lambda size, _: b"[" * (size // 2) + b"]" * (size // 2),
    "deeply nested objects": lambda size, _: b'{"a":' * (size // 6) + b"1" + b"}" * (size // 6),
    "blanks": lambda size, body: b" " * (size - len(body)) + body,
    "one field again and again": lambda size, body: body[:-1] + b',"target":1' * (size // 11) + b"}",
    "an open list": lambda size, _: b"[1," * (size // 3),
    "a number of many digits": lambda size, _: b'{"projectile":' + b"1" * size + b"}",
    "NUL bytes": lambda size, _: bytes(size),
    "colons": lambda size, _: b":" * size,
    "an open text": lambda size, body: body[:-1] + b',"a":"' + b'\\"' * (size // 2),
    "lines": lambda size, body: (body + b"\n") * (size // (len(body) + 1)),
    "empty lines": lambda size, _: b"\n" * size,
    "wrong lines": lambda size, _: b"{}\n" * (size // 3),
}
"""Functions that return a hostile body of about the given size [bytes]; some of them extend the given valid body."""


@dataclass(frozen=True, slots=True)
class Attack:
    """A hostile request and its kind."""

    kind: str
    request: bytes


@dataclass(slots=True)
class Observation:
    """Answers to requests of one kind, and how long the event loop was blocked."""

    statuses: Counter[int] = field(default_factory=Counter)
    """Number of answers by status."""
    wall: float = 0.0
    """Longest wall time for which the event loop was blocked. [s]"""
    cpu: float = 0.0
    """Longest CPU time for which it was blocked. [s]"""
    place: str = ""
    """Target of the request that took this CPU time."""


class WatchedServer(Server):
    """The service, with a task that measures how long the event loop is blocked."""

    pipe: Connection

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the service, and then the task that measures."""
        await super().startup(sockets)
        self._wall = self._cpu = 0.0
        asyncio.get_running_loop().add_reader(self.pipe.fileno(), self._report)
        self._watching = asyncio.create_task(self._watch())
        self.pipe.send("ready")

    async def _watch(self) -> None:
        while True:
            wall, cpu = time.perf_counter(), time.thread_time()
            await asyncio.sleep(TICK_SECONDS)
            self._wall = max(self._wall, time.perf_counter() - wall - TICK_SECONDS)
            self._cpu = max(self._cpu, time.thread_time() - cpu)

    def _report(self) -> None:
        if self.pipe.recv() == "stop":
            self._watching.cancel()
            self.should_exit = True
            return
        self.pipe.send((self._wall, self._cpu))
        self._wall = self._cpu = 0.0


def serve(pipe: Connection, port: int, folder: str) -> None:
    """Run the service in the process that `Service` starts."""
    settings = Settings(data_dir=Path(folder), port=port, workers=1, log_level="error")
    configure_log("error")
    server = WatchedServer(create_app(settings), settings)
    server.pipe = pipe
    server.run()


class Service:
    """Process of the service, which is started again if it no longer answers."""

    def __init__(self, folder: str) -> None:
        self._folder = folder
        self._count = 0
        self.start()

    def start(self) -> None:
        """Start the service and wait until it is ready."""
        self._count += 1
        self.port = free_port()
        self._pipe, there = multiprocessing.Pipe()
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(target=serve, args=(there, self.port, f"{self._folder}/{self._count}"))
        self._process.start()
        self._pipe.recv()

    @property
    def resident_mb(self) -> float:
        """Resident memory of the process. [MiB]"""
        status = Path(f"/proc/{self._process.pid}/status").read_text(encoding="ascii")
        return int(status.split("VmRSS:")[1].split()[0]) / 1024

    def longest_block(self) -> tuple[float, float]:
        """Return the longest time that the loop was blocked since the last call: wall time, and CPU time. [s]

        If the service does not report in time, it is replaced, and the times are `PATIENCE_SECONDS`.
        """
        with suppress(BrokenPipeError):
            self._pipe.send("report")
            if self._pipe.poll(PATIENCE_SECONDS):
                found: tuple[float, float] = self._pipe.recv()
                return found
        self._process.kill()
        self._process.join()
        self.start()
        return PATIENCE_SECONDS, PATIENCE_SECONDS

    def stop(self) -> None:
        """Stop the service."""
        self._pipe.send("stop")
        self._process.join()


@contextmanager
def running() -> Iterator[Service]:
    with tempfile.TemporaryDirectory() as folder:
        service = Service(folder)
        try:
            yield service
        finally:
            service.stop()


def bodies_of(contract: dict[str, Any]) -> list[tuple[str, str, str, Any]]:
    """Return method, path, media type and a valid body for every route that takes a body."""
    found: list[tuple[str, str, str, Any]] = []
    for path, methods in contract["paths"].items():
        for method, operation in methods.items():
            for media_type, content in operation.get("requestBody", {}).get("content", {}).items():
                name = content["schema"].get("$ref", "").rpartition("/")[2]
                body = contract["components"]["schemas"][name]["examples"][0] if name else PAPER
                found.append((method.upper(), path, media_type, body))
    call = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "critical_angle", "arguments": PAPER}}
    model = {"name": "cra", "input": [[238.0, 39.0]], "config": {"inputs": [{"field": "impact.velocity_m_s"}]}}
    found.append(("POST", "/mcp", "application/json", call))  # These routes are not in the contract.
    return found + [("POST", f"/umbridge/{name}", "application/json", model) for name in ("Evaluate", "InputSizes")]


def places_in(part: Any, steps: Steps = ()) -> Iterator[tuple[Steps, Any]]:
    """Yield every value of a body, preceded by the fields and indices that lead to it."""
    yield steps, part
    if isinstance(part, dict | list):
        for step, each in part.items() if isinstance(part, dict) else enumerate(part):
            yield from places_in(each, (*steps, step))


def put(part: Any, steps: Steps, value: Any) -> Any:
    """Return a copy of a body in which the value at the end of `steps` is replaced."""
    if not steps:
        return value
    changed = put(part[steps[0]], steps[1:], value)
    if isinstance(part, dict):
        return {**part, steps[0]: changed}
    return [changed if number == steps[0] else each for number, each in enumerate(part)]


def body_attack(rng: random.Random, routes: list[tuple[str, str, str, Any]]) -> Attack:
    method, path, media_type, body = rng.choice(routes)
    long = path.endswith(("/batch", "/sweep")) or path.startswith("/calibration")
    size = LONG if long and rng.random() < 0.5 else SHORT
    if media_type.endswith("jsonl") or rng.random() < 0.2:
        kind = rng.choice(list(RAW))
        content = RAW[kind](size, json.dumps(body).encode())
    else:
        steps, value = rng.choice(list(places_in(body)))
        if isinstance(value, dict) and rng.random() < 0.7:
            kind = rng.choice(list(OBJECTS))
            value = {**value, **OBJECTS[kind](size)}
        else:
            kinds = SCALARS if not isinstance(value, list) and rng.random() < 0.4 else LISTS
            kind = rng.choice(list(kinds))
            value = kinds[kind](size)
        content = json.dumps(put(body, steps, value), separators=(",", ":")).encode()
    head = (
        f"{method} {path.replace('{job_id}', '0' * 32)} HTTP/1.1\r\nHost: localhost\r\nContent-Type: {media_type}\r\n"
    )
    head += (
        f"Accept: application/json, text/event-stream\r\nConnection: close\r\nContent-Length: {len(content)}\r\n\r\n"
    )
    return Attack(f"body: {kind}", head.encode() + content)


def header_attack(rng: random.Random, names: list[str], routes: list[tuple[str, str]]) -> Attack:
    """Return a request with a hostile header; one in ten has many headers or a long target instead."""
    method, path = rng.choice(routes)
    name, kind = rng.choice(names), rng.choice(list(VALUES))
    size = rng.choice([1_000, 8_000, 16_000, 60_000])
    line, target = name.encode() + b": " + VALUES[kind](size) + b"\r\n", path.encode()
    if rng.random() < 0.05:
        kind, line = "many headers", name.encode() + b": a\r\n"
        line = line * (size // len(line))
    elif rng.random() < 0.05:
        kind, target = "long target", target + b"?" + b"a=1&" * (size // 4)
    given = b"" if name == "host" else b"Host: localhost\r\n"
    given += b"" if name == "content-type" else b"Content-Type: application/json\r\n"
    body = json.dumps(PAPER).encode() if method in {"POST", "PATCH"} else b""
    ends = {"content-length", "transfer-encoding"}
    given += b"" if name in ends or not body else b"Content-Length: %d\r\n" % len(body)
    given += b"" if name == "connection" else b"Connection: close\r\n"
    head = b"%b %b HTTP/1.1\r\n%b%b\r\n" % (method.encode(), target, given, line)
    return Attack(f"header: {kind}", head + body)


def send(port: int, request: bytes) -> int:
    """Send a request; return the status of its answer, 0 if there is none."""
    answer = b""
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_SECONDS) as connection:
        connection.settimeout(2.0)  # Limits the wait for a service that stops reading, or waits for more of the body.
        with suppress(OSError):
            connection.sendall(request)
        while part := connection.recv(65536):
            answer = (answer + part)[:100]
    words = answer.split(b" ", 2)
    return int(words[1]) if len(words) > 1 and words[1].isdigit() else 0


def attacks(contract: dict[str, Any], count: int, seed: int) -> Iterator[Attack]:
    """Yield `count` attacks, the same for the same seed and contract."""
    rng = random.Random(seed)  # noqa: S311 (no secret)
    bodies = bodies_of(contract)
    declared = {
        each["name"].lower()
        for methods in contract["paths"].values()
        for operation in methods.values()
        for each in operation.get("parameters", ())
        if each["in"] == "header"
    }
    routes = [(method.upper(), path) for path, methods in contract["paths"].items() for method in methods]
    routes += [("GET", "/"), ("GET", "/page/main.js"), ("OPTIONS", "/cra"), ("HEAD", "/docs/assets/swagger-ui.css")]
    names = sorted(HEADERS | declared)
    for _ in range(count):
        yield body_attack(rng, bodies) if rng.random() < 0.75 else header_attack(rng, names, routes)


def main() -> int:
    parser = argparse.ArgumentParser(description="Measure how long hostile requests block the event loop.")
    parser.add_argument("--requests", type=int, default=2000, help="number of requests")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random requests")
    options = parser.parse_args()
    print_machine()
    observed: dict[str, Observation] = defaultdict(Observation)
    with tempfile.TemporaryDirectory() as folder, running() as service:
        contract = create_app(Settings(data_dir=Path(folder))).openapi()
        send(service.port, b"GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        service.longest_block()
        before = service.resident_mb
        for attack in attacks(contract, options.requests, options.seed):
            status = send(service.port, attack.request)
            wall, cpu = service.longest_block()
            found = observed[attack.kind]
            found.statuses[status] += 1
            if cpu > found.cpu:
                found.place = attack.request.split(b" ", 2)[1][:60].decode("latin-1")
            found.wall, found.cpu = max(found.wall, wall), max(found.cpu, cpu)
        after = service.resident_mb
    rows = [
        [
            kind,
            found.statuses.total(),
            " ".join(f"{status}:{number}" for status, number in sorted(found.statuses.items())),
            f"{1e3 * found.cpu:.1f} ms",
            f"{1e3 * found.wall:.1f} ms",
            found.place,
        ]
        for kind, found in sorted(observed.items(), key=lambda item: -item[1].cpu)
    ]
    print_table(["kind", "requests", "statuses", "CPU time blocked", "wall time blocked", "longest at"], rows)
    largest = max(found.cpu for found in observed.values())
    failed = sum(found.statuses[500] for found in observed.values())
    longest = max(found.wall for found in observed.values())
    print(f"{options.requests:,} requests: the event loop was blocked for at most {1e3 * largest:.1f} ms of CPU time,")
    print(
        f"{1e3 * longest:.1f} ms of wall time (target: {1e3 * TARGET_SECONDS:.0f} ms); {failed} answers had status 500."
    )
    print(f"Resident memory {before:.0f} MiB before, {after:.0f} MiB after.")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
