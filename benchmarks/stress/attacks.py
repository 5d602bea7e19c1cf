"""Attacks on a service that asks for keys: what another owner notices of each, and whether any gets in.

Attackers send a few hundred requests a second, or hold as many connections as they are let: enough to be a nuisance,
not so much that the cores of this machine, which they share with the service, are what is measured.
"""

import json
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from http.client import HTTPConnection
from itertools import count
from pathlib import Path
from statistics import median, quantiles
from urllib.parse import urlsplit

from benchmarks.stress.lines import Line
from benchmarks.stress.servers import service
from service.access.key import make_key
from service.access.keyring import add_key
from service.schemas.examples import PAPER, PAPER_AT_45

BODY = json.dumps(PAPER).encode()
PAUSE = 0.005
"""Between two requests of an attacker. [s]"""
ASK_PAUSE = 0.005
"""Between two of the other owner. [s]"""
DRIP_SECONDS = 0.5
HELD = 200
"""Connections that an attacker opens."""
ROUNDS, SECONDS = 3, 2.0
TIMES, MORE = 2.0, 0.02
"""Longest that the 95th percentile may become: so many times, or so much more if it is short. [s]"""
FEWEST = 20
"""Queries that a percentile is made of."""
CASES = 5_000
"""Of the job whose events an attacker follows."""
REFUSED = frozenset({0, 400, 401, 403, 404, 405, 408, 413, 415, 421, 429, 431, 503})
"""Statuses of those that did not get in; 0 if the connection was closed."""
JSON = b"Content-Type: application/json"

fresh = count(1)
"""No two cases are alike."""


@dataclass(frozen=True, slots=True)
class Target:
    """Where the service is."""

    port: int

    @staticmethod
    def of(url: str) -> "Target":
        """The service at this address."""
        return Target(urlsplit(url).port or 80)

    def connect(self, seconds: float = 20.0) -> socket.socket:
        """A connection."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=seconds)

    def ask(self, line: bytes, *headers: bytes, body: bytes = b"") -> tuple[int, bytes]:
        """Send a request as it is written here; return the status, 0 if there is none, and all of the answer."""
        sent = [line, *([] if any(h.startswith(b"Host") for h in headers) else [b"Host: localhost"]), *headers]
        sent += [b"Connection: close", *([b"Content-Length: %d" % len(body)] if body else [])]
        with self.connect() as end:
            parts: list[bytes] = []
            with suppress(ConnectionError):
                end.sendall(b"\r\n".join(sent) + b"\r\n\r\n" + body)
            with suppress(ConnectionError):
                while part := end.recv(65536):
                    parts.append(part)
        answer = b"".join(parts)
        words = answer.split(b" ", 2)
        return (int(words[1]) if len(words) > 1 else 0), answer


@dataclass(slots=True)
class Attacker:
    """What an attack is given, and what it finds.

    Parameters
    ----------
    token
        Of a key of its own, if it has one.
    """

    target: Target
    token: str
    stop: threading.Event = field(default_factory=threading.Event)
    held: list[socket.socket] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)
    job: str = ""
    dripped: float = 0.0

    @property
    def authorization(self) -> bytes:
        """The header with the key."""
        return f"Authorization: Bearer {self.token}".encode()

    def send(self, line: bytes, *headers: bytes, body: bytes = b"") -> None:
        """Send a request, and note its status."""
        with suppress(OSError):
            self.statuses.append(self.target.ask(line, *headers, body=body)[0])

    def hold(self, start: bytes) -> None:
        """Open a connection, say this, and keep it."""
        if len(self.held) < HELD:
            with suppress(OSError):
                end = self.target.connect()
                self.held.append(end)
                end.sendall(start)

    def drip(self, drop: bytes) -> None:
        """Send a little on every connection that is held, now and then: slowness is the attack."""
        if time.monotonic() - self.dripped < DRIP_SECONDS:
            return
        self.dripped = time.monotonic()
        for end in self.held:
            with suppress(OSError):
                end.sendall(drop)


@dataclass(frozen=True, slots=True)
class Attack:
    """One way to be a nuisance.

    Parameters
    ----------
    step
        Done again and again.
    prepare
        Done before, and no part of the attack.
    """

    name: str
    step: Callable[[Attacker], None]
    prepare: Callable[[Attacker], None] = lambda _: None


def no_key(attacker: Attacker) -> None:
    """Ask without a key."""
    attacker.send(b"POST /cra HTTP/1.1", JSON, body=BODY)


def wrong_key(attacker: Attacker) -> None:
    """Ask with a key that is made up."""
    token = make_key("mallory", frozenset({"admin"}))[1].encode()
    attacker.send(b"GET /jobs HTTP/1.1", b"Authorization: Bearer " + token)


def key_in_address(attacker: Attacker) -> None:
    """Ask with a key in the query."""
    attacker.send(f"GET /jobs?access_token={attacker.token} HTTP/1.1".encode())


def jobs_of_others(attacker: Attacker) -> None:
    """Guess at jobs."""
    attacker.send(b"GET /jobs/%016x/results HTTP/1.1" % time.monotonic_ns(), attacker.authorization)


def path_tricks(attacker: Attacker) -> None:
    """Ask for what is open by a name that leads elsewhere."""
    attacker.send(b"GET /docs/assets/..%2f..%2fjobs HTTP/1.1")


def long_heads(attacker: Attacker) -> None:
    """Send many headers."""
    attacker.send(b"GET /livez HTTP/1.1", *(b"X-%d: %b" % (number, b"x" * 100) for number in range(500)))


def long_bodies(attacker: Attacker) -> None:
    """Send far more than is read, with a right key."""
    attacker.send(b"POST /cra HTTP/1.1", JSON, attacker.authorization, body=b" " * 1_000_000)


def bombs(attacker: Attacker) -> None:
    """Send what would be large if it were unpacked, with a right key."""
    attacker.send(
        b"POST /cra HTTP/1.1", JSON, attacker.authorization, b"Content-Encoding: gzip", body=b"\x1f\x8b" + b"\0" * 9000
    )


def forms(attacker: Attacker) -> None:
    """Post as the page of another site does, with a right key."""
    attacker.send(
        b"POST /cra HTTP/1.1",
        b"Content-Type: text/plain",
        b"Origin: https://evil.example",
        attacker.authorization,
        body=BODY,
    )


def slow_heads(attacker: Attacker) -> None:
    """Hold connections whose requests never begin."""
    attacker.hold(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: ")
    attacker.drip(b"x")


def slow_bodies(attacker: Attacker) -> None:
    """Hold requests whose bodies never end, with a right key."""
    attacker.hold(
        f"POST /cra HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 5000\r\n"
        f"Authorization: Bearer {attacker.token}\r\n\r\n".encode()
    )
    attacker.drip(b" ")


def make_job(attacker: Attacker) -> None:
    """Make a job of its own: work, which others have to share the pool with whether its events are followed or not."""
    impacts = [{"velocity_m_s": 200.0 + 1e-6 * next(fresh), "oblique_angle_deg": 45.0} for _ in range(CASES)]
    body = b"".join(json.dumps(PAPER_AT_45 | {"impact": impact}).encode() + b"\n" for impact in impacts)
    headers = (b"Content-Type: application/jsonl", b"Prefer: respond-async", attacker.authorization)
    _, answer = attacker.target.ask(b"POST /trajectory/batch HTTP/1.1", *headers, body=body)
    attacker.job = json.loads(answer.partition(b"\r\n\r\n")[2])["links"]["self"]


def streams(attacker: Attacker) -> None:
    """Open event streams of this job, and never read them."""
    line = f"GET {attacker.job}/events HTTP/1.1\r\nHost: localhost\r\n"
    attacker.hold(line.encode() + attacker.authorization + b"\r\n\r\n")


ATTACKS = (
    Attack("no key", no_key),
    Attack("wrong key", wrong_key),
    Attack("key in the address", key_in_address),
    Attack("jobs of others", jobs_of_others),
    Attack("path tricks", path_tricks),
    Attack("long heads", long_heads),
    Attack("long bodies", long_bodies),
    Attack("bombs", bombs),
    Attack("forms of other sites", forms),
    Attack("slow heads", slow_heads),
    Attack("slow bodies", slow_bodies),
    Attack("event streams", streams, make_job),
)


@dataclass(frozen=True, slots=True)
class Measured:
    """What another owner noticed of an attack.

    Parameters
    ----------
    before, during
        95th percentile of the time a query took. [s]
    let_in
        Statuses that say that the attack got in.
    requests
        That the attacker has sent, or connections it has held.
    """

    name: str
    before: float
    during: float
    let_in: list[int]
    requests: int

    @property
    def held(self) -> bool:
        """Whether the attack did no harm."""
        return not self.let_in and self.during <= max(TIMES * self.before, self.before + MORE)


def measure(target: Target, attack: Attack, token: str, mallory: str, *, rounds: int, seconds: float) -> Measured:
    """Ask as another owner before and during an attack, in turn; medians over the rounds."""
    before, during, statuses, requests = list[float](), list[float](), list[int](), 0
    for _ in range(rounds):
        attacker = Attacker(target, mallory)
        attack.prepare(attacker)
        before.append(percentile(ask_for(target, token, seconds)))
        with ThreadPoolExecutor(1) as thread:
            attacking = thread.submit(go_on, attacker, attack)
            try:
                during.append(percentile(ask_for(target, token, seconds)))
            finally:
                attacker.stop.set()
            attacking.result()
        for end in attacker.held:
            end.close()
            if attacker.job:
                target.ask(f"DELETE {attacker.job} HTTP/1.1".encode(), attacker.authorization)
        statuses += attacker.statuses
        requests += len(attacker.statuses) + len(attacker.held)
    let_in = sorted({status for status in statuses if status not in REFUSED})
    return Measured(attack.name, median(before), median(during), let_in, requests)


def go_on(attacker: Attacker, attack: Attack) -> None:
    """Attack until it is to stop."""
    while not attacker.stop.wait(PAUSE):
        attack.step(attacker)


def ask_for(target: Target, token: str, seconds: float) -> list[float]:
    """Ask for critical angles for so long, known ones and new ones in turn; return the time each took. [s]"""
    connection = HTTPConnection("127.0.0.1", target.port, timeout=60.0)
    headers = {"Content-Type": "application/json", "Authorization": f"Bearer {token}"}
    taken: list[float] = []
    deadline = time.perf_counter() + seconds
    while time.perf_counter() < deadline or len(taken) < FEWEST:
        impact = {"velocity_m_s": 200.0 + 1e-6 * next(fresh)} if len(taken) % 2 else PAPER["impact"]
        begin = time.perf_counter()
        connection.request("POST", "/cra", json.dumps(PAPER | {"impact": impact}), headers)
        answer = connection.getresponse()
        answer.read()
        taken.append(time.perf_counter() - begin)
        if answer.status != 200:
            raise RuntimeError(f"the other owner was answered with {answer.status}")
        time.sleep(ASK_PAUSE)
    connection.close()
    return taken


def percentile(taken: list[float]) -> float:
    """95th percentile."""
    return quantiles(taken, n=20)[-1]


def measure_attacks(*, quick: bool) -> list[Line]:
    """Line 10."""
    rounds, seconds = (1, 1.0) if quick else (ROUNDS, SECONDS)
    found: list[Measured] = []
    with tempfile.TemporaryDirectory() as folder:
        data, tokens = Path(folder) / "data", list[str]()
        for owner in ("anna", "mallory"):
            key, token = make_key(owner, frozenset({"read", "run"}))
            add_key(data, key)
            tokens.append(token)
        with service(data_dir=str(data), log_level="warning", audit_log=str(Path(folder) / "audit.log")) as server:
            for attack in ATTACKS:
                print(f"attack: {attack.name}", file=sys.stderr)
                found.append(measure(Target(server.port), attack, *tokens, rounds=rounds, seconds=seconds))
    worst = max(found, key=lambda each: each.during / each.before)
    return [
        Line(
            number=10,
            what=f"{len(found)} attacks on a service that asks for keys, while another owner asks for critical angles",
            required=f"none gets in; 95th percentile at most {TIMES:g} times as long, or {1e3 * MORE:.0f} ms longer",
            measured=f"{sum(bool(each.let_in) for each in found)} got in; worst {worst.name}: "
            f"{worst.during / worst.before:.2f} times ({1e3 * worst.before:.1f} to {1e3 * worst.during:.1f} ms)",
            held=all(each.held for each in found),
            details={each.name: asdict(each) for each in found},
        )
    ]
