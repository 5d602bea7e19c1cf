"""Answers are compressed for clients that accept it, unless the setting forbids it."""

from pathlib import Path

import httpx
import pytest
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.schemas.strike import PAPER_AT_45
from service.settings import Settings

from .many import ASYNC, finished, searches

GZIP, PLAIN = {"Accept-Encoding": "gzip"}, {"Accept-Encoding": "identity"}


def received(client: httpx.Client, path: str, **headers: str) -> tuple[httpx.Response, bytes]:
    """Send a request; return the answer, and its body as received, before decompression."""
    with client.stream("GET", path, headers=headers) as response:
        raw = b"".join(response.iter_raw())
    return response, raw


def test_answer_is_compressed_for_clients_that_accept_it(client: httpx.Client) -> None:
    accepted = GZIP
    for _ in ("computed", "known"):
        compressed, plain = (
            client.post("/trajectory", json=PAPER_AT_45, headers=headers) for headers in (accepted, PLAIN)
        )
        assert compressed.headers["Content-Encoding"] == "gzip"
        assert "Content-Encoding" not in plain.headers
        assert compressed.content == plain.content
        for answer in (compressed, plain):
            assert "accept-encoding" in answer.headers["Vary"].lower()
        assert int(compressed.headers["Content-Length"]) < 0.6 * int(plain.headers["Content-Length"])


@pytest.mark.parametrize(
    ("accepted", "coding"),
    [
        ("gzip", "gzip"),
        ("gzip, deflate, br, zstd", "gzip"),
        ("gzip;q=0", None),
        ("gzip; q=0.000, *", None),
        ("*", "gzip"),
        ("identity, gzip;q=0.5", None),
        ("identity;q=0.5, gzip", "gzip"),
        ("GZIP", "gzip"),
        ("br", None),
        ("", None),
        ("gzip;q=one", None),
    ],
)
@pytest.mark.parametrize("path", ["/openapi.json", "/metrics", "/page/main.js"])
def test_compression_follows_accept_encoding(
    client: httpx.Client, path: str, accepted: str, coding: str | None
) -> None:
    found = client.get(path, headers={"Accept-Encoding": accepted}).raise_for_status().headers.get("Content-Encoding")
    assert found == coding


def test_problem_is_compressed_too(client: httpx.Client) -> None:
    wrong = client.post("/cra/batch", json={"cases": [{}] * 30}, headers=GZIP)
    assert (wrong.status_code, wrong.headers["Content-Encoding"]) == (422, "gzip")
    assert len(wrong.json()["errors"]) > 30


def test_small_answers_and_compressed_files_are_not_compressed(client: httpx.Client) -> None:
    key = client.post("/trajectory", json=PAPER_AT_45).json()["key"]
    assert "Content-Encoding" not in client.get("/version", headers=GZIP).headers
    answer, raw = received(client, f"/results/{key}", Accept="application/x-hdf5", **GZIP)
    assert "Content-Encoding" not in answer.headers
    assert raw.startswith(b"\x89HDF\r\n\x1a\n")
    assert not answer.headers["ETag"].startswith("W/")


def test_weak_tag_of_a_compressed_answer_avoids_sending_it_again(client: httpx.Client) -> None:
    accepted = GZIP
    key = client.post("/trajectory", json=PAPER_AT_45).json()["key"]
    plain, compressed = (client.get(f"/results/{key}", headers=headers) for headers in (PLAIN, accepted))
    assert compressed.headers["ETag"] == "W/" + plain.headers["ETag"]
    assert {part.strip().lower() for part in compressed.headers["Vary"].split(",")} == {"accept", "accept-encoding"}
    for tag in (plain.headers["ETag"], compressed.headers["ETag"]):
        assert client.get(f"/results/{key}", headers=accepted | {"If-None-Match": tag}).status_code == 304


def test_results_of_a_job_are_compressed_while_they_are_sent_but_events_are_not(client: httpx.Client) -> None:
    accepted = GZIP
    job = finished(client, client.post("/cra/batch", json={"cases": searches(30)}, headers=ASYNC).json())
    path = job["links"]["results"]
    answers = [received(client, path, Accept="application/jsonl", **headers) for headers in (accepted, PLAIN)]
    assert [answer.headers.get("Content-Encoding") for answer, _ in answers] == ["gzip", None]
    assert len(answers[0][1]) < 0.5 * len(answers[1][1])
    assert client.get(path, headers={"Accept": "application/jsonl"} | accepted).content == answers[1][1]
    events, _ = received(client, job["links"]["events"], **accepted)
    assert "Content-Encoding" not in events.headers


def test_nothing_is_compressed_if_the_setting_forbids_it(client: httpx.Client, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", gzip=False, executor="in-process")
    with TestClient(create_app(settings), "http://127.0.0.1") as other:
        answer = other.post("/trajectory", json=PAPER_AT_45, headers=GZIP)
    assert "Content-Encoding" not in answer.headers
    assert answer.json() == client.post("/trajectory", json=PAPER_AT_45).json()
