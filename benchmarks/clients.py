"""HTTP clients with little overhead, to measure the time of a batch and the rate of requests."""

import json
import math
import selectors
import socket
import time
from dataclasses import dataclass
from http.client import HTTPConnection
from typing import Any

from benchmarks.random_cases import Case
from benchmarks.servers import Server
from solver import Ogive

JSONL = "application/jsonl"
SHORTEST_PAUSE, LONGEST_PAUSE = 0.01, 0.25
"""Bounds of the pause between two requests for the state of a job. The pause is a twentieth of the time since the job
was submitted. [s]"""


@dataclass(frozen=True, slots=True)
class Batch:
    """A finished batch: its job, the results as received, and the time from submission to the last result. [s]"""

    job: dict[str, Any]
    results: list[bytes]
    seconds: float


def to_request(case: Case) -> dict[str, Any]:
    """Return a case of a study, with an ogive and the default resistance, as a body of `/cra`."""
    projectile, target = case["projectile"], case["target"]
    if not isinstance(projectile.nose, Ogive):
        raise TypeError(projectile.nose)
    return {
        "projectile": {
            "nose": {"shape": "ogive", "caliber_radius_head": projectile.nose.caliber_radius_head},
            "diameter_m": projectile.diameter,
            "length_m": projectile.length,
            "mass_kg": projectile.mass,
        },
        "target": {"compressive_strength_pa": target.compressive_strength, "density_kg_m3": target.density},
        "impact": {
            "velocity_m_s": case["velocity"],
            "angle_of_attack_deg": math.degrees(case["angle_of_attack"]),
        },
    }


def run_batch(server: Server, path: str, cases: list[dict[str, Any]]) -> Batch:
    """Submit cases as JSON lines, wait for the job and read all results.

    Raises
    ------
    RuntimeError
        If the batch is refused, or the numbers of results and cases differ.
    """
    body = b"".join(json.dumps(case).encode() + b"\n" for case in cases)
    connection = HTTPConnection("127.0.0.1", server.port, timeout=600.0)
    begin = time.perf_counter()
    connection.request("POST", path, body, {"Content-Type": JSONL, "Prefer": "respond-async"})
    answer = connection.getresponse()
    content = answer.read()
    if answer.status != 202:
        raise RuntimeError(f"{path} answered {answer.status}: {content!r}")
    job = json.loads(content)
    while job["status"] in {"accepted", "running"}:
        time.sleep(min(LONGEST_PAUSE, max(SHORTEST_PAUSE, 0.05 * (time.perf_counter() - begin))))
        connection.request("GET", job["links"]["self"])
        job = json.loads(connection.getresponse().read())
    connection.request("GET", job["links"]["results"], headers={"Accept": JSONL})
    content = connection.getresponse().read()
    seconds = time.perf_counter() - begin
    connection.close()
    results = content.splitlines()
    if len(results) != len(cases):
        raise RuntimeError(f"{len(results)} results for {len(cases)} cases, the job is {job}")
    return Batch(job, results, seconds)


def requests_per_second(port: int, request: bytes, *, connections: int, seconds: float) -> float:
    """Return the rate of answers to a request that each connection repeats as soon as it is answered. [1/s]"""
    count, deadline = 0, time.perf_counter() + seconds
    ends: dict[int, socket.socket] = {}
    with selectors.DefaultSelector() as selector:
        for _ in range(connections):
            end = socket.create_connection(("127.0.0.1", port))
            ends[end.fileno()] = end
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            selector.register(end, selectors.EVENT_READ, bytearray())
            end.sendall(request)
        begin = time.perf_counter()
        while (now := time.perf_counter()) < deadline:
            for ready, _ in selector.select(1.0):
                connection, arrived = ends[ready.fd], ready.data
                arrived.extend(connection.recv(65536))
                if is_complete(arrived):
                    arrived.clear()
                    count += 1
                    connection.sendall(request)
        for end in ends.values():
            end.close()
    return count / (now - begin)


def is_complete(answer: bytearray) -> bool:
    """Return whether an answer with a Content-Length has arrived completely.

    Raises
    ------
    RuntimeError
        If its status is not 200.
    """
    head, end, body = answer.partition(b"\r\n\r\n")
    if not end:
        return False
    if not head.startswith(b"HTTP/1.1 200"):
        raise RuntimeError(f"answered {bytes(answer[:200])!r}")
    length = head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0]
    return len(body) >= int(length)


def raw_request(method: str, path: str, body: bytes = b"") -> bytes:
    head = f"{method} {path} HTTP/1.1\r\nhost: 127.0.0.1\r\n"
    if body:
        head += f"content-type: application/json\r\ncontent-length: {len(body)}\r\n"
    return head.encode() + b"\r\n" + body
