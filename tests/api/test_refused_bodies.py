"""Common HTTP clients receive a refusal that arrives while they still send the body, directly or through a proxy."""

import json
import shutil
import socket
import ssl
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from service.api.middleware import DRAIN_BYTES
from tests.conftest import RunService, free_port

from .certificates import make_certificate

MEGABYTE = 1_000_000
PATIENCE_S = 60.0
JSON = {"Content-Type": "application/json"}


@dataclass(frozen=True)
class Refusal:
    """A request that is refused before its body has been read."""

    status: int
    path: str = "/cra"
    headers: dict[str, str] = field(default_factory=lambda: dict(JSON))


TOO_LONG = Refusal(413)
REFUSALS = [
    TOO_LONG,
    Refusal(403, headers=JSON | {"Sec-Fetch-Site": "cross-site"}),
    Refusal(404, path="/nothing"),
    Refusal(405, path="/livez"),
    Refusal(415, headers={"Content-Type": "text/plain"}),
    Refusal(421, headers=JSON | {"Host": "evil.example"}),
]
WITHOUT_FORBIDDEN_HEADERS = [refusal for refusal in REFUSALS if refusal.status in {404, 405, 415}]


@dataclass(frozen=True)
class Server:
    """URL of a service, and its certificate if it uses TLS."""

    url: str
    certificate: Path | None

    def trusted(self) -> ssl.SSLContext:
        return ssl.create_default_context(cafile=self.certificate)


@pytest.fixture(scope="module")
def servers(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Server]]:
    """A service without TLS and one with it."""
    plain, tls = (tmp_path_factory.mktemp(name) for name in ("plain", "tls"))
    made = make_certificate(tls)
    with service_on(plain) as one, service_on(tls, verify=made.trusted(), **made.settings) as other:
        yield {"plain": Server(one.url, None), "tls": Server(other.url, made.certificate)}


@pytest.fixture(params=["plain", "tls"])
def server(request: pytest.FixtureRequest, servers: dict[str, Server]) -> Server:
    return servers[request.param]


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with files of zeros, whose names are their sizes in megabytes."""
    folder = tmp_path_factory.mktemp("bodies")
    for size in (5, 50):
        (folder / str(size)).write_bytes(bytes(size * MEGABYTE))
    yield folder
    shutil.rmtree(folder)


Answer = tuple[int, dict[str, Any]]


def by_urllib(server: Server, refusal: Refusal, body: Path) -> Answer:
    """Send a body with urllib, which sends `Connection: close` and all of the body before it reads."""
    handlers = [urllib.request.ProxyHandler({}), urllib.request.HTTPSHandler(context=server.trusted())]
    request = urllib.request.Request(server.url + refusal.path, body.read_bytes(), refusal.headers)  # noqa: S310
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.build_opener(*handlers).open(request, timeout=PATIENCE_S)
    with refused.value as answer:
        return answer.code, json.loads(answer.read())


def by_httpx(server: Server, refusal: Refusal, body: Path) -> Answer:
    answer = httpx.post(
        server.url + refusal.path,
        content=body.read_bytes(),
        headers=refusal.headers,
        timeout=PATIENCE_S,
        trust_env=False,
        verify=server.trusted(),
    )
    return answer.status_code, answer.json()


def by_httpx_in_chunks(server: Server, refusal: Refusal, body: Path) -> Answer:
    with body.open("rb") as file, httpx.Client(trust_env=False, verify=server.trusted()) as client:
        pieces = iter(lambda: file.read(65536), b"")
        answer = client.post(server.url + refusal.path, content=pieces, headers=refusal.headers, timeout=PATIENCE_S)
        return answer.status_code, answer.json()


def by_curl(*options: str) -> Callable[[Server, Refusal, Path], Answer]:
    def ask(server: Server, refusal: Refusal, body: Path) -> Answer:
        program = shutil.which("curl")
        if program is None:
            pytest.skip("curl is not installed")
        headers = [word for name, value in refusal.headers.items() for word in ("--header", f"{name}: {value}")]
        trust = ["--cacert", str(server.certificate)] if server.certificate else []
        command = [program, "--silent", "--show-error", "--noproxy", "*", "--max-time", str(PATIENCE_S), *options]
        command += [*trust, *headers, "--data-binary", f"@{body}", "--write-out", "\n%{http_code}"]
        done = subprocess.run([*command, server.url + refusal.path], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        content, _, status = done.stdout.rpartition("\n")
        return int(status), json.loads(content)

    return ask


NODE = """
const [url, headers, body] = process.argv.slice(1);
const options = {method: "POST", headers: JSON.parse(headers), body: require("fs").readFileSync(body)};
fetch(url, options).then(async (answer) => console.log(JSON.stringify([answer.status, await answer.json()])));
"""


def by_node(server: Server, refusal: Refusal, body: Path) -> Answer:
    program = shutil.which("node")
    if program is None:
        pytest.skip("node is not installed")
    trust = {"NODE_EXTRA_CA_CERTS": str(server.certificate)} if server.certificate else {}
    command = [program, "-e", NODE, server.url + refusal.path, json.dumps(refusal.headers), str(body)]
    done = subprocess.run(command, env=trust, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    status, content = json.loads(done.stdout)
    return status, content


CLIENTS: dict[str, Callable[[Server, Refusal, Path], Answer]] = {
    "urllib": by_urllib,
    "httpx": by_httpx,
    "httpx in chunks": by_httpx_in_chunks,
    "curl": by_curl(),
    "curl that does not wait for 100": by_curl("--header", "Expect:"),
    "curl with HTTP/1.0": by_curl("--http1.0", "--header", "Expect:"),
    "node": by_node,
}


def check(answer: Answer, refusal: Refusal) -> None:
    status, problem = answer
    assert status == refusal.status
    assert problem["status"] == refusal.status
    assert problem["detail"]


@pytest.mark.parametrize("client", ["urllib", "httpx", "curl with HTTP/1.0"])
def test_client_reads_every_refusal_of_a_large_body(server: Server, bodies: Path, client: str) -> None:
    for refusal in REFUSALS * 2:
        check(CLIENTS[client](server, refusal, bodies / "5"), refusal)


@pytest.mark.parametrize("client", CLIENTS)
def test_every_client_reads_the_refusal_of_a_long_body(server: Server, bodies: Path, client: str) -> None:
    for size in ("5", "5", "50"):
        check(CLIENTS[client](server, TOO_LONG, bodies / size), TOO_LONG)


def test_fetch_in_node_reads_every_refusal(server: Server, bodies: Path) -> None:
    for refusal in WITHOUT_FORBIDDEN_HEADERS:
        check(by_node(server, refusal, bodies / "5"), refusal)


NGINX = """
daemon off;
master_process off;
{user}
pid {folder}/pid;
error_log stderr;
events {{}}
http {{
    access_log off;
    client_max_body_size 0;
    client_body_temp_path {folder}/bodies;
    proxy_temp_path {folder}/answers;
    fastcgi_temp_path {folder}/unused;
    uwsgi_temp_path {folder}/unused;
    scgi_temp_path {folder}/unused;
    server {{
        listen 127.0.0.1:{port};
        location / {{
            proxy_pass {url};
            {options}
        }}
    }}
}}
"""


@pytest.fixture(params=["", "proxy_request_buffering off;", "proxy_http_version 1.1; proxy_request_buffering off;"])
def behind_nginx(request: pytest.FixtureRequest, server: Server, tmp_path: Path) -> Iterator[Server]:
    """nginx in front of the service, with and without buffering of bodies."""
    program = shutil.which("nginx", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")
    if program is None:
        pytest.skip("nginx is not installed")
    port, user = free_port(), "user root;" if Path(tmp_path).owner() == "root" else ""
    text = NGINX.format(folder=tmp_path, port=port, url=server.url, options=request.param, user=user)
    (tmp_path / "nginx.conf").write_text(text)
    command = [program, "-p", str(tmp_path), "-c", str(tmp_path / "nginx.conf"), "-e", "stderr"]
    with (tmp_path / "log").open("wb") as log, subprocess.Popen(command, stderr=log) as process:
        try:
            deadline = time.monotonic() + PATIENCE_S
            while time.monotonic() < deadline:
                assert process.poll() is None, (tmp_path / "log").read_text()
                with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
                    break
                time.sleep(0.05)
            yield Server(f"http://127.0.0.1:{port}", None)
        finally:
            process.terminate()


def test_proxy_forwards_the_refusal(behind_nginx: Server, bodies: Path) -> None:
    for refusal in WITHOUT_FORBIDDEN_HEADERS + [TOO_LONG] * 2:
        check(by_httpx(behind_nginx, refusal, bodies / "5"), refusal)
    check(by_httpx(behind_nginx, TOO_LONG, bodies / "50"), TOO_LONG)


def connect(server: Server) -> socket.socket:
    end = socket.create_connection(("127.0.0.1", urlsplit(server.url).port or 0))
    end.settimeout(PATIENCE_S)
    return end if server.certificate is None else server.trusted().wrap_socket(end, server_hostname="127.0.0.1")


def request(path: str, length: int, *more: str) -> bytes:
    lines = [f"POST {path} HTTP/1.1", "Host: localhost", "Content-Type: application/json", f"Content-Length: {length}"]
    return "\r\n".join([*lines, *more, "", ""]).encode()


def test_kept_connection_serves_the_next_request_after_a_refusal(server: Server) -> None:
    with httpx.Client(base_url=server.url, trust_env=False, verify=server.trusted()) as client:
        for _ in range(3):
            refused = client.post("/cra", content=bytes(5 * MEGABYTE), headers=JSON, timeout=PATIENCE_S)
            assert refused.status_code == 413
            assert client.get("/livez").status_code == 200


def test_request_after_connection_close_is_not_answered(server: Server) -> None:
    with connect(server) as end:
        end.sendall(request("/nothing", 100_000, "Connection: close") + bytes(100_000))
        end.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n")
        answer = b""
        with suppress(ConnectionResetError):
            while part := end.recv(65536):
                answer += part
        assert answer.count(b"HTTP/1.1") == 1
        assert answer.split(b" ")[1] == b"404"


CONNECTIONS = ("Connection: close", "Connection: keep-alive")


def check_closed(end: socket.socket, status: bytes) -> None:
    """Check the status of the answer, and that the service then closes the connection."""
    answer = b"".join(iter(lambda: end.recv(65536), b""))
    assert answer.split(b" ")[1] == status
    assert b"connection: close" in answer.lower()


def test_service_does_not_wait_for_the_missing_rest_of_a_body(servers: dict[str, Server]) -> None:
    with ExitStack() as opened:  # All connections wait at once, because each takes `DRAIN_SECONDS`.
        ends = [opened.enter_context(connect(server)) for server in servers.values() for _ in CONNECTIONS]
        for end, header in zip(ends, CONNECTIONS * 2, strict=True):
            end.sendall(request("/nothing", 1000, header) + bytes(10))
        for end in ends:
            check_closed(end, b"404")


@pytest.mark.parametrize("header", CONNECTIONS)
def test_much_too_long_body_is_not_read(server: Server, header: str) -> None:
    with connect(server) as end:
        end.sendall(request("/cra", 10**9, header))
        check_closed(end, b"413")


@pytest.mark.parametrize("server", ["plain"], indirect=True)  # With TLS, asyncio keeps reading for up to 30 s.
def test_body_without_a_length_is_read_only_up_to_the_limit(server: Server) -> None:
    head = "POST /nothing HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
    chunk, sent = b"10000\r\n" + bytes(0x10000) + b"\r\n", 0
    with connect(server) as end, suppress(OSError):
        end.sendall(head.encode())
        while sent < 4 * DRAIN_BYTES:
            end.sendall(chunk)
            sent += len(chunk)
    assert sent < 2 * DRAIN_BYTES  # The kernel buffers some bytes.


def test_client_that_expects_100_continue_is_refused_before_it_sends_the_body(server: Server) -> None:
    with connect(server) as end:
        end.sendall(request("/cra", 5 * MEGABYTE, "Expect: 100-continue"))
        assert end.recv(65536).split(b" ")[1] == b"413"
