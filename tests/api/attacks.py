"""Attacks on a service that requires keys, while another owner sends queries.

An attacker sends up to 200 requests a second, or holds up to `HELD` connections. Attacker and service share one
machine, so the rate is kept low enough not to exhaust the processor.
"""

import json
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from http.client import HTTPConnection
from itertools import count
from urllib.parse import urlsplit

from service.schemas.strike import PAPER, PAPER_AT_45

BODY = json.dumps(PAPER).encode()
PAUSE = 0.005
"""Pause between two requests of the attacker, and between two requests of the other owner. [s]"""
DRIP_SECONDS = 0.5
HELD = 200
"""Largest number of connections that an attacker holds open."""
QUERIES, REQUESTS = 20, 50
"""Smallest numbers of queries by the other owner and of requests by the attacker in one attack."""
CASES = 5_000
"""Number of cases of the job whose events an attacker follows."""
REFUSED = frozenset({0, 400, 401, 403, 404, 405, 408, 413, 415, 421, 429, 431, 501, 503})
"""Statuses of refused requests; 0 if the connection was closed."""
UNKNOWN_TOKEN = "ricochet_00000000_" + "a" * 43
JSON = b"Content-Type: application/json"
CHUNKED_BODY = b"%x\r\n%b\r\n0\r\n\r\n" % (len(BODY), BODY)

fresh = count(1)
"""Counter that gives each case a new velocity, so none is answered from the cache."""


@dataclass(frozen=True, slots=True)
class Target:
    """Address of the service under attack."""

    port: int

    @staticmethod
    def of(url: str) -> "Target":
        return Target(urlsplit(url).port or 80)

    def connect(self, seconds: float = 20.0) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=seconds)

    def send(self, line: bytes, *headers: bytes, body: bytes = b"") -> tuple[int, bytes]:
        """Send a request; return the status of the answer (0 if there is none) and the raw answer.

        Adds the header `Connection: close` and, where needed, `Host` and `Content-Length`.
        """
        head = [line, *([] if any(h.startswith(b"Host") for h in headers) else [b"Host: localhost"]), *headers]
        coded = any(header.startswith(b"Transfer-Encoding") for header in headers)
        head += [b"Connection: close", *([b"Content-Length: %d" % len(body)] if body and not coded else [])]
        with self.connect() as connection:
            parts: list[bytes] = []
            with suppress(ConnectionError):
                connection.sendall(b"\r\n".join(head) + b"\r\n\r\n" + body)
            with suppress(ConnectionError):
                while part := connection.recv(65536):
                    parts.append(part)
        answer = b"".join(parts)
        words = answer.split(b" ", 2)
        return (int(words[1]) if len(words) > 1 else 0), answer


@dataclass(slots=True)
class Attacker:
    """An attacker with a valid key: the connections it holds and the statuses it has received."""

    target: Target
    token: str
    held: list[socket.socket] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)
    job: str = ""
    dripped: float = 0.0

    @property
    def authorization(self) -> bytes:
        return f"Authorization: Bearer {self.token}".encode()

    @property
    def requests(self) -> int:
        """Number of requests sent plus connections held."""
        return len(self.statuses) + len(self.held)

    def send(self, line: bytes, *headers: bytes, body: bytes = b"") -> None:
        """Send a request and record the status of the answer."""
        with suppress(OSError):
            self.statuses.append(self.target.send(line, *headers, body=body)[0])

    def hold(self, start: bytes) -> None:
        """Open a connection, send `start` and keep the connection open, unless `HELD` connections are open already."""
        if len(self.held) < HELD:
            with suppress(OSError):
                connection = self.target.connect()
                self.held.append(connection)
                connection.sendall(start)

    def drip(self, drop: bytes) -> None:
        """Send `drop` on every open connection, at most once every `DRIP_SECONDS`."""
        if time.monotonic() - self.dripped < DRIP_SECONDS:
            return
        self.dripped = time.monotonic()
        for connection in self.held:
            with suppress(OSError):
                connection.sendall(drop)


def no_key(attacker: Attacker) -> None:
    """Send a query without a key."""
    attacker.send(b"POST /cra HTTP/1.1", JSON, body=BODY)


def wrong_key(attacker: Attacker) -> None:
    """List jobs with a key that does not exist."""
    attacker.send(b"GET /jobs HTTP/1.1", b"Authorization: Bearer " + UNKNOWN_TOKEN.encode())


def key_in_address(attacker: Attacker) -> None:
    """Send a valid key in the query string."""
    attacker.send(f"GET /jobs?access_token={attacker.token} HTTP/1.1".encode())


def jobs_of_others(attacker: Attacker) -> None:
    """Request the results of a job by a guessed id."""
    attacker.send(b"GET /jobs/%016x/results HTTP/1.1" % time.monotonic_ns(), attacker.authorization)


def path_tricks(attacker: Attacker) -> None:
    """Request a protected path with `..` after the prefix of an open path."""
    attacker.send(b"GET /docs/assets/..%2f..%2fjobs HTTP/1.1")


def long_heads(attacker: Attacker) -> None:
    """Send 500 headers, without a key."""
    attacker.send(b"GET /jobs HTTP/1.1", *(b"X-%d: %b" % (number, b"x" * 100) for number in range(500)))


def long_bodies(attacker: Attacker) -> None:
    """Send a body of 1 MB, far more than the limit, with a valid key."""
    attacker.send(b"POST /cra HTTP/1.1", JSON, attacker.authorization, body=b" " * 1_000_000)


def bombs(attacker: Attacker) -> None:
    """Send a body declared as gzip, as a decompression bomb would be, with a valid key."""
    gzip = b"Content-Encoding: gzip"
    attacker.send(b"POST /cra HTTP/1.1", JSON, attacker.authorization, gzip, body=b"\x1f\x8b" + b"\0" * 9000)


def transfer_codings(attacker: Attacker) -> None:
    """Send a body with the transfer codings `gzip, chunked`, with a valid key."""
    coding = b"Transfer-Encoding: gzip, chunked"
    attacker.send(b"POST /cra HTTP/1.1", JSON, attacker.authorization, coding, body=CHUNKED_BODY)


def forms(attacker: Attacker) -> None:
    """Send a query as a page of another site would, with a valid key."""
    headers = (b"Content-Type: text/plain", b"Origin: https://evil.example", attacker.authorization)
    attacker.send(b"POST /cra HTTP/1.1", *headers, body=BODY)


def slow_heads(attacker: Attacker) -> None:
    """Hold connections on which the request head never ends."""
    attacker.hold(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: ")
    attacker.drip(b"x")


def slow_bodies(attacker: Attacker) -> None:
    """Hold requests whose bodies never end, with a valid key."""
    head = b"POST /cra HTTP/1.1\r\nHost: localhost\r\n" + JSON + b"\r\nContent-Length: 5000\r\n"
    attacker.hold(head + attacker.authorization + b"\r\n\r\n")
    attacker.drip(b" ")


def event_streams(attacker: Attacker) -> None:
    """Open event streams of the attacker's job and never read them."""
    line = f"GET {attacker.job}/events HTTP/1.1\r\nHost: localhost\r\n"
    attacker.hold(line.encode() + attacker.authorization + b"\r\n\r\n")


def submit_job(attacker: Attacker) -> str:
    """Submit a job with the attacker's key; return its path."""
    impacts = [{"velocity_m_s": 200.0 + 1e-6 * next(fresh), "oblique_angle_deg": 45.0} for _ in range(CASES)]
    body = b"".join(json.dumps(PAPER_AT_45 | {"impact": impact}).encode() + b"\n" for impact in impacts)
    headers = (b"Content-Type: application/jsonl", b"Prefer: respond-async", attacker.authorization)
    _, answer = attacker.target.send(b"POST /trajectory/batch HTTP/1.1", *headers, body=body)
    path: str = json.loads(answer.partition(b"\r\n\r\n")[2])["links"]["self"]
    return path


Attack = Callable[[Attacker], None]
"""Function that does one step of an attack, and is called repeatedly."""
ATTACKS: tuple[Attack, ...] = (
    no_key,
    wrong_key,
    key_in_address,
    jobs_of_others,
    path_tricks,
    long_heads,
    long_bodies,
    bombs,
    transfer_codings,
    forms,
    slow_heads,
    slow_bodies,
    event_streams,
)


@dataclass(frozen=True, slots=True)
class Effect:
    """Effect of an attack on another owner.

    Parameters
    ----------
    answered
        Number of queries of the other owner, all of which were answered with 200.
    let_in
        Statuses of the attacker's requests that were not refused.
    requests
        Number of requests sent plus connections held by the attacker.
    """

    answered: int
    let_in: list[int]
    requests: int


def effect_of(attack: Attack, target: Target, token: str, attacker_token: str) -> Effect:
    """Run an attack while another owner sends queries; return its effect on these queries."""
    attacker, stop = Attacker(target, attacker_token), threading.Event()
    if attack is event_streams:  # Only this attack needs a job, which would occupy workers during the others.
        attacker.job = submit_job(attacker)

    def attack_repeatedly() -> None:
        while not stop.wait(PAUSE):
            attack(attacker)

    with ThreadPoolExecutor(1) as thread:
        attacking = thread.submit(attack_repeatedly)
        try:
            answered = query(target, token, lambda: attacker.requests < REQUESTS and not attacking.done())
        finally:
            stop.set()
        attacking.result()
    for connection in attacker.held:
        connection.close()
    if attacker.job:
        target.send(f"DELETE {attacker.job} HTTP/1.1".encode(), attacker.authorization)
    let_in = sorted(set(attacker.statuses) - REFUSED)
    return Effect(answered, let_in, attacker.requests)


def query(target: Target, token: str, more: Callable[[], bool]) -> int:
    """Request at least `QUERIES` angles, alternately cached and new, while `more()` is true; return their number."""
    connection = HTTPConnection("127.0.0.1", target.port, timeout=60.0)
    headers = {"Content-Type": "application/json", "Authorization": f"Bearer {token}"}
    answered = 0
    while answered < QUERIES or more():
        impact = {"velocity_m_s": 200.0 + 1e-6 * next(fresh)} if answered % 2 else PAPER["impact"]
        connection.request("POST", "/cra", json.dumps(PAPER | {"impact": impact}), headers)
        answer = connection.getresponse()
        answer.read()
        assert answer.status == 200
        answered += 1
        time.sleep(PAUSE)
    connection.close()
    return answered
