"""Requests that offer another protocol, as Java's client and `curl --http2` send them, are answered in HTTP/1.1."""

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from http.client import HTTPResponse
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from service.schemas.strike import PAPER
from tests.conftest import free_port

BODY = json.dumps(PAPER).encode()
ANGLE = pytest.approx(48.63, abs=0.05)
H2C = b"Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAMAAABkAAQCAAAAAAIAAAAA\r\n"
WEBSOCKET = b"Connection: keep-alive, Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
TWO_OFFERS = b"Upgrade: h2c\r\nConnection: upgrade\r\nUpgrade: foo/2\r\n"
LONGEST_HEAD = 64 * 1024
"""Longest request head that is accepted while incomplete. [bytes]"""
PAUSE_S = 0.1
"""Pause between two TCP segments, so that the server reads them separately. [s]"""
SETTINGS = 'proxy_http_version 1.1; proxy_set_header Upgrade $http_upgrade; proxy_set_header Connection "upgrade";'
NGINX = """
daemon off;
master_process off;
pid {folder}/pid;
error_log stderr;
events {{}}
http {{
    access_log off;
    client_body_temp_path {folder}/bodies;
    proxy_temp_path {folder}/answers;
    fastcgi_temp_path {folder}/unused;
    uwsgi_temp_path {folder}/unused;
    scgi_temp_path {folder}/unused;
    server {{
        listen 127.0.0.1:{port};
        location / {{ proxy_pass {url}; {options} }}
    }}
}}
"""
CADDY = "{{\n admin off\n auto_https off\n}}\nhttp://:{port} {{\n reverse_proxy {url}\n}}\n"


def post(offer: bytes, length: bytes = b"Content-Length: %d\r\n" % len(BODY)) -> bytes:
    return b"POST /cra HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n" + length + offer + b"\r\n"


def connect(url: str) -> socket.socket:
    return socket.create_connection(("127.0.0.1", urlsplit(url).port or 80), timeout=60.0)


def answer_on(connection: socket.socket, method: str = "GET") -> tuple[int, bytes]:
    """Read an answer from a connection; return status and body."""
    answer = HTTPResponse(connection, method=method)
    answer.begin()
    return answer.status, answer.read()


def angle_in(answer: tuple[int, bytes]) -> float:
    status, content = answer
    assert status == 200, content
    angle: float = json.loads(content)["critical_angle_deg"]
    return angle


CHUNKED = b"Transfer-Encoding: chunked\r\n"
IN_CHUNKS = b"%x\r\n%b\r\n0\r\n\r\n" % (len(BODY), BODY)
SEGMENTS: dict[str, Callable[[bytes], list[bytes]]] = {
    "body in the same segment": lambda offer: [post(offer) + BODY],
    "body in a later segment": lambda offer: [post(offer), BODY],
    "head and body in pieces": lambda offer: [post(offer)[:60], post(offer)[60:] + BODY[:9], BODY[9:200], BODY[200:]],
    "chunks in the same segment": lambda offer: [post(offer, CHUNKED) + IN_CHUNKS],
    "chunks in later segments": lambda offer: [post(offer, CHUNKED), IN_CHUNKS[:50], IN_CHUNKS[50:]],
}


@pytest.mark.parametrize("offer", [H2C, WEBSOCKET, TWO_OFFERS], ids=["h2c", "websocket", "two"])
@pytest.mark.parametrize("segments", SEGMENTS.values(), ids=list(SEGMENTS))
def test_offer_is_ignored_and_each_request_gets_its_own_answer(
    live_url: str, offer: bytes, segments: Callable[[bytes], list[bytes]]
) -> None:
    with connect(live_url) as connection:
        for _ in range(2):
            for segment in segments(offer):
                connection.sendall(segment)
                time.sleep(PAUSE_S)
            assert angle_in(answer_on(connection, "POST")) == ANGLE
        connection.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        assert answer_on(connection) == (200, b'{"status":"ok"}')
        assert connection.recv(1) == b""


def test_pipelined_requests_with_offers_are_answered_one_by_one(live_url: str) -> None:
    count = 2000
    get = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n" + H2C + b"\r\n"
    last = b"GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    with connect(live_url) as connection:
        sending = threading.Thread(target=connection.sendall, args=(post(H2C) + BODY + count * get + last,))
        sending.start()
        answers = b"".join(iter(lambda: connection.recv(65536), b""))
        sending.join()
    assert answers.count(b"HTTP/1.1 200 OK") == count + 2
    assert answers.count(b"critical_angle_deg") == 1


def test_connection_can_be_used_after_a_refused_body_with_an_offer(live_url: str) -> None:
    with connect(live_url) as connection:
        connection.sendall(post(H2C, b"Content-Length: 500000\r\n") + b" " * 500_000)
        assert answer_on(connection, "POST")[0] == 413
        connection.sendall(post(H2C) + BODY)
        assert angle_in(answer_on(connection, "POST")) == ANGLE


def test_tunnel_is_refused(live_url: str) -> None:
    with connect(live_url) as connection:
        connection.sendall(b"CONNECT localhost:443 HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert answer_on(connection)[0] == 400


@pytest.mark.parametrize("start", [b"GET /", b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX: "], ids=["path", "header"])
def test_endless_request_head_is_refused(live_url: str, start: bytes) -> None:
    """The connection is closed after `LONGEST_HEAD` bytes, plus the bytes that the kernel buffers."""
    piece, sent = b"x" * 4096, 0
    with connect(live_url) as connection:
        connection.sendall(start)
        with suppress(ConnectionError):
            while sent < 100 * LONGEST_HEAD:
                connection.sendall(piece)
                sent += len(piece)
                time.sleep(0.0005)
    assert LONGEST_HEAD <= sent < 50 * LONGEST_HEAD


def test_request_in_one_segment_with_the_end_of_a_long_body_is_answered(live_url: str) -> None:
    with connect(live_url) as connection:
        begun = b"GET /livez HTTP/1.1\r\nHo"
        connection.sendall(post(b"", b"Content-Length: 200000\r\n") + b" " * 200_000 + begun)
        assert answer_on(connection, "POST")[0] == 413
        connection.sendall(b"st: localhost\r\n\r\n")
        assert answer_on(connection)[0] == 200


def found(name: str) -> str:
    program = shutil.which(name, path="/usr/sbin:/usr/local/sbin:/usr/local/bin:/usr/bin:/bin")
    if program is None:
        pytest.skip(f"{name} is not installed")
    return program


def run_proxy(command: list[str], port: int, url: str, log: Path) -> Iterator[str]:
    with log.open("wb") as output, subprocess.Popen(command, stderr=output, stdout=output) as process:
        try:
            deadline = time.monotonic() + 60.0
            while time.monotonic() < deadline:
                assert process.poll() is None, log.read_text()
                with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
                    break
                time.sleep(0.05)
            yield url
        finally:
            process.terminate()


@pytest.fixture(params=["no proxy", "nginx", "nginx that passes upgrades on", "Caddy"])
def url(request: pytest.FixtureRequest, live_url: str, tmp_path: Path) -> Iterator[str]:
    """URL of the service, or of a proxy in front of it."""
    port = free_port()
    address, settings = f"http://127.0.0.1:{port}", {"port": port, "url": live_url, "folder": tmp_path}
    if request.param == "no proxy":
        yield live_url
    elif request.param == "Caddy":
        (tmp_path / "Caddyfile").write_text(CADDY.format(**settings))
        command = [found("caddy"), "run", "--adapter", "caddyfile", "--config", str(tmp_path / "Caddyfile")]
        yield from run_proxy(command, port, address, tmp_path / "log")
    else:
        settings["options"] = SETTINGS if "upgrades" in request.param else ""
        user = "user root;" if tmp_path.owner() == "root" else ""
        (tmp_path / "nginx.conf").write_text(user + NGINX.format(**settings))
        command = [found("nginx"), "-p", str(tmp_path), "-c", str(tmp_path / "nginx.conf"), "-e", "stderr"]
        yield from run_proxy(command, port, address, tmp_path / "log")


def test_offer_is_ignored_behind_a_proxy(url: str) -> None:
    with connect(url) as connection:
        for _ in range(2):
            connection.sendall(post(H2C) + BODY)
            assert angle_in(answer_on(connection, "POST")) == ANGLE


def test_curl_that_offers_http_2_is_answered(url: str, tmp_path: Path) -> None:
    (tmp_path / "body").write_bytes(BODY)
    command = [found("curl"), "--silent", "--http2", "--noproxy", "*", "--max-time", "60", f"{url}/cra"]
    command += ["--header", "Content-Type: application/json", "--data-binary", f"@{tmp_path / 'body'}"]
    told = subprocess.run(command, capture_output=True, check=True).stdout
    assert angle_in((200, told)) == ANGLE


JAVA = """
import java.net.URI;
import java.net.http.*;
import java.nio.file.Path;

public class Post {
    public static void main(String[] given) throws Exception {
        HttpClient client = HttpClient.newHttpClient();
        for (int turn = 0; turn < 3; turn++) {
            HttpRequest request = HttpRequest.newBuilder(URI.create(given[0] + "/cra"))
                .header("Content-Type", "application/json")
                .POST(HttpRequest.BodyPublishers.ofFile(Path.of(given[1]))).build();
            System.out.println(client.send(request, HttpResponse.BodyHandlers.ofString()).body());
        }
    }
}
"""


def test_java_client_with_default_settings_can_post(url: str, tmp_path: Path) -> None:
    (tmp_path / "body").write_bytes(BODY)
    (tmp_path / "Post.java").write_text(JAVA)
    found("javac")  # `java` needs the compiler to run a source file.
    command = [found("java"), str(tmp_path / "Post.java"), url, str(tmp_path / "body")]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    assert [angle_in((200, line.encode())) for line in told.splitlines()] == [ANGLE] * 3
