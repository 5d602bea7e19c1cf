"""Large answers compressed, where the service is set to."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import httpx
import pytest

from service.schemas.strike import PAPER_AT_45

from .many import ASYNC, finished, searches

GZIP, PLAIN = {"Accept-Encoding": "gzip"}, {"Accept-Encoding": "identity"}


@pytest.fixture(scope="module")
def client(
    tmp_path_factory: pytest.TempPathFactory, service_on: Callable[..., AbstractContextManager[Any]]
) -> Iterator[httpx.Client]:
    with (
        service_on(tmp_path_factory.mktemp("gzip"), gzip="true") as service,
        httpx.Client(base_url=service.url, timeout=60.0, trust_env=False) as session,
    ):
        yield session


def received(client: httpx.Client, path: str, **headers: str) -> tuple[httpx.Response, bytes]:
    """An answer, and its body as it came over the network."""
    with client.stream("GET", path, headers=headers) as response:
        raw = b"".join(response.iter_raw())
    return response, raw


def test_large_answer_is_compressed_for_clients_that_accept_it_and_is_the_same(client: httpx.Client) -> None:
    for _ in ("computed", "known"):
        compressed, plain = (client.post("/trajectory", json=PAPER_AT_45, headers=headers) for headers in (GZIP, PLAIN))
        assert compressed.headers["Content-Encoding"] == "gzip"
        assert "Content-Encoding" not in plain.headers
        assert compressed.content == plain.content
        for answer in (compressed, plain):
            assert "accept-encoding" in answer.headers["Vary"].lower()
        assert int(compressed.headers["Content-Length"]) < 0.6 * int(plain.headers["Content-Length"])


def test_small_answer_and_files_that_are_compressed_already_are_left_as_they_are(client: httpx.Client) -> None:
    key = client.post("/trajectory", json=PAPER_AT_45).json()["key"]
    assert "Content-Encoding" not in client.get("/version", headers=GZIP).headers
    answer, raw = received(client, f"/results/{key}", Accept="application/x-hdf5", **GZIP)
    assert "Content-Encoding" not in answer.headers
    assert raw.startswith(b"ricochet results, HDF5")
    assert not answer.headers["ETag"].startswith("W/")


def test_compressed_answer_has_a_weak_tag_that_still_spares_sending_it_again(client: httpx.Client) -> None:
    key = client.post("/trajectory", json=PAPER_AT_45).json()["key"]
    plain, compressed = (client.get(f"/results/{key}", headers=headers) for headers in (PLAIN, GZIP))
    assert compressed.headers["ETag"] == "W/" + plain.headers["ETag"]
    assert {part.strip().lower() for part in compressed.headers["Vary"].split(",")} == {"accept", "accept-encoding"}
    for tag in (plain.headers["ETag"], compressed.headers["ETag"]):
        assert client.get(f"/results/{key}", headers=GZIP | {"If-None-Match": tag}).status_code == 304


def test_results_of_a_job_are_compressed_as_they_are_sent_and_events_are_not(client: httpx.Client) -> None:
    job = finished(client, client.post("/cra/batch", json={"cases": searches(30)}, headers=ASYNC).json())
    path = job["links"]["results"]
    answers = [received(client, path, Accept="application/jsonl", **headers) for headers in (GZIP, PLAIN)]
    assert [answer.headers.get("Content-Encoding") for answer, _ in answers] == ["gzip", None]
    assert len(answers[0][1]) < 0.5 * len(answers[1][1])
    assert client.get(path, headers={"Accept": "application/jsonl"} | GZIP).content == answers[1][1]
    events, _ = received(client, job["links"]["events"], **GZIP)
    assert "Content-Encoding" not in events.headers


def test_nothing_is_compressed_unless_it_is_set(client: httpx.Client, dedicated_service: Any) -> None:
    with httpx.Client(base_url=dedicated_service.url, timeout=60.0, trust_env=False) as other:
        answer = other.post("/trajectory", json=PAPER_AT_45, headers=GZIP)
    assert "Content-Encoding" not in answer.headers
    assert answer.json() == client.post("/trajectory", json=PAPER_AT_45).json()
