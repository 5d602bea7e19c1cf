"""Attacks get no access, do not stop the service, and do not keep other owners from being answered."""

import gzip
import json
from collections.abc import Iterator

import httpx
import pytest

from service.auth.api_keys import make_key
from service.schemas.strike import PAPER
from tests.conftest import RunService

from .attacks import ATTACKS, CHUNKED_BODY, JSON, QUERIES, REQUESTS, Attack, Target, effect_of
from .many import ASYNC, LINES, lines, searches
from .owners import Guarded, bearer, guarded_service, holder, key_in
from .refused import TEXT, problem_of

BODY = json.dumps(PAPER).encode()


@pytest.fixture(scope="module")
def guarded(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    folder = tmp_path_factory.mktemp("attacked")
    with service_on(folder) as service, guarded_service(service.url, folder / "data") as keyed:
        yield keyed
    log = (folder / "log").read_text()
    assert "ricochet_" not in log.replace("ricochet_build", "")  # The log contains no key, not even a wrong one.


@pytest.fixture(scope="module")
def mallory(guarded: Guarded) -> str:
    """Token of the attacker, who is an owner with a valid key."""
    with guarded.with_key("mallory") as client:
        return client.headers["Authorization"].removeprefix("Bearer ")


def stranger() -> str:
    """Token of a key that the service does not know."""
    return make_key("mallory", frozenset({"admin"}))[1]


@pytest.mark.parametrize(
    "authorization",
    [
        b"",
        b"Bearer",
        b"Bearer null",
        b"Bearer ricochet_",
        b"Bearer ricochet_00000000_" + b"a" * 43,
        b"Bearer " + b"x" * 8000,
        b"Bearer \xff\xfe",
        b"Basic YWRtaW46YWRtaW4=",
        b"Token admin",
        b"bearer:admin",
    ],
)
@pytest.mark.parametrize(("method", "path"), [("GET", "/jobs"), ("POST", "/cra"), ("GET", "/metrics")])
def test_request_without_a_valid_key_is_refused(guarded: Guarded, method: str, path: str, authorization: bytes) -> None:
    with holder(guarded.url) as nobody:
        headers = [(b"Content-Type", b"application/json")] + [(b"Authorization", authorization)] * bool(authorization)
        told = nobody.request(method, path, content=BODY if method == "POST" else None, headers=headers)
        problem_of(told, 401)


def test_all_wrong_keys_get_the_same_refusal(guarded: Guarded) -> None:
    right = guarded.anna.headers["Authorization"].removeprefix("Bearer ")
    revoked = key_in(guarded.folder, "gone", days=1e-9)
    other_case = right[:-1] + ("A" if right[-1] != "A" else "B")
    details = set()
    with holder(guarded.url) as nobody:
        for token in (stranger(), other_case, right[:-1], right + "A", right.upper(), revoked):
            details.add(problem_of(nobody.get("/jobs", headers=bearer(token)), 401).detail)
    assert len(details) == 1


def test_two_keys_in_one_request_are_refused(guarded: Guarded) -> None:
    right = guarded.anna.headers["Authorization"]
    with holder(guarded.url) as nobody:
        problem_of(nobody.get("/jobs", headers=[("Authorization", right), ("Authorization", "Bearer x")]), 400)


@pytest.mark.parametrize("name", ["key", "token", "api_key", "access_token", "Authorization", "other"])
def test_key_in_the_url_is_refused_even_if_it_is_valid(guarded: Guarded, name: str) -> None:
    token = guarded.anna.headers["Authorization"].removeprefix("Bearer ")
    with holder(guarded.url) as nobody:
        for told in (nobody.get("/jobs", params={name: token}), guarded.anna.get("/jobs", params={name: token})):
            assert "revoke" in problem_of(told, 400).detail
            assert token not in told.text
        assert nobody.get(f"/jobs/{token}").status_code == 400


PATHS = [
    "/livez/../jobs",
    "/docs/assets/../../jobs",
    "/docs/assets/..%2f..%2fjobs",
    "/page/../jobs",
    "/page/%2e%2e/jobs",
    "/page/..%2Fjobs",
    "/page/..%5cjobs",
    "//jobs",
    "/./jobs",
    "/jobs/",
    "/jobs%00",
    "/jobs;/livez",
    "/livez;/../jobs",
    "/livez%2f..%2fjobs",
    "/JOBS",
    "/%6aobs",
    "/%2e/jobs",
    "/docs/assets/..%2f..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
    "/docs/assets/%2fetc%2fpasswd",
    "http://localhost/jobs",
    "http://evil.example/livez/../jobs",
]


@pytest.mark.parametrize("path", PATHS)
def test_path_trick_does_not_bypass_the_key(guarded: Guarded, path: str) -> None:
    """Requests are sent over a socket, because clients would normalise the path."""
    job = guarded.anna.post("/cra/batch", content=lines(searches(1)), headers=LINES | ASYNC).json()
    status, content = Target.of(guarded.url).send(b"GET " + path.encode() + b" HTTP/1.1")
    assert status in {400, 401, 404, 405}, content
    assert job["id"].encode() not in content
    assert b"root:" not in content


@pytest.mark.parametrize("line", [b"GET /jobs HTTP/9.9", b"GET jobs HTTP/1.1", b"GET /jobs", b"\x16\x03\x01\x02\x00"])
def test_invalid_request_line_is_refused(guarded: Guarded, line: bytes) -> None:
    status, _ = Target.of(guarded.url).send(line)
    assert status in {0, 400, 401}


@pytest.mark.parametrize(
    "header",
    [
        b"X-HTTP-Method-Override: GET",
        b"X-Original-URL: /livez",
        b"X-Rewrite-URL: /livez",
        b"X-Forwarded-For: 127.0.0.1",
        b"X-Forwarded-Prefix: /docs/assets",
        b"Host: 127.0.0.1",
    ],
)
def test_header_trusted_by_other_servers_does_not_replace_a_key(guarded: Guarded, header: bytes) -> None:
    status, _ = Target.of(guarded.url).send(b"GET /jobs HTTP/1.1", header)
    assert status in {400, 401}


@pytest.fixture(scope="module")
def bomb() -> bytes:
    return gzip.compress(b" " * 50_000_000)


@pytest.mark.parametrize("coding", ["gzip", "deflate", "br", "zstd", "gzip, gzip", "identity, gzip"])
def test_compressed_body_is_not_unpacked(guarded: Guarded, bomb: bytes, coding: str) -> None:
    for path in ("/cra", "/cra/batch", "/calibration/depth"):
        told = guarded.anna.post(path, content=bomb, headers=TEXT | {"Content-Encoding": coding})
        problem_of(told, 415)


@pytest.mark.parametrize("coding", [b"gzip, chunked", b"GZIP,Chunked", b"deflate , chunked", b"identity, chunked"])
def test_transfer_coding_other_than_chunked_is_refused(guarded: Guarded, coding: bytes) -> None:
    target, authorization = Target.of(guarded.url), f"Authorization: {guarded.anna.headers['Authorization']}".encode()
    for coded, status in ((coding, 501), (b"chunked", 200), (b"Chunked", 200)):
        header = b"Transfer-Encoding: " + coded
        found, answer = target.send(b"POST /cra HTTP/1.1", JSON, authorization, header, body=CHUNKED_BODY)
        assert found == status, answer
        assert (b"application/problem+json" in answer) == (status == 501)
        assert (b"critical_angle_deg" in answer) == (status == 200)


@pytest.mark.parametrize("coding", [b"gzip", b"chunked, gzip", b"chunked, chunked", b"x", b""])
def test_body_without_an_end_is_refused(guarded: Guarded, coding: bytes) -> None:
    authorization = f"Authorization: {guarded.anna.headers['Authorization']}".encode()
    header = b"Transfer-Encoding: " + coding
    target = Target.of(guarded.url)
    status, answer = target.send(b"POST /cra HTTP/1.1", JSON, authorization, header, body=CHUNKED_BODY)
    assert status in {400, 501}, answer
    assert b"critical_angle_deg" not in answer


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
def test_other_owners_are_answered_during_an_attack(guarded: Guarded, mallory: str, attack: Attack) -> None:
    token = guarded.anna.headers["Authorization"].removeprefix("Bearer ")
    effect = effect_of(attack, Target.of(guarded.url), token, mallory)
    assert effect.requests >= REQUESTS
    assert effect.answered >= QUERIES
    assert not effect.let_in, effect
    assert guarded.anna.get("/readyz").status_code == 200


def test_answers_are_correct_after_all_attacks(guarded: Guarded) -> None:
    assert guarded.anna.post("/cra", json=PAPER).json()["critical_angle_deg"] == pytest.approx(48.63, abs=0.05)
    assert guarded.chief.get("/jobs").status_code == 200
    with httpx.Client(base_url=guarded.url, trust_env=False) as nobody:
        problem_of(nobody.get("/jobs"), 401)
