import csv
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from service.reports import style
from solver.strike import PAPER_PROJECTILE
from validation.__main__ import main
from validation.critical_angle import search_section, turning_section
from validation.motion import PAPER_STEP, STEPS, sensitivity_section
from validation.reference import equation_9, paper_numbers, paper_value, table_1
from validation.report import Comparison, Progress, Section
from validation.reproduction import open_points_section
from validation.strength_factor import FIRED_DIAMETER, depth_section, fit, obliquity_section

FIGURES = {f"figure-{number:02d}" for number in (6, *range(8, 19))}
CHEAP = (depth_section, obliquity_section, search_section, turning_section, sensitivity_section, open_points_section)


@cache
def section_of(make: Callable[[Progress], Section]) -> Section:
    with style.styled():
        return make(lambda _: None)


def compared(make: Callable[[Progress], Section], start: str) -> Comparison:
    (found,) = (each for each in section_of(make).comparisons if each.what.startswith(start))
    return found


def test_table_1_gives_the_strength_factor_of_the_paper() -> None:
    assert compared(depth_section, "S from Table 1, 13 kg").ours == pytest.approx(8.44, abs=0.02)
    assert compared(depth_section, "S from Table 1, tabulated masses").ours == pytest.approx(8.38, abs=0.02)
    assert compared(depth_section, "S from Table 1, 13 kg").reference == paper_value(
        "strength_factor", "oblique angle 0 deg"
    )


def test_fired_diameter_gives_a_higher_strength_factor() -> None:
    slim = replace(PAPER_PROJECTILE, diameter=FIRED_DIAMETER)
    assert fit(table_1(), own_masses=True, projectile=slim).estimate.strength_factor == pytest.approx(9.2, abs=0.05)


def test_critical_angle_agrees_with_the_paper_within_its_tolerance() -> None:
    printed = paper_value("critical_ricochet_angle_deg")
    for method in ("bisection", "secant", "outcome"):
        found = compared(search_section, f"critical angle by {method}")
        assert found.reference == printed
        assert found.ours == pytest.approx(printed, rel=paper_value("relative_tolerance"))


def test_critical_angles_of_other_readings_agree_with_the_separate_program() -> None:
    known = {"all as in this report": 48.64, "ν = 0.2": 49.13, "no decay near the face": 57.53, "tip at 5 ms": 48.61}
    for choice, angle in known.items():
        assert compared(open_points_section, f"critical angle, {choice}").ours == pytest.approx(angle, abs=0.03)


@pytest.mark.parametrize("make", CHEAP, ids=lambda make: make.__name__)
def test_every_value_is_within_its_tolerance(make: Callable[[Progress], Section]) -> None:
    assert [each.what for each in section_of(make).comparisons if each.holds is False] == []


def test_references_named_after_the_paper_are_numbers_that_it_prints() -> None:
    printed = {number.value for number in paper_numbers()}
    claimed = [
        each
        for make in CHEAP
        for each in section_of(make).comparisons
        if re.match(r"Table|eq\.|Figure", each.reference_source)
    ]
    assert len(claimed) > 10
    assert {each.reference for each in claimed} <= printed


def test_trials_count_as_turned_away_if_they_end_above_the_face() -> None:
    bisection = section_of(search_section).tables[0]
    _, degrees, early, final, turned_away = zip(*bisection.rows, strict=True)
    assert degrees[:3] == pytest.approx((40.0, 60.0, 50.0))
    assert turned_away[:4] == ("no", "yes", "yes", "no")
    assert early[0] == pytest.approx(final[0])  # The projectile is at rest by then.
    assert early[1] > final[1]  # The depth is still increasing.


def test_finer_steps_and_more_elements_converge_to_the_adaptive_route() -> None:
    (table,) = section_of(sensitivity_section).tables
    far = {(row[0], row[1]): row[4] for row in table.rows}
    assert far[PAPER_STEP * 1e3, 12_000] < 0.1 * far[STEPS[0] * 1e3, 12_000]  # type: ignore[operator]
    assert far[PAPER_STEP * 1e3, 12_000] < 0.1 * far[PAPER_STEP * 1e3, 750]  # type: ignore[operator]


@pytest.mark.slow
def test_whole_paper_is_reproduced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "--output", str(tmp_path)]) == 0
    assert str(tmp_path / "index.html") in capsys.readouterr().out
    for suffix in ("png", "svg", "csv"):
        assert {path.stem for path in (tmp_path / "figures").glob(f"figure-*.{suffix}")} >= FIGURES
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|<script", page)
    with (tmp_path / "comparisons.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["what"] for row in rows if row["holds"] == "no"] == []
    assert {float(row["reference"]) for row in rows if row["reference"]} >= {
        8.52,
        8.25,
        7.91,
        6.48,
        *equation_9(),
        48.2,
    }


@pytest.mark.slow
def test_two_reports_differ_only_in_times(tmp_path: Path) -> None:
    for name in ("one", "two"):
        assert main(["reproduce", "--output", str(tmp_path / name)]) == 0
    timed = re.compile(r"index\.html|cost|comparisons|figure-16|finite")
    for path in (tmp_path / "one").rglob("*.*"):
        if not timed.search(path.name):
            twin = tmp_path / "two" / path.relative_to(tmp_path / "one")
            assert path.read_bytes() == twin.read_bytes(), path.name
