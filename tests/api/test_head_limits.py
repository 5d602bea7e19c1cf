"""Headers of requests: long ones are refused before they are parsed, and unusual ones never cause a status of 500."""

import json
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from service.api.batch_response import Preference, read_preference
from service.api.middleware import MAX_HEAD_BYTES, MAX_HEADER_BYTES, MAX_HEADERS
from service.schemas.strike import PAPER

from .attacks import Target
from .refused import TEXT
from .test_headers import ALWAYS

CONTRACT = json.loads((Path(__file__).parents[2] / "openapi" / "openapi.json").read_text(encoding="utf-8"))
BODY = json.dumps(PAPER).encode()
DECLARED = {
    each["name"].lower()
    for methods in CONTRACT["paths"].values()
    for operation in methods.values()
    for each in operation.get("parameters", ())
    if each["in"] == "header"
}
READ = {
    *("accept", "accept-encoding", "access-control-request-headers", "access-control-request-method", "authorization"),
    *("baggage", "connection", "content-encoding", "content-type", "cookie", "expect", "forwarded", "host"),
    *("if-modified-since", "if-none-match", "if-range", "mcp-session-id", "origin", "range", "sec-fetch-site"),
    *("traceparent", "upgrade", "x-forwarded-for", "x-forwarded-proto", "x-request-id"),
}
"""Headers that the service and its libraries read, in addition to those that routes declare."""
NAMES = sorted(DECLARED | READ)
VALUES: dict[str, Callable[[int], bytes]] = {
    "blanks between commas": lambda size: b"a," + b" " * size + b",a",
    "commas": lambda size: b"," * size,
    "items": lambda size: b"a;q=0.5," * (size // 8),
    "quotes": lambda size: b'a="' * (size // 3),
    "backslashes": lambda size: b'"' + b"\\" * size,
    "digits": lambda size: b"1" * size,
    "URL with an open bracket": lambda size: b"http://[" + b"1" * size,
    "bytes that are no text": lambda size: b"\xff\xfe" * (size // 2),
    "colons": lambda size: b":" * size,
    "ranges": lambda size: b"bytes=" + b"0-1," * (size // 4),
    "percent signs": lambda size: b"%" * size,
}
"""Functions that return a header value of about the given size in bytes, each hard to parse in its own way."""
REFUSED = {400, 403, 404, 405, 406, 415, 416, 417, 421, 422}


def send(url: str, line: bytes, *headers: bytes, body: bytes = BODY) -> tuple[int, bytes]:
    usual = (
        ()
        if any(each.lower().startswith(b"content-type") for each in headers)
        else (b"Content-Type: application/json",)
    )
    return Target.of(url).send(line, *usual, *headers, body=body)


@pytest.mark.parametrize("name", NAMES)
def test_header_may_be_as_long_as_the_limit(live_url: str, name: str) -> None:
    """A longer header is refused with 431; a shorter one is answered, or refused because of its content."""
    for line, body in ((b"POST /cra/batch HTTP/1.1", BODY), (b"GET /page/main.js HTTP/1.1", b"")):
        for kind, value in VALUES.items():
            within, beyond = (
                name.encode() + b": " + value(size) for size in (MAX_HEADER_BYTES - 20, MAX_HEADER_BYTES + 20)
            )
            status, answer = send(live_url, line, within, body=body)
            assert status in REFUSED | {200, 202, 304}, (kind, answer)
            status, answer = send(live_url, line, beyond, body=body)
            assert status == 431, (kind, answer)
            assert b"application/problem+json" in answer


def test_refusal_of_a_long_head_has_the_security_headers(client: httpx.Client) -> None:
    refused = client.post("/cra", json=PAPER, headers={"X-Fill": "x" * 10_000})
    assert refused.status_code == 431
    assert {name: refused.headers[name] for name in ALWAYS} == ALWAYS
    assert refused.json() | {"detail": ""} == {
        "type": "urn:ricochet:problem:head-too-long",
        "title": "The head of the request is too long",
        "status": 431,
        "detail": "",
        "errors": [],
        "instance": "",
    }


def test_headers_are_limited_in_number_and_together(client: httpx.Client) -> None:
    own = len(client.get("/version").request.headers)
    for count, status in ((MAX_HEADERS - own, 200), (MAX_HEADERS - own + 1, 431)):
        assert client.get("/version", headers={f"X-{number}": "a" for number in range(count)}).status_code == status
    for count, status in ((MAX_HEAD_BYTES // 4096 - 1, 200), (MAX_HEAD_BYTES // 4096 + 1, 431)):
        fill = {f"X-{number}": "x" * 4000 for number in range(count)}
        assert client.get("/version", headers=fill).status_code == status


def test_request_target_may_be_as_long_as_the_limit(client: httpx.Client) -> None:
    within, beyond = MAX_HEADER_BYTES - 50, MAX_HEADER_BYTES
    assert client.get("/version?a=" + "b" * within).status_code == 200
    assert client.get("/" + "b" * within).status_code == 404
    for target in ("/version?a=" + "b" * beyond, "/" + "b" * beyond):
        refused = client.get(target)
        assert refused.status_code == 414
        assert "bbb" not in refused.text


def test_long_head_is_refused_while_its_body_is_still_being_sent(client: httpx.Client) -> None:
    for _ in range(2):  # Both requests use one connection, which stays open.
        refused = client.post("/cra", content=b" " * 100_000, headers=TEXT | {"Prefer": "," + 300_000 * " " + ","})
        assert refused.status_code == 431
    assert client.post("/cra", json=PAPER).status_code == 200


@pytest.mark.timeout(60)  # Parsing in quadratic time would take an hour.
@pytest.mark.parametrize("filling", [" ", "a", '"', "\\", "=", ";", ",", ', "', '"\\', "a=", "a ", '" '])
def test_preference_is_parsed_in_linear_time(filling: str) -> None:
    text = filling * (1_000_000 // len(filling))
    assert read_preference([f"respond-async, {text}"]).respond_async
    assert read_preference([f"a,{text},"]) in {Preference(), Preference(False, None)}


@pytest.mark.parametrize("origin", ["http://[", "http://[::1", "http://\xff", "://", "null", "http://localhost:1/["])
def test_origin_that_is_not_a_url_counts_as_another_site(client: httpx.Client, origin: str) -> None:
    refused = client.post("/cra", json=PAPER, headers=[(b"Origin", origin.encode("latin-1"))])
    assert refused.status_code == 403
    assert refused.headers["Content-Type"] == "application/problem+json"


@pytest.mark.parametrize("path", ["/results/", "/page/main.js", "/page/contract.json", "/docs/assets/swagger-ui.css"])
@pytest.mark.parametrize("coding", ["identity", "gzip", "zstd"])
@pytest.mark.parametrize("accept", ["application/json", "text/csv", "application/x-hdf5"])
def test_unchanged_file_is_answered_with_the_headers_of_a_full_answer(
    client: httpx.Client, path: str, coding: str, accept: str
) -> None:
    """RFC 9110, section 15.4.5: an answer 304 has the headers that 200 would have."""
    path += client.post("/cra", json=PAPER).json()["key"] if path == "/results/" else ""
    headers = {"Accept-Encoding": coding, "Accept": accept}
    whole = client.get(path, headers=headers)
    again = client.get(path, headers=headers | {"If-None-Match": whole.headers["ETag"]})
    assert (whole.status_code, again.status_code) == (200, 304)
    for name in ("Vary", "Cache-Control", "Content-Location", "Expires"):
        assert whole.headers.get(name) == again.headers.get(name), name
    assert again.headers["ETag"].removeprefix("W/") == whole.headers["ETag"].removeprefix("W/")
    assert "Accept-Encoding" in whole.headers["Vary"]


def test_request_id_that_looks_like_a_key_is_replaced(client: httpx.Client) -> None:
    """A key that a client sends as its request id by mistake must not be logged."""
    for given in ("ricochet_5f0c21d9_" + "a" * 43, "Ricochet_5f0c21d9", "of:ricochet_5f0c21d9_x"):
        assert client.get("/livez", headers={"X-Request-ID": given}).headers["X-Request-ID"] != given
    assert client.get("/livez", headers={"X-Request-ID": "ricochet-17"}).headers["X-Request-ID"] == "ricochet-17"
