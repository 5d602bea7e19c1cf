"""Security headers of every answer, and refused requests from pages of other sites."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.api.middleware import POLICY, secured
from service.schemas.strike import PAPER
from service.settings import Settings
from tests.conftest import RunService

from .certificates import make_certificate
from .refused import problem_of

ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
HERE, ELSEWHERE = "https://desk.example", "https://evil.example"


@pytest.fixture(scope="module")
def named(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """Client of a service with TLS, allowed host names and one CORS origin."""
    folder = tmp_path_factory.mktemp("named")
    made = make_certificate(folder)
    settings = {"allowed_hosts": "ricochet.example, 127.0.0.1", "cors_origins": HERE} | made.settings
    with (
        service_on(folder, verify=made.trusted(), **settings) as service,
        httpx.Client(base_url=service.url, timeout=60.0, trust_env=False, verify=made.trusted()) as client,
    ):
        yield client


@pytest.mark.parametrize("path", ["/livez", "/version", "/nothing", "/docs", "/openapi.json", "/jobs", "/metrics"])
def test_every_answer_has_the_security_headers(client: httpx.Client, path: str) -> None:
    headers = client.get(path).headers
    assert {name: headers[name] for name in ALWAYS} == ALWAYS
    assert "default-src" in headers["Content-Security-Policy"]
    assert "Strict-Transport-Security" not in headers
    assert "Server" not in headers


def test_computed_and_cached_answers_have_the_security_headers(client: httpx.Client) -> None:
    for _ in range(3):
        headers = client.post("/cra", json=PAPER).headers
        assert {name: headers[name] for name in ALWAYS} == ALWAYS
        assert headers["Cache-Control"] == "no-store"


def test_clients_may_store_and_revalidate_a_result(client: httpx.Client) -> None:
    key = client.post("/cra", json=PAPER).json()["key"]
    first = client.get(f"/results/{key}")
    assert first.headers["Cache-Control"] == "private, no-cache"
    again = client.get(f"/results/{key}", headers={"If-None-Match": first.headers["ETag"]})
    assert again.status_code == 304


def test_header_set_by_a_route_is_kept() -> None:
    own = [(b"content-security-policy", b"default-src 'self'"), (b"cache-control", b"max-age=60")]
    found = dict(secured(own, tls=False))
    assert [found[name] for name, _ in own] == [value for _, value in own]
    assert len(secured(own, tls=False)) == len(found)
    assert dict(secured([], tls=False))[b"content-security-policy"] == POLICY


def test_documentation_keeps_its_own_policy(client: httpx.Client) -> None:
    assert "'self'" in client.get("/docs").headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    "host", ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example:80", "", "[::1", "a/b"]
)
def test_unknown_host_name_on_the_loopback_interface_is_refused(client: httpx.Client, host: str) -> None:
    """In a DNS rebinding attack the name of a loaded page is made to resolve to 127.0.0.1."""
    problem_of(client.get("/jobs", headers={"Host": host}), 421)
    problem_of(client.post("/cra", json=PAPER, headers={"Host": host}), 421)
    assert client.get("/livez", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:8000", "127.0.0.1", "127.0.0.1:1", "[::1]", "[::1]:8000"])
def test_localhost_is_answered_on_the_loopback_interface(client: httpx.Client, host: str) -> None:
    assert client.get("/jobs", headers={"Host": host}).status_code == 200


def test_unknown_host_name_is_refused_on_any_address_of_an_open_service(tmp_path: Path) -> None:
    """A container whose port is published on the loopback interface of its host is such a service."""
    settings = Settings(data_dir=tmp_path, host="0.0.0.0", access="open", executor="in-process")  # noqa: S104
    with TestClient(create_app(settings), "http://192.0.2.7:8000") as client:
        for host in ("evil.example", "192.0.2.7:8000"):
            assert client.get("/jobs", headers={"Host": host}).status_code == 421
            assert client.get("/livez", headers={"Host": host}).status_code == 200
        assert client.get("/jobs", headers={"Host": "localhost:8000"}).status_code == 200


def test_only_the_host_names_in_the_settings_are_answered(named: httpx.Client) -> None:
    assert named.get("/jobs", headers={"Host": "ricochet.example"}).status_code == 200
    problem_of(named.get("/jobs", headers={"Host": "localhost"}), 421)


@pytest.mark.parametrize(
    "headers",
    [
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site", "Origin": "http://localhost:3000"},
        {"Origin": ELSEWHERE},
        {"Origin": "null"},
        {"Origin": "http://localhost:1"},
    ],
)
def test_page_of_another_site_cannot_change_anything(client: httpx.Client, headers: dict[str, str]) -> None:
    problem_of(client.post("/cra", json=PAPER, headers=headers), 403)
    problem_of(client.delete("/jobs/1", headers=headers), 403)
    # The browser does not let that page read the answer.
    assert client.get("/jobs", headers=headers).status_code == 200


def test_page_of_the_service_itself_may_send_requests(client: httpx.Client) -> None:
    origin = str(client.base_url).rstrip("/")
    for headers in (
        {"Sec-Fetch-Site": "same-origin", "Origin": origin},
        {"Origin": origin},
        {"Sec-Fetch-Site": "none"},
    ):
        assert client.post("/cra", json=PAPER, headers=headers).status_code == 200


def test_only_origins_in_the_settings_may_read_answers(client: httpx.Client, named: httpx.Client) -> None:
    asks = {"Origin": HERE, "Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization"}
    told = client.options("/cra", headers=asks)
    assert told.status_code >= 400
    assert "Access-Control-Allow-Origin" not in told.headers
    assert "Access-Control-Allow-Origin" not in client.get("/version", headers={"Origin": HERE}).headers
    told = named.options("/cra", headers=asks)
    assert (told.status_code, told.headers["Access-Control-Allow-Origin"]) == (200, HERE)
    assert "Access-Control-Allow-Origin" not in named.options("/cra", headers=asks | {"Origin": ELSEWHERE}).headers
    sent = named.post("/cra", json=PAPER, headers={"Origin": HERE, "Sec-Fetch-Site": "cross-site"})
    assert (sent.status_code, sent.headers["Access-Control-Allow-Origin"]) == (200, HERE)
    problem_of(named.post("/cra", json=PAPER, headers={"Origin": ELSEWHERE, "Sec-Fetch-Site": "cross-site"}), 403)


def test_service_uses_tls_with_its_certificate(named: httpx.Client) -> None:
    assert named.get("/livez").headers["Strict-Transport-Security"] == "max-age=31536000"
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"{named.base_url}/livez", trust_env=False)
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{named.base_url}/livez".replace("https", "http"), trust_env=False)


def test_certificate_without_a_key_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="tls_key"):
        Settings(tls_certificate=tmp_path / "certificate.pem")


def test_host_names_in_the_settings_are_separated_by_commas(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RICOCHET_ALLOWED_HOSTS", "a.example, b.example")
    assert Settings().allowed_hosts == ("a.example", "b.example")
