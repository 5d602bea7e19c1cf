"""`ricochet formulas`: a table, JSON and CSV, the same from a service."""

import json
import math
import re
from pathlib import Path

import pytest

from service import cli
from tests.cli.commands import run


def test_table_distinguishes_what_is_in_range(folder: Path) -> None:
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


@pytest.mark.parametrize(("thickness", "judged"), [(0.3, "300 mm: not enough. "), (0.5, "500 mm: enough. ")])
def test_thickness_begins_with_the_design_value(
    folder: Path, capsys: pytest.CaptureFixture[str], thickness: float, judged: str
) -> None:
    path = folder / "wall.toml"
    path.write_text((folder / "strike.toml").read_text().replace("[target]", f"[target]\nthickness_m = {thickness}"))
    assert cli.main(["formulas", str(path), "--angle", "45", "--json"]) == 0
    highest = json.loads(capsys.readouterr().out)["perforation_thickness_spread"]["highest"]
    assert cli.main(["thickness", str(path), "--angle", "45"]) == 0
    design = f"Design value at least {math.ceil(1200.0 * highest)} mm (largest formula within its range × 1.2)."
    assert capsys.readouterr().out.splitlines()[0] == judged + design


@pytest.mark.parametrize(
    ("flags", "judged"),
    [
        (
            ("--thickness", "0.2"),
            "238 m/s: perforated. Limit speed {0:.0f} m/s of a wall of 200 mm at 20° from the normal",
        ),
        (("--thickness", "50"), "No limit speed of a wall of 50000 mm at 20° from the normal: never perforated."),
    ],
)
def test_limit_speed_begins_with_a_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], judged: str
) -> None:
    args = ["limit-speed", str(folder / "strike.toml"), "--angle", "20", *flags]
    assert cli.main([*args, "--json"]) == 0
    limit = json.loads(capsys.readouterr().out).get("limit_speed_m_s")
    assert cli.main(args) == 0
    assert capsys.readouterr().out.splitlines()[0].startswith(judged.format(limit))


def test_service_gives_the_same_answer(folder: Path, live_url: str) -> None:
    local, remote = (run(folder, "formulas", "strike.toml", "--json", *at) for at in ((), ("--url", live_url)))
    assert local.status == remote.status == 0, remote.err
    assert json.loads(local.out) == json.loads(remote.out)


def test_csv_has_a_row_for_each_formula(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["formulas", str(folder / "strike.toml"), "--csv"]) == 0
    names, *rows = capsys.readouterr().out.splitlines()
    assert names.startswith("formula,penetration_depth_m,scabbing_thickness_m,perforation_thickness_m,in_range")
    assert len(rows) == 11


def test_other_parts_of_a_file_are_left_out(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = folder / "search.toml"
    path.write_text((folder / "strike.toml").read_text() + "\n[search]\ntolerance_deg = 0.1\n")
    assert cli.main(["formulas", str(path)]) == 0
    assert "Modified NDRC" in capsys.readouterr().out
