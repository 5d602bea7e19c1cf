"""`ricochet formulas`, `thickness` and `limit-speed`: output in all formats, with and without a service."""

import json
import re
import tomllib
from pathlib import Path

import httpx
import pytest

from service import cli
from tests.api.calibrations import answered
from tests.cli.commands import run


def test_table_marks_formulas_out_of_range(folder: Path) -> None:
    done = run(folder, "formulas", "strike.toml")
    assert (done.status, done.err) == (0, ""), done.err
    lines = {re.split("  +", line)[0]: line for line in done.out.splitlines() if line.strip()}
    assert "*+" in lines["CEA-EDF"]
    assert "*" not in lines["Modified NDRC"]
    assert "?!+" in lines["BRL"]
    assert "! Whiffen: within 15 % of its tests; largest aggregate taken as 20 mm" in done.out
    assert "? the range of the formula is not known" in done.out
    assert "* CEA-EDF: speed: fitted from 20 m/s to 200 m/s along the normal, here 238 m/s" in done.out
    assert "1.2 on perforation" in done.out


@pytest.mark.parametrize("thickness", [0.3, 3.0])
def test_output_of_thickness_begins_with_the_verdict_on_the_wall(
    folder: Path, capsys: pytest.CaptureFixture[str], client: httpx.Client, thickness: float
) -> None:
    path = folder / "wall.toml"
    path.write_text((folder / "strike.toml").read_text().replace("[target]", f"[target]\nthickness_m = {thickness}"))
    assert cli.main(["thickness", str(path), "--angle", "45"]) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    body = tomllib.loads(path.read_text())
    body["impact"]["oblique_angle_deg"] = 45.0
    judged = answered(client, "/wall", body)
    assert first == judged["sentence"]
    assert judged["enough"] is (thickness == 3.0)
    del body["target"]["thickness_m"]
    assert second == answered(client, "/thickness", body)["sentence"]


@pytest.mark.parametrize(("thickness", "value"), [("0.2", "m/s (90 % range over S, "), ("50", "never perforated")])
def test_output_of_limit_speed_begins_with_the_sentence_of_the_service(
    folder: Path, capsys: pytest.CaptureFixture[str], thickness: str, value: str
) -> None:
    args = ["limit-speed", str(folder / "strike.toml"), "--angle", "20", "--thickness", thickness]
    assert cli.main([*args, "--json"]) == 0
    sentence = json.loads(capsys.readouterr().out)["sentence"]
    assert cli.main(args) == 0
    assert capsys.readouterr().out.splitlines()[0] == sentence
    assert "This model, which is unconservative: " in sentence
    assert value in sentence


def test_service_gives_the_same_answer(folder: Path, live_url: str) -> None:
    local, remote = (run(folder, "formulas", "strike.toml", "--json", *at) for at in ((), ("--url", live_url)))
    assert local.status == remote.status == 0, remote.err
    assert json.loads(local.out) == json.loads(remote.out)


def test_csv_has_one_row_per_formula(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["formulas", str(folder / "strike.toml"), "--csv"]) == 0
    names, *rows = capsys.readouterr().out.splitlines()
    assert names.startswith("formula,penetration_depth_m,scabbing_thickness_m,perforation_thickness_m,in_range")
    assert len(rows) == 11


def test_parts_of_a_file_that_formulas_do_not_need_are_ignored(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "search.toml"
    path.write_text((folder / "strike.toml").read_text() + "\n[search]\ntolerance_deg = 0.1\n")
    assert cli.main(["formulas", str(path)]) == 0
    assert "Modified NDRC" in capsys.readouterr().out
