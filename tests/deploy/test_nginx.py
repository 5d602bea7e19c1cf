"""deploy/nginx.conf in front of a running service: slow, silent or numerous clients do not delay others, and the
service learns the address of each client."""

import json
import re
import shutil
import socket
import ssl
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urljoin

import httpx
import pytest

from service.errors import ProblemType
from service.schemas.problems import Problem
from service.schemas.strike import PAPER
from tests.api.certificates import Certificate, make_certificate
from tests.api.owners import key_in
from tests.conftest import ROOT, RunService, free_port, until
from tests.docs.blocks import blocks

pytestmark = [pytest.mark.system, pytest.mark.timeout(1200)]

NGINX = shutil.which("nginx") or next((path for path in ("/usr/sbin/nginx",) if Path(path).exists()), None)
PROBES = 10
LONGEST_S = 5.0
"""Time limit of a probe. If it had to wait for the time-outs of silent connections, it would take 10 s. [s]"""
MONITOR, CROWD, SLOW, FAST = "127.0.0.1", "127.0.0.2", "127.0.0.3", "127.0.0.4"
"""Loopback addresses of the clients; nginx limits each address separately."""
UNFINISHED = b"POST /cra HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 999\r\n\r\n{"


@dataclass(frozen=True)
class Proxy:
    """nginx in front of a service that trusts it."""

    port: int
    trusted: ssl.SSLContext
    audit_log: Path

    def client(self, address: str = MONITOR) -> httpx.Client:
        """Return a client that connects from this address."""
        transport = httpx.HTTPTransport(verify=self.trusted, local_address=address)
        return httpx.Client(base_url=f"https://127.0.0.1:{self.port}", transport=transport, timeout=60.0)

    def connection(self, address: str, *, tls: bool = True) -> socket.socket:
        """Open a connection from this address, by default with TLS."""
        plain = socket.create_connection(("127.0.0.1", self.port), timeout=30.0, source_address=(address, 0))
        return self.trusted.wrap_socket(plain, server_hostname="127.0.0.1") if tls else plain

    def entries(self) -> list[dict[str, str]]:
        """Return the entries of the audit log."""
        return [json.loads(line) for line in self.audit_log.read_text().splitlines()]


def configuration(folder: Path, certificate: Certificate, port: int, replaced: dict[str, str]) -> str:
    """Return deploy/nginx.conf with replacements, and with the port, certificate and folder of a test."""
    text = (ROOT / "deploy" / "nginx.conf").read_text(encoding="utf-8")
    own = replaced | {
        "listen 443 ssl;": f"listen 127.0.0.1:{port} ssl;",
        "listen 80;": f"listen 127.0.0.1:{free_port()};",
        "/etc/ssl/ricochet/fullchain.pem": str(certificate.certificate),
        "/etc/ssl/ricochet/key.pem": str(certificate.key),
        "/run/nginx.pid": f"{folder}/nginx.pid",
        "/var/log/nginx/": f"{folder}/",
        "http {": f"http {{ client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;",
    }
    for before, after in own.items():
        assert before in text, before
        text = text.replace(before, after)
    return re.sub(r"(?m)^user .*$", "user root;", text)  # Only root can read the certificate of the test.


@contextmanager
def running_nginx(folder: Path, text: str, port: int) -> Iterator[None]:
    """Run nginx with this configuration, which `nginx -t` must accept."""
    if NGINX is None:
        pytest.skip("nginx is not there")
    (folder / "nginx.conf").write_text(text)
    command = [NGINX, "-c", str(folder / "nginx.conf"), "-p", str(folder), "-g", "daemon off;"]
    subprocess.run([*command[:-2], "-t", "-q"], check=True, timeout=30)
    with subprocess.Popen(command) as process:
        try:
            wait_for(port, process)
            yield
        finally:
            process.terminate()
            process.wait(30)


REWRITE = "ssl_session_cache shared:tls:10m;"
"""Line of the server block after which a test inserts another line."""


@pytest.fixture(scope="module")
def proxy(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Proxy]:
    folder = tmp_path_factory.mktemp("nginx")
    certificate, port, audit_log = make_certificate(folder), free_port(), folder / "audit.jsonl"
    settings = {"access": "open", "allowed_hosts": "127.0.0.1", "executor": "in-process", "root_path": "/ricochet"}
    with service_on(folder, trusted_proxies="127.0.0.1", audit_log=str(audit_log), **settings) as service:
        replaced = {
            "127.0.0.1:8000": f"127.0.0.1:{service.url.rpartition(':')[2]}",
            REWRITE: f"{REWRITE} rewrite ^/ricochet(/.*)$ $1;",
        }
        with running_nginx(folder, configuration(folder, certificate, port, replaced), port):
            yield Proxy(port, certificate.trusted(), audit_log)


def wait_for(port: int, process: "subprocess.Popen[bytes]") -> None:
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        assert process.poll() is None
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
            return
        time.sleep(0.1)
    pytest.fail("nginx does not listen")


def slowest_probe(proxy: Proxy) -> float:
    """Request /livez several times, each time on a new connection; return the longest time. [s]"""
    longest = 0.0
    for _ in range(PROBES):
        began = time.monotonic()
        with proxy.client() as client:
            assert client.get("/livez").status_code == 200
        longest = max(longest, time.monotonic() - began)
    return longest


def test_service_learns_the_address_of_the_client(proxy: Proxy) -> None:
    """The `X-Forwarded-For` header of the client is ignored."""
    known = len(proxy.entries())
    with proxy.client(CROWD) as client:
        answer = client.post("/cra", json=PAPER, headers={"X-Forwarded-For": "203.0.113.9"})
    assert answer.json()["critical_angle_deg"] == pytest.approx(48.64, abs=0.1)
    assert answer.headers["Strict-Transport-Security"]
    until(lambda: len(proxy.entries()) > known)  # The entry is written after the answer.
    assert proxy.entries()[-1]["client"] == CROWD


def test_thousand_silent_connections_delay_no_other_client(proxy: Proxy) -> None:
    with ExitStack() as opened:
        for _ in range(1000):
            opened.enter_context(proxy.connection(CROWD, tls=False))
        assert slowest_probe(proxy) < LONGEST_S


def test_slow_heads_and_bodies_never_reach_the_service(proxy: Proxy) -> None:
    known = len(proxy.entries())
    with ExitStack() as opened:
        heads = [opened.enter_context(proxy.connection(SLOW)) for _ in range(50)]
        bodies = [opened.enter_context(proxy.connection(CROWD)) for _ in range(39)]
        for head in heads:
            head.sendall(b"POST /cra HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ")
        for body in bodies:
            body.sendall(UNFINISHED)
        assert slowest_probe(proxy) < LONGEST_S
        assert len(proxy.entries()) == known
        heads[0].settimeout(30.0)
        assert heads[0].recv(4096) == b""  # nginx closes the connection after client_header_timeout, 10 s.
        bodies[0].settimeout(30.0)
        began = time.monotonic()
        ended = bodies[0].recv(4096)  # nginx answers after client_body_timeout, 20 s from the last byte.
        assert time.monotonic() - began < 20.0
        assert ended == b"" or b" 408 " in ended.splitlines()[0]
        assert len(proxy.entries()) == known


def test_long_heads_never_reach_the_service(proxy: Proxy) -> None:
    known = len(proxy.entries())
    with proxy.client() as client:
        assert client.get("/version", headers={"X-Fill": "x" * 20_000}).status_code == 400
        assert client.get("/version", headers={f"X-{number}": "x" * 4000 for number in range(30)}).status_code == 400
    assert len(proxy.entries()) == known


def test_connections_per_address_are_limited(proxy: Proxy) -> None:
    with ExitStack() as opened:
        for _ in range(40):
            opened.enter_context(proxy.connection(SLOW)).sendall(UNFINISHED)
        time.sleep(0.5)
        with proxy.client(SLOW) as client:
            refused = problem_of(client.get("/version"), 429)
            assert refused.headers["Retry-After"] == "1"
        with proxy.client(MONITOR) as client:
            assert client.get("/version").status_code == 200


def test_requests_per_address_are_limited(proxy: Proxy) -> None:
    request = "GET /livez HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: {}\r\n\r\n"
    with proxy.connection(FAST) as opened:
        began = time.monotonic()
        # All requests are written at once, so that they exceed the rate however busy the machine is.
        opened.sendall((request.format("keep-alive") * 399 + request.format("close")).encode())
        answers = b"".join(iter(lambda: opened.recv(65536), b""))
        seconds = time.monotonic() - began
    statuses = Counter(re.findall(rb"HTTP/1\.1 (\d{3}) ", answers))
    assert set(statuses) == {b"200", b"429"}
    assert statuses.total() == 400
    assert statuses[b"200"] <= 100 + 50 * seconds + 2
    with proxy.client(MONITOR) as client:
        assert client.get("/version").status_code == 200


def test_links_work_below_a_path_prefix(proxy: Proxy) -> None:
    """Links in an answer are relative to the address from which the client received it."""
    base = f"https://127.0.0.1:{proxy.port}"
    with proxy.client() as client:

        def follow(response: httpx.Response, reference: str) -> httpx.Response:
            found = client.get(urljoin(str(response.url), reference))
            assert (found.status_code, found.url.path.startswith("/ricochet/")) == (200, True), found.url
            return found

        body = {"cases": [PAPER]}
        accepted = client.post(f"{base}/ricochet/cra/batch", json=body, headers={"Prefer": "respond-async"})
        assert accepted.status_code == 202
        job = follow(accepted, accepted.headers["Location"])
        for name in ("self", "results", "events"):
            follow(job, job.json()["links"][name])
        assert client.post(urljoin(base, job.json()["links"]["cancel"])).status_code == 200
        [listed] = client.get(f"{base}/ricochet/jobs").json()["jobs"]
        assert listed["links"] == job.json()["links"]
        waited = client.post(f"{base}/ricochet/cra/batch", json=body, headers={"Prefer": "respond-async, wait=30"})
        assert follow(waited, waited.headers["Content-Location"]).json()["results"] == waited.json()["results"]
        page = client.get(f"{base}/ricochet/")
        follow(page, "page/main.js")
        follow(page, client.get(f"{base}/ricochet/openapi.json").json()["servers"][0]["url"] + "/version")


def test_too_long_bodies_are_refused_before_they_arrive_completely(proxy: Proxy) -> None:
    """nginx refuses bodies that are too long for their path; the service refuses a batch of type text/plain."""
    known = len(proxy.entries())
    for path in ("/nothing", "/cra", "/jobs", "/mcp"):
        with proxy.client() as client:
            problem_of(client.post(path, content=bytes(600_000)), 413)
        assert first_line(proxy, b"POST %b HTTP/1.1" % path.encode(), length=60_000_000).split()[1] == b"413"
    assert len(proxy.entries()) == known
    for path in ("/cra/batch", "/cra/uncertainty/sweep"):
        head = b"POST %b HTTP/1.1\r\nContent-Type: text/plain" % path.encode()
        assert first_line(proxy, head, length=60_000_000).split()[1] == b"415"


def problem_of(response: httpx.Response, status: int) -> httpx.Response:
    """Check that a response is a problem as in the contract; return it."""
    assert response.headers["Content-Type"] == "application/problem+json"
    problem = Problem.model_validate(response.json())
    assert (response.status_code, problem.status, problem.instance) == (status, status, response.request.url.path)
    known = ProblemType.of_status(status)
    assert status == 429 or (problem.type, problem.title) == (known.type, known.title)
    return response


def test_service_that_is_down_is_answered_with_a_problem(tmp_path: Path) -> None:
    certificate, port = make_certificate(tmp_path), free_port()
    text = configuration(tmp_path, certificate, port, {"127.0.0.1:8000": f"127.0.0.1:{free_port()}"})
    with (
        running_nginx(tmp_path, text, port),
        httpx.Client(base_url=f"https://127.0.0.1:{port}", verify=certificate.trusted(), trust_env=False) as client,
    ):
        assert problem_of(client.get("/livez"), 502).headers["Retry-After"] == "5"
        quoted = client.get('/a"b\\c?d="')
        assert Problem.model_validate(quoted.json()).instance.startswith("/a")


def first_line(proxy: Proxy, head: bytes, length: int) -> bytes:
    """Send a head and only part of the body; return the first line of the answer."""
    with proxy.connection(MONITOR) as connection:
        connection.settimeout(10.0)
        connection.sendall(b"%b\r\nHost: 127.0.0.1\r\nContent-Length: %d\r\n\r\n%b" % (head, length, b"x" * 100_000))
        return connection.recv(4096).splitlines()[0]


def test_metrics_are_available_only_to_this_machine(proxy: Proxy) -> None:
    with proxy.client(CROWD) as client:
        assert client.get("/metrics").status_code == 403
    with proxy.client(MONITOR) as client:
        assert "ricochet_workers" in client.get("/metrics").text


SEVERAL = [block.text for block in blocks(ROOT / "docs" / "sizing.md") if block.language == "nginx"]
"""The two nginx configurations in docs/sizing.md that divide requests between two services: by path, and by owner."""


@pytest.fixture(params=["path", "owner"])
def several(request: pytest.FixtureRequest, service_on: RunService, tmp_path: Path) -> Iterator[list[httpx.Client]]:
    """Two services behind one nginx with a configuration of docs/sizing.md, and a client of each."""
    by_path, port, certificate = request.param == "path", free_port(), make_certificate(tmp_path)
    folders = [tmp_path / "1", tmp_path / "2"]
    for folder in folders:
        (folder / "data").mkdir(parents=True)
    tokens = ["", ""] if by_path else [key_in(folder / "data", f"owner-{folder.name}") for folder in folders]
    text = SEVERAL[0 if by_path else 1]
    text = text.replace("ricochet_5f0c21d9_", "_".join(tokens[1].split("_")[:2]) + "_")
    [upstream] = re.findall(r"(?ms)^    upstream .*?^    }$", (ROOT / "deploy" / "nginx.conf").read_text("utf-8"))
    with ExitStack() as running:
        for number, folder in enumerate(folders, 1):
            own = {"root_path": f"/{number}"} if by_path else {"access": "keys"}
            service = running.enter_context(service_on(folder, executor="in-process", **own))
            text = text.replace(f"127.0.0.1:800{number}", service.url.removeprefix("http://"))
        replaced = {upstream: text, "http://ricochet": "http://$service"}
        if by_path:
            replaced[REWRITE] = rf"{REWRITE} rewrite ^/\d(/.*)$ $1;"
        running.enter_context(running_nginx(tmp_path, configuration(tmp_path, certificate, port, replaced), port))
        yield [
            running.enter_context(
                httpx.Client(
                    base_url=f"https://127.0.0.1:{port}{f'/{number}' if by_path else ''}",
                    headers={"Authorization": f"Bearer {token}"} if token else {},
                    timeout=60.0,
                    trust_env=False,
                    verify=certificate.trusted(),
                )
            )
            for number, token in enumerate(tokens, 1)
        ]


def test_two_services_have_separate_jobs_keys_and_idempotency_keys(several: list[httpx.Client]) -> None:
    once = {"Prefer": "respond-async", "Idempotency-Key": "one-of-each"}
    made: list[str] = []
    for client in several:
        cases = {"cases": [PAPER | {"impact": {"velocity_m_s": 230.0 + len(made)}}]}
        first, again = (client.post("/cra/batch", json=cases, headers=once) for _ in range(2))
        assert first.status_code == again.status_code == 202, first.text
        assert first.json()["id"] == again.json()["id"]
        found = client.get(urljoin(str(client.base_url), first.headers["Location"]))
        assert found.json()["id"] == first.json()["id"]
        made.append(first.json()["id"])
    for client, own, other in zip(several, made, made[::-1], strict=True):
        assert [job["id"] for job in client.get("/jobs").json()["jobs"]] == [own]
        assert client.get(f"/jobs/{own}").is_success
        assert client.get(f"/jobs/{other}").status_code == 404
        assert client.get("/readyz").json()["chunks_on"] == "pool"
