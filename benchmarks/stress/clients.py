"""Clients of the service: a batch from its first byte to its last result, and as many requests as go."""

import selectors
import socket
import time
from dataclasses import dataclass
from typing import Any

import orjson

from benchmarks.stress.servers import Server

JSONL = "application/jsonl"
SHORTEST_PAUSE, LONGEST_PAUSE = 0.01, 0.25
"""Between two looks at a job: a twentieth of the time it has run, within these. [s]"""
PIECE = 1024 * 1024
END_OF_HEAD = b"\r\n\r\n"
LENGTH = b"content-length: "


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """A batch that has been answered.

    Parameters
    ----------
    accepted, done, seconds
        Since the first byte was sent: until the job was there, until it had ended, until its last result was read.
    job
        At its end.
    results
        As they were sent, in order.
    """

    accepted: float
    done: float
    seconds: float
    job: dict[str, Any]
    results: list[bytes]


@dataclass(frozen=True, slots=True)
class Asked:
    """A connection, and what has arrived of an answer."""

    end: socket.socket
    arrived: bytearray


def run_batch(server: Server, path: str, body: bytes, *, keep: bool = True) -> Batch:
    """Send a batch as JSON lines, wait for its job, read all results; they are only counted unless they are kept."""
    connection = server.connect()
    begin = time.perf_counter()
    connection.request("POST", path, body, {"Content-Type": JSONL, "Prefer": "respond-async"})
    answer = connection.getresponse()
    content = answer.read()
    accepted = time.perf_counter() - begin
    if answer.status != 202:
        raise RuntimeError(f"{path} answered {answer.status}: {content!r}")
    job = orjson.loads(content)
    while job["status"] in {"accepted", "running"}:
        time.sleep(min(LONGEST_PAUSE, max(SHORTEST_PAUSE, 0.05 * (time.perf_counter() - begin))))
        connection.request("GET", job["links"]["self"])
        job = orjson.loads(connection.getresponse().read())
    done = time.perf_counter() - begin
    connection.request("GET", job["links"]["results"], headers={"Accept": JSONL})
    answer, parts, lines = connection.getresponse(), list[bytes](), 0
    while part := answer.read(PIECE):
        lines += part.count(b"\n")
        if keep:
            parts.append(part)
    seconds = time.perf_counter() - begin
    connection.close()
    if lines != job["counts"]["total"]:
        raise RuntimeError(f"{lines} results for {job['counts']['total']} cases")
    return Batch(accepted=accepted, done=done, seconds=seconds, job=job, results=b"".join(parts).splitlines())


def requests_per_second(server: Server, request: bytes, *, connections: int, seconds: float) -> float:
    """Answers to the same request on this many connections, each of which sends the next one after an answer."""
    count, deadline = 0, time.perf_counter() + seconds
    with selectors.DefaultSelector() as selector:
        ends = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(connections)]
        for end in ends:
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            selector.register(end, selectors.EVENT_READ, Asked(end, bytearray()))
            end.sendall(request)
        begin = time.perf_counter()
        while (now := time.perf_counter()) < deadline:
            for ready, _ in selector.select(1.0):
                asked: Asked = ready.data
                asked.arrived.extend(asked.end.recv(65536))
                if whole(asked.arrived):
                    asked.arrived.clear()
                    count += 1
                    asked.end.sendall(request)
        for end in ends:
            end.close()
    return count / (now - begin)


def whole(answer: bytearray) -> bool:
    """Tell whether an answer has arrived to its end.

    Raises
    ------
    RuntimeError
        If it is none of those that are counted.
    """
    end = answer.find(END_OF_HEAD)
    if end < 0:
        return False
    if not answer.startswith(b"HTTP/1.1 200"):
        raise RuntimeError(f"answered {bytes(answer[:200])!r}")
    start = answer.find(LENGTH) + len(LENGTH)
    return len(answer) >= end + len(END_OF_HEAD) + int(answer[start : answer.find(b"\r\n", start)])


def to_request(method: str, path: str, body: bytes = b"") -> bytes:
    """A request as it is sent."""
    head = f"{method} {path} HTTP/1.1\r\nhost: 127.0.0.1\r\n"
    if body:
        head += f"content-type: application/json\r\ncontent-length: {len(body)}\r\n"
    return head.encode() + b"\r\n" + body
