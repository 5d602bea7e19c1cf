"""The verdict on a strike: the same words and numbers wherever it is given, and the usual scatter that it includes."""

import html
import json
import math
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import httpx
import pytest

from service import cli
from service.schemas import ReportRequest
from service.schemas.flight import FlightInput
from service.schemas.strike import PAPER
from solver.uncertainty import verdict
from tests.conftest import Service, running_service
from tests.odd_strikes import KINDS, odd_strikes

from .calibrations import answered

AT_50 = PAPER | {"impact": PAPER["impact"] | {"oblique_angle_deg": 50.0}}
OFF_A_WALL = PAPER | {
    "impact": PAPER["impact"] | {"oblique_angle_deg": 55.0},
    "flight": {"face_tilt_deg": 90.0, "incidence_plane": "level", "height_m": 3.0},
}


def check_is_the_same_everywhere(
    body: dict[str, Any], client: httpx.Client, live_url: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Check that HTTP, Python, the report, and the command line with and without a service give the same sentence."""
    found = answered(client, "/verdict", body)
    request, angle = ReportRequest.model_validate(body), body["impact"].get("oblique_angle_deg")
    # Searches and strikes have different default tolerances. The arguments contain that of searches, so it is removed.
    arguments = request.arguments()[0] | ({} if "numerics" in body else {"numerics": None})
    flight = FlightInput.model_validate(body.get("flight", {})).to_solver()
    oblique_angle = None if angle is None else math.radians(angle)
    by_python = verdict(**arguments, oblique_angle=oblique_angle, flight=flight, threads=2)
    assert str(by_python) == found["sentence"]
    assert ("Lands about" in found["sentence"]) is ("flight" in found) is (found.get("outcome") == "ricochet")
    if by_python.spread is not None:
        spread = [math.degrees(each) for each in by_python.spread]
        # Angles converted to radians may differ in the last bit, so a search may end in a neighbouring bracket.
        assert spread == pytest.approx(list(found["range"].values()), abs=0.02)
    if by_python.probability is not None:
        assert by_python.probability.value == pytest.approx(found["ricochet_probability"], abs=5e-3)
    details = [each["detail"] for each in found["warnings"]]
    assert [each.detail for each in by_python.warnings] == details
    assert found.get("wall", {}).get("enough") == (None if by_python.wall is None else by_python.wall.enough)
    case = folder / "strike.json"
    case.write_text(json.dumps(body), encoding="utf-8")
    for where in ([], ["--url", live_url]):
        assert cli.main(["cra", str(case), *where]) == 0
        assert capsys.readouterr().out.splitlines()[0] == found["sentence"]
        assert cli.main(["cra", str(case), "-v", *where]) == 0
        told = capsys.readouterr()
        assert found["sentence"] in told.out.splitlines()
        assert [detail for detail in details if detail not in told.err] == []
    page = client.post("/report", json=body).text
    said, *_ = re.findall(r'<p class="answer">(.*?)</p>', page)
    assert html.unescape(re.sub("<[^>]+>", "", said)) == found["sentence"]
    assert (f"<strong>{found['range_text']}</strong>" in said) is bool(found["range_text"])
    words = html.unescape(page)
    assert [detail for detail in details if f"{detail[1:]}." not in words] == []


@pytest.mark.timeout(900)
@pytest.mark.parametrize("body", [AT_50, OFF_A_WALL, *odd_strikes(len(KINDS), seed=5)], ids=["paper", "wall", *KINDS])
def test_verdict_is_the_same_over_http_in_python_on_the_command_line_and_in_the_report(
    client: httpx.Client, live_url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], body: dict[str, Any]
) -> None:
    check_is_the_same_everywhere(body, client, live_url, tmp_path, capsys)


@pytest.mark.slow
@pytest.mark.timeout(14400)
def test_verdict_on_odd_strikes_is_the_same_everywhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time limits are raised, because some verdicts take minutes, and a verdict whose study is cut off has no range."""
    monkeypatch.setattr("service.cli.client.TIMEOUT", httpx.Timeout(3600.0))
    with (
        running_service(tmp_path, study_seconds="3600", task_seconds="600") as service,
        httpx.Client(base_url=service.url, timeout=3600.0, trust_env=False) as client,
    ):
        for body in odd_strikes(60, seed=6):
            check_is_the_same_everywhere(body, client, service.url, tmp_path, capsys)


@pytest.mark.parametrize(
    ("numerics", "settings", "reason"),
    [
        ({"relative_tolerance": 1e-10}, {"study_seconds": "3"}, "the 90 % range could not be computed"),
        ({"method": "panels", "panels": 100}, {}, "no 90 % range by panels"),
    ],
    ids=["study beyond its time limit", "panels"],
)
def test_verdict_without_a_range_states_the_reason(
    service_on: Callable[..., AbstractContextManager[Service]],
    tmp_path: Path,
    numerics: dict[str, Any],
    settings: dict[str, str],
    reason: str,
) -> None:
    with (
        service_on(tmp_path, **settings) as service,
        httpx.Client(base_url=service.url, timeout=180.0, trust_env=False) as client,
    ):
        found = answered(client, "/verdict", AT_50 | {"numerics": numerics})
    assert found["range_text"] == ""
    assert "range" not in found
    assert re.search(rf"Critical angle 4[89]\.\d° from the normal, {reason}\.$", found["sentence"])


def test_scatter_of_the_paper_tests_narrows_the_range_only_on_request(client: httpx.Client) -> None:
    plain, near, preset = (
        answered(client, "/verdict", body)
        for body in (
            PAPER,
            PAPER | {"target": PAPER["target"] | {"compressive_strength_pa": 39.1e6}},
            PAPER | {"strength_scatter": "paper_table_1"},
        )
    )
    assert plain["critical_angle_deg"] == preset["critical_angle_deg"] == pytest.approx(48.63, abs=0.02)
    width = [each["range"]["upper_deg"] - each["range"]["lower_deg"] for each in (plain, near, preset)]
    assert width[0] == pytest.approx(width[1], abs=0.3)
    assert width[2] < 0.6 * width[0]
    assert "own_tests" not in plain
    assert preset["own_tests"]["shots"] == 4
    assert "scatter_of_table_1" in [each["code"] for each in preset["warnings"]]
    assert plain["keys"]["cra"] != preset["keys"]["cra"]
    assert plain["usual_scatter"][-1] == {
        "field": "resistance.theory",
        "distribution": {"type": "discrete", "values": ["elastic_plastic", "mohr_coulomb"], "weights": [0.8, 0.2]},
    }
    theories = {each["free_surface"]: each["critical_angle_deg"] for each in plain["theories"]}
    assert 46.6 <= theories["mohr_coulomb"] <= 48.4
