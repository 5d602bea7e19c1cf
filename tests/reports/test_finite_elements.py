"""The finite element comparison reports what comes out, whatever it is."""

import math

import numpy as np
import pytest

from service.reports import style
from service.reports.contents import Section
from service.reports.finite_elements import account
from service.reports.finite_elements.calibration import BRACKETING, CALIBRATED, Calibrations, calibrations
from service.reports.finite_elements.comparison import compare
from service.reports.finite_elements.prediction import CHOSEN, PAPER, bracket
from service.reports.paper.strike import time_of_deepest_tip
from service.reports.reference import finite_element_run, finite_element_runs
from solver import mass_properties
from solver.cases import PAPER_PROJECTILE


@pytest.fixture(scope="module")
def found() -> Calibrations:
    return calibrations(lambda what: None)


@pytest.fixture(scope="module")
def report(found: Calibrations) -> Section:
    with style.styled():
        return compare(found, lambda what: None)


def test_finite_elements_change_their_outcome_between_50_and_52_degrees() -> None:
    assert np.degrees(bracket(finite_element_runs())) == pytest.approx([50.0, 52.0])


def test_outcomes_are_those_of_the_histories() -> None:
    """Turned away where the nose tip is outside at the end, not elsewhere."""
    ahead = mass_properties(PAPER_PROJECTILE).center_of_gravity
    for run in finite_element_runs():
        turn = math.cos(run.oblique_angle + run.rotation[-1]) - math.cos(run.oblique_angle)
        assert (run.depth_displacement[-1] + ahead * turn < 0.0) == (run.outcome == "ricochet")


def test_each_run_is_fitted_until_its_nose_tip_is_deepest(found: Calibrations) -> None:
    for each in found.by_motion:
        assert each.fit.predicted.time[-1] == time_of_deepest_tip(each.run)


def test_strength_factors_fall_with_the_angle_as_in_the_paper(found: Calibrations) -> None:
    factors = [estimate.strength_factor for estimate in found.points.values()]
    assert factors == sorted(factors, reverse=True)
    for each in found.by_motion:
        low, high = each.estimate.confidence_interval
        assert low < each.estimate.strength_factor < high


def test_no_one_strength_factor_serves_position_and_rotation(found: Calibrations) -> None:
    for each in found.of(CALIBRATED):
        alone = {name: estimate.strength_factor for name, estimate in each.alone.items()}
        assert alone["depth_displacement"] < each.estimate.strength_factor < alone["rotation"]
        assert alone["lateral_displacement"] < each.estimate.strength_factor
    for each in found.of(CALIBRATED[:2]):
        assert "poor_fit" in {warning.code for warning in each.fit.warnings}


def test_every_reading_of_the_calibration_is_told(report: Section) -> None:
    (table,) = (table for table in report.tables if table.name == "finite-elements-angles")
    angles = {row[0]: row[1] for row in table.rows}
    assert len(angles) == 8
    assert all(isinstance(angle, float) and 40.0 < angle < 70.0 for angle in angles.values())
    assert "degrees of freedom are 1" in " ".join(report.text)


def test_strength_factor_and_angle_and_bracket_stand_side_by_side(report: Section, found: Calibrations) -> None:
    compared = {each.what: each for each in report.comparisons}
    assert len(compared) == 2 + 1 + len(CALIBRATED)
    assert compared["S at 0°, finite element depths"].ours == found.by_depth.estimate.strength_factor
    for degrees, each in zip((15, 30, 45), found.of(CALIBRATED), strict=True):
        assert compared[f"S at {degrees}°, finite element motion"].ours == each.estimate.strength_factor
    predicted = compared[f"critical angle, {CHOSEN}"]
    assert 45.0 < predicted.ours < 60.0
    assert predicted.reference == pytest.approx(51.0)
    assert "standard error" in predicted.note
    assert compared[f"critical angle, {PAPER}"].ours == pytest.approx(48.63, abs=0.05)
    text = " ".join(report.text)
    assert f"predicted {predicted.ours:.1f}°" in text
    assert "between 50° (sliding) and 52° (ricochet)" in text


@pytest.mark.parametrize(
    ("angle", "error", "words"),
    [
        (51.0, 1.0, "between these"),
        (52.3, 1.0, "0.3° above both, less than its standard error"),
        (47.0, 1.0, "3.0° below both, more than its standard error"),
        (55.0, None, "3.0° above both, with a standard error that is not known"),
        (None, None, "missing, so nothing can be compared"),
    ],
)
def test_any_prediction_is_placed(angle: float | None, error: float | None, words: str) -> None:
    assert account.placed(angle, error, 50.0, 52.0) == words


def test_cost_of_finite_elements_and_of_the_model_are_both_there(report: Section) -> None:
    (table,) = (table for table in report.tables if table.name == "finite-elements-cost")
    spent = sum(finite_element_run(name).cpu_seconds for name in BRACKETING)
    assert table.rows[1][1] == spent
    search = table.rows[3][2]
    assert isinstance(search, float)
    assert search < spent / 100.0


def test_figures_show_every_oblique_run(report: Section) -> None:
    shown = {str(name).split(",")[0] for figure in report.figures[::2] for name in figure.data["series"]}
    assert shown == {run.name for run in finite_element_runs() if run.oblique_angle > 0.0}
