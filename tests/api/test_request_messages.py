"""Requests that are meant well are told what to send instead."""

from typing import Any

import httpx
import pytest

from service.queries import CASE_SECONDS, Rate
from service.schemas.strike import PAPER, PAPER_AT_45

from .refused import refused_at

WALL = PAPER_AT_45 | {"target": PAPER["target"] | {"thickness_m": 0.4}}


@pytest.mark.parametrize(
    ("path", "body", "pointer", "words"),
    [
        ("/cra", PAPER_AT_45, "/impact/oblique_angle_deg", "`/trajectory` takes a strike at one angle"),
        ("/cra/batch", {"cases": [PAPER_AT_45]}, "/cases/0/impact/oblique_angle_deg", "`/trajectory` takes a strike"),
        ("/thickness", WALL, "/target/thickness_m", "must not be given"),
        ("/limit-speed", WALL, "/impact/velocity_m_s", "`/thickness` and `/trajectory` take one speed"),
        ("/cra/batch", {"cases": [PAPER] * 2000}, "/cases", "send JSON lines (`application/jsonl`), up to 100,000"),
        ("/cra", PAPER | {"target": "concrete"}, "/target", "must be an object, got 'concrete'"),
        ("/cra", PAPER | {"target": 3}, "/target", "must be an object, got 3"),
    ],
)
def test_message_names_what_to_send(
    client: httpx.Client, path: str, body: dict[str, Any], pointer: str, words: str
) -> None:
    found = refused_at(client.post(path, json=body), pointer)
    assert words in found.errors[0].detail
    assert words in found.detail


@pytest.mark.parametrize(
    ("method", "path", "takes"),
    [
        ("GET", "/jobs?limit=2&Cursor=", "cursor, limit"),
        ("GET", f"/results/{'0' * 64}?format=csv", "none"),
        ("GET", "/jobs/1/results?offset=3", "cursor, limit"),
        ("GET", "/jobs/1/events?since=3", "none"),
        ("POST", "/cra?wait=3", "none"),
        ("POST", "/cra/batch?respond=async", "none"),
        ("POST", "/cra/uncertainty?samples=3", "none"),
        ("POST", "/verdict?x", "none"),
        ("DELETE", "/jobs/1?force=true", "none"),
        ("PATCH", "/jobs/1?title=a", "none"),
    ],
)
def test_unknown_query_parameter_is_refused(client: httpx.Client, method: str, path: str, takes: str) -> None:
    content = b"{}" if method in {"POST", "PATCH"} else None
    response = client.request(method, path, content=content, headers={"Content-Type": "application/json"})
    assert response.status_code == 422, response.text
    (error,) = response.json()["errors"]
    assert error["detail"].startswith("unknown query parameter; there is ")
    assert takes in error["detail"]
    assert error["pointer"] == "/" + path.partition("?")[2].split("&")[-1].partition("=")[0]


def test_probes_may_have_what_a_monitor_adds(client: httpx.Client) -> None:
    assert client.get("/livez?time=1").status_code == 200


@pytest.mark.parametrize(("count", "weight", "seconds"), [(0, 1, 1), (1200, 1, 12), (1200, 20, 240)])
def test_wait_for_a_job_goes_by_the_cost_of_its_cases_until_a_rate_is_measured(
    count: int, weight: int, seconds: int
) -> None:
    assert CASE_SECONDS == 0.02
    assert Rate(lambda: 2).seconds_for(count, weight) == seconds
