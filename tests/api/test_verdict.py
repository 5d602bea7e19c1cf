"""The verdict on a strike: the same words and numbers wherever it is said, and the usual scatter behind it."""

import html
import json
import math
import re
from pathlib import Path
from typing import Any

import httpx
import pytest

from service import cli
from service.schemas import ReportRequest
from service.schemas.strike import PAPER
from solver.uncertainty import verdict
from tests.odd_strikes import KINDS, odd_strikes

from .calibrations import answered

AT_50 = PAPER | {"impact": PAPER["impact"] | {"oblique_angle_deg": 50.0}}


def check_is_the_same_everywhere(
    body: dict[str, Any], client: httpx.Client, live_url: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Compare the sentence on a strike by HTTP, Python, command line here and there, and report."""
    found = answered(client, "/verdict", body)
    request, angle = ReportRequest.model_validate(body), body["impact"].get("oblique_angle_deg")
    arguments, _ = request.arguments()
    by_python = verdict(**arguments, oblique_angle=None if angle is None else math.radians(angle), threads=2)
    assert str(by_python) == found["sentence"]
    if by_python.spread is not None:
        spread = [math.degrees(each) for each in by_python.spread]
        # A sample whose last bit differs, as degrees become radians there, may end a search one bracket apart.
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
        shown = capsys.readouterr()
        assert shown.out.splitlines()[0] == found["sentence"]
        assert all(each["code"] in shown.err for each in found["warnings"])
    page = client.post("/report", json=body).text
    said, *_ = re.findall(r'<p class="answer">(.*?)</p>', page)
    assert html.unescape(re.sub("<[^>]+>", "", said)) == found["sentence"]
    assert (f"<strong>{found['range_text']}</strong>" in said) is bool(found["range_text"])
    words = html.unescape(page)
    assert [detail for detail in details if f"{detail[1:]}." not in words] == []


@pytest.mark.timeout(900)
@pytest.mark.parametrize("body", [AT_50, *odd_strikes(len(KINDS), seed=5)], ids=["paper", *KINDS])
def test_verdict_is_the_same_by_http_python_command_line_and_report(
    client: httpx.Client, live_url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], body: dict[str, Any]
) -> None:
    check_is_the_same_everywhere(body, client, live_url, tmp_path, capsys)


@pytest.mark.slow
@pytest.mark.timeout(14400)
def test_verdict_on_odd_strikes_is_the_same_everywhere(
    client: httpx.Client, live_url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for body in odd_strikes(60, seed=6):
        check_is_the_same_everywhere(body, client, live_url, tmp_path, capsys)
