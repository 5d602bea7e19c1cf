"""A batch whose cases are a CSV table."""

import json
from pathlib import Path
from typing import Any

import pytest

from service import cli
from tests.cli.commands import case_at, write_cases

CONE = {"shape": "conical", "length_to_diameter": 1.5}
NONE = {"free_surface": {"model": "none"}}
WHOLE = (
    "custom_id,projectile.diameter_m,length_m,mass_kg,caliber_radius_head,compressive_strength_pa,density_kg_m3,velocity_m_s\n"
    "7,0.08,0.53,13,3,39e6,2250,238\n"
)


@pytest.mark.parametrize(
    ("table", "base", "cases"),
    [
        (WHOLE, False, [case_at(238.0, custom_id="7")]),
        ("velocity_m_s\n238\n\n240\n", True, [case_at(238.0), case_at(240.0)]),
        ("impact.velocity_m_s;custom_id\n238;a\n240;\n", True, [case_at(238.0, custom_id="a"), case_at(240.0)]),
        ("\ufeffvelocity_m_s\tfree_surface.model\r\n240\tnone\r\n", True, [case_at(240.0, resistance=NONE)]),
        (
            "length_to_diameter, mass_kg \n1.5, 13.0 \n",
            True,
            [case_at(238.0, projectile={**case_at(238.0)["projectile"], "nose": CONE})],
        ),
        ("upper_deg,search.lower_deg\n70,30\n", True, [case_at(238.0, search={"lower_deg": 30.0, "upper_deg": 70.0})]),
    ],
)
def test_rows_are_cases(
    served: Path, capsys: pytest.CaptureFixture[str], table: str, base: bool, cases: list[dict[str, Any]]
) -> None:
    (served / "cases.csv").write_text(table, newline="")
    write_cases(served / "cases.jsonl", *cases)
    assert cli.main(["batch", "cases.csv", *(["--case", "strike.toml"] if base else []), "--json"]) == 0
    found = capsys.readouterr().out
    assert cli.main(["batch", "cases.jsonl", "--json"]) == 0
    assert [json.loads(line) for line in found.splitlines()] == [
        json.loads(line) for line in capsys.readouterr().out.splitlines()
    ]


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ("velocty_m_s\n238\n", "cases.csv:1: column 'velocty_m_s': is not a field of a request; did you mean"),
        ("velocity\n238\n", "did you mean `impact.velocity_m_s`?"),
        ("model\nnone\n", "must be one of resistance.free_surface.model, resistance.strength_factor.model"),
        ("velocity_m_s,\n238,1\n", "cases.csv:1: column '': must be one of the fields of a request"),
        ("velocity_m_s\n238,5\n", "cases.csv:2: 2 cells for 1 columns"),
        (
            "velocity_m_s;mass_kg\n238;13\n238,5;13\n",
            "cases.csv:3: /impact/velocity_m_s: must be a number, got '238,5'",
        ),
        ("velocity_m_s\n\n238\n-1\n", "cases.csv:4: /impact/velocity_m_s: "),
        ("nose.shape,caliber_radius_head\nconical,3\n", "cases.csv:2: --caliber-radius-head: is of ogive or spherical"),
        ("", "cases.csv: the file is empty"),
        ("velocity_m_s\n", "has no line"),
    ],
)
def test_what_is_wrong_names_the_line_and_the_column(
    served: Path, capsys: pytest.CaptureFixture[str], table: str, reason: str
) -> None:
    (served / "cases.csv").write_text(table)
    assert cli.main(["batch", "cases.csv", "--case", "strike.toml"]) == 2
    assert reason in capsys.readouterr().err


def test_walls_leave_out_what_is_sought(served: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (served / "cases.csv").write_text("oblique_angle_deg,relative_tolerance\n0,1e-3\n20,1e-3\n")
    words = ["batch", "cases.csv", "--operation", "thickness", "--case", "strike.toml", "--csv"]
    assert cli.main(words) == 0
    assert capsys.readouterr().out.count("converged") == 2


def test_a_case_beside_json_lines_is_refused(served: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_cases(served / "cases.jsonl", case_at(238.0))
    assert cli.main(["batch", "cases.jsonl", "--case", "strike.toml"]) == 2
    assert "--case needs a table" in capsys.readouterr().err
