"""The verdict on a strike: the same words and numbers wherever it is said, and the usual scatter behind it."""

import html
import json
import math
import re
from pathlib import Path

import httpx
import pytest

from service import cli
from service.schemas import ReportRequest
from service.schemas.strike import PAPER
from solver.uncertainty import verdict

from .calibrations import answered

AT_50 = PAPER | {"impact": PAPER["impact"] | {"oblique_angle_deg": 50.0}}


def test_verdict_is_the_same_by_http_python_command_line_and_report(
    client: httpx.Client, live_url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = answered(client, "/verdict", AT_50)
    arguments, _ = ReportRequest.model_validate(AT_50).arguments()
    by_python = verdict(**arguments, oblique_angle=math.radians(50.0), threads=2)
    assert str(by_python) == found["sentence"]
    assert by_python.spread is not None
    assert [math.degrees(each) for each in by_python.spread] == pytest.approx(list(found["range"].values()), abs=1e-6)
    assert by_python.probability == pytest.approx(found["ricochet_probability"], abs=1e-9)
    details = [each["detail"] for each in found["warnings"]]
    assert [each.detail for each in by_python.warnings] == details
    case = tmp_path / "strike.json"
    case.write_text(json.dumps(AT_50), encoding="utf-8")
    for where in ([], ["--url", live_url]):
        assert cli.main(["cra", str(case), *where]) == 0
        shown = capsys.readouterr()
        assert shown.out == f"{found['sentence']}\n"
        assert shown.err == f"standing notes (-v explains): {', '.join(each['code'] for each in found['warnings'])}\n"
    page = client.post("/report", json=AT_50).text
    [said] = re.findall(r'<p class="answer">(.*?)</p>', page)
    assert html.unescape(re.sub("<[^>]+>", "", said)) == found["sentence"]
    assert f"<strong>{found['range_text']}</strong>" in said
    assert all(f"{detail[1:]}." in html.unescape(page).partition("Standing notes")[2] for detail in details)
