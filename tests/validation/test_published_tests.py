"""Depths of published tests: predictions, excluded tests, and the difference between the two methods."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.reports import style
from solver import ConstantStrengthFactor, solid_properties
from solver.calibration import DepthTest, fit_depth
from validation.__main__ import main
from validation.depth_ratios import crater_differences, ratios_section
from validation.depth_tests import (
    ALL_MODELS,
    CLOSED_FORM,
    CONSTANT,
    FACTOR_MODELS,
    LEFT_OUT,
    METHODS,
    OUTLIER_ROW,
    POWER_LAW,
    TRAJECTORY,
    Assessment,
    PublishedStrike,
    crater_depth,
    depth_curve,
    every,
    fit_factor,
    grades,
    leave_one_out,
    of_diameter,
    of_group,
    of_series,
    strikes,
    trajectory_depth,
)
from validation.published_tests import parts
from validation.published_tests import tests_section as listing_section
from validation.reference import penetration_tests, table_2
from validation.report import Section

WEAK_2006 = "frew-2006, 23 MPa"


@pytest.fixture(scope="module")
def sections(assessment: Assessment) -> list[Section]:
    with style.styled():
        return list(parts(assessment, lambda what: None))


def outlier_place(assessment: Assessment) -> int:
    (place,) = (place for place, strike in enumerate(assessment.strikes) if strike.test.row == OUTLIER_ROW)
    return place


def test_closed_form_with_the_power_law_agrees_with_the_1994_series(assessment: Assessment) -> None:
    found = assessment.agreement(CLOSED_FORM, POWER_LAW, of_series("forrestal-1994"))
    assert found.number == 16
    assert found.mean_ratio == pytest.approx(1.02, abs=0.03)
    assert found.coefficient_of_variation == pytest.approx(0.08, abs=0.02)
    claims = {comparison.what: comparison.holds for comparison in ratios_section(assessment).comparisons}
    assert [holds for what, holds in claims.items() if "closed form" in what] == [True, True]
    assert [holds for what, holds in claims.items() if "trajectory model" in what] == [
        None,
        None,
    ]  # No value is claimed for this model.


def test_published_mean_of_the_1994_series_includes_its_outlier(assessment: Assessment) -> None:
    ratios = assessment.ratios(CLOSED_FORM, POWER_LAW)
    of_1994 = ratios[[strike.test.series == "forrestal-1994" for strike in assessment.strikes]]
    assert round(float(of_1994.mean()), 2) == 1.02


def test_trajectory_model_predicts_smaller_depths_than_the_closed_form_in_the_1994_series(
    assessment: Assessment,
) -> None:
    ours, closed = (assessment.agreement(each, POWER_LAW, of_series("forrestal-1994")) for each in METHODS)
    assert 0.02 < closed.mean_ratio - ours.mean_ratio < 0.04
    assert ours.mean_ratio == pytest.approx(1.0, abs=0.03)


def test_every_row_except_the_outlier_is_counted(assessment: Assessment) -> None:
    counted = {assessment.strikes[place].test.row for place in assessment.chosen(every)}
    assert counted == {test.row for test in penetration_tests()} - {OUTLIER_ROW}
    assert {assessment.agreement(method, model).number for method in METHODS for model in ALL_MODELS} == {54}


def test_outlier_is_not_used_in_any_fit(assessment: Assessment) -> None:
    """No fitted strength factor changes when the depth of the outlier is doubled."""
    place = outlier_place(assessment)
    curves = [depth_curve(strike, CLOSED_FORM) for strike in assessment.strikes]
    moved = with_depth(assessment.strikes, place, factor=2.0)
    np.testing.assert_array_equal(leave_one_out(moved, curves), leave_one_out(assessment.strikes, curves))


def with_depth(given: Sequence[PublishedStrike], place: int, *, factor: float) -> list[PublishedStrike]:
    """Return the same strikes with one measured depth multiplied by a factor."""
    strike = given[place]
    test = replace(strike.test, depth=factor * strike.test.depth)
    return [replace(strike, test=test) if index == place else each for index, each in enumerate(given)]


@pytest.mark.parametrize("place", [0, 20, 40])
def test_depth_of_a_test_affects_only_predictions_of_other_tests(assessment: Assessment, place: int) -> None:
    curves = [depth_curve(strike, CLOSED_FORM) for strike in assessment.strikes]
    before = leave_one_out(assessment.strikes, curves)
    after = leave_one_out(with_depth(assessment.strikes, place, factor=1.3), curves)
    group = assessment.strikes[place].group
    others = [other for other in assessment.chosen(of_group(group)) if other != place]
    elsewhere = [other for other, strike in enumerate(assessment.strikes) if strike.group != group]
    assert after[place] == before[place]
    assert np.all(after[others] < before[others])
    np.testing.assert_array_equal(after[elsewhere], before[elsewhere])


def test_factor_of_a_group_equals_the_calibration_by_depth(assessment: Assessment) -> None:
    """The group has one projectile and one concrete, so `fit_depth` applies to it."""
    group = [strike for strike in assessment.strikes if strike.group == WEAK_2006]
    tests = [DepthTest(velocity=each.test.velocity, depth=each.test.depth, mass=each.test.mass) for each in group]
    expected = fit_depth(projectile=group[0].projectile, target=group[0].target, tests=tests).estimate
    assert assessment.group_factors[TRAJECTORY, WEAK_2006] == pytest.approx(expected.strength_factor, rel=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_depth_curve_agrees_with_computed_depths(assessment: Assessment, method: str) -> None:
    for strike in assessment.strikes[::9]:
        curve = depth_curve(strike, method)
        for factor in (3.7, 7.1, 12.9):
            assert curve(factor) == pytest.approx(METHODS[method](strike, factor), rel=1e-5)


def test_fit_recovers_the_factor_of_computed_depths(assessment: Assessment) -> None:
    chosen = assessment.strikes[:5]
    made = [(crater_depth(strike, 6.5), depth_curve(strike, CLOSED_FORM)) for strike in chosen]
    assert fit_factor(made) == pytest.approx(6.5, rel=1e-4)


def test_depth_does_not_depend_on_the_assumed_length() -> None:
    for strike in strikes(penetration_tests()):
        if strike.test.length is None and strike.test.row % 5 == 0:
            longer = replace(strike, projectile=replace(strike.projectile, length=2.0 * strike.projectile.length))
            assert trajectory_depth(longer, 8.0) == pytest.approx(trajectory_depth(strike, 8.0), rel=1e-6)


def test_assumed_lengths_give_the_density_of_steel() -> None:
    for strike in strikes(penetration_tests()):
        if strike.test.length is None:
            density = strike.test.mass / solid_properties(strike.projectile).volume
            assert density == pytest.approx(7850.0, rel=1e-9)


def test_series_is_split_by_grades_of_strength() -> None:
    found = dict(zip((test.row for test in penetration_tests()), grades(penetration_tests()), strict=True))
    assert found[40] == found[52] == "forrestal-1994, 32.4 to 40.1 MPa"
    assert found[41] == found[42] == "forrestal-1994, 90.5 to 108 MPa"
    assert len(set(found.values())) == 6


def test_strength_correlation_misses_the_large_projectiles_by_a_third_and_more(assessment: Assessment) -> None:
    for method in METHODS:
        large = assessment.agreement(method, POWER_LAW, of_diameter(0.0762))
        assert large.number == 22
        assert 0.55 < large.mean_ratio < 0.70


def test_strength_factor_from_other_tests_of_the_group_predicts_the_depth(assessment: Assessment) -> None:
    for method in METHODS:
        found = assessment.agreement(method, LEFT_OUT)
        assert found.mean_ratio == pytest.approx(1.0, abs=0.03)
        assert found.coefficient_of_variation < 0.11


def test_constant_factor_is_the_value_of_the_paper_at_normal_impact() -> None:
    assert FACTOR_MODELS[CONSTANT] == ConstantStrengthFactor(value=dict(table_2())[0.0])


def test_depths_of_both_methods_differ_by_a_near_constant_for_each_nose(assessment: Assessment) -> None:
    """Below 500 m/s the difference exceeds the difference without inertia by at most 0.05 diameters.

    For one nose the difference varies by at most 0.1 diameters over all velocities.
    """
    for each in crater_differences(assessment):
        slow = np.array([strike.test.velocity < 500.0 for strike in each.strikes])
        beyond = (each.differences - each.static) / each.diameter
        assert np.all(beyond > 0.0)
        assert np.all(beyond[slow] < 0.05)
        assert np.ptp(each.differences) / each.diameter < 0.1


def test_rows_are_flagged_with_the_warnings_of_the_model(assessment: Assessment) -> None:
    (table,) = listing_section(assessment).tables
    flags = {row[1]: str(row[-1]) for row in table.rows}
    assert "velocity_beyond_rigid" in flags[72]
    assert "strength_beyond_tests" in flags[46]
    assert "left_out" in flags[OUTLIER_ROW]
    assert flags[61] == ""


def test_report_names_the_outlier_and_states_that_no_angle_was_tested(sections: list[Section]) -> None:
    text = " ".join(paragraph for section in sections for paragraph in section.text)
    assert f"Row {OUTLIER_ROW} of forrestal-1994 is left out" in text
    assert "by a third and more" in text
    assert "No test of the critical ricochet angle" in text


def test_figures_show_every_test(sections: list[Section]) -> None:
    scatter = {figure.name: figure for section in sections for figure in section.figures if figure.name != "crater"}
    assert len(scatter) == len(ALL_MODELS)
    for figure in scatter.values():
        assert {len(column) for column in figure.data.values()} == {len(penetration_tests())}


def test_table_of_walls_has_every_model_and_formula_with_its_range(sections: list[Section]) -> None:
    (table,) = (table for section in sections for table in section.tables if table.name == "walls")
    rows = {str(row[0]): row for row in table.rows}
    models = ["decay at the rear face (default)", "and a plug", "and a plug and a crater"]
    by_formula = ["modified_ndrc", "degen", "cea_edf", "ukaea", "chang", "hughes", "kar", "ace", "brl", "li_chen"]
    by_formula += ["whiffen"]
    assert list(rows) == models + by_formula
    thicknesses = {name: [float(str(value)) for value in row[1:3] if value != ""] for name, row in rows.items()}
    assert thicknesses[models[0]] == pytest.approx([240.4, 223.3], abs=0.5)
    for at_normal, at_30 in filter(None, thicknesses.values()):
        assert at_30 < at_normal
    assert thicknesses[models[0]][0] < thicknesses[models[1]][0] < thicknesses[models[2]][0]
    expected = {"modified_ndrc": 405.0, "degen": 367.0, "cea_edf": 344.0, "chang": 346.0}
    assert {name: thicknesses[name][0] for name in expected} == pytest.approx(expected, abs=1.0)
    ranges = {name: str(rows[name][-1]) for name in by_formula}
    assert {name for name, text in ranges.items() if text == "range not known"} == {"brl"}
    assert {name for name, text in ranges.items() if "out of range" in text} == {"cea_edf", "chang"}
    assert "in doubt" in str(rows["brl"][-2])


@pytest.mark.slow
def test_every_table_and_figure_of_the_page_is_written_as_a_file(
    tmp_path: Path, sections: list[Section], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["validate", "--output", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert str(tmp_path / "index.html") in printed
    assert "all, after 1 own shots: 0.87 of 12 series" in printed
    tables = {table.name for section in sections for table in section.tables}
    figures = {figure.name for section in sections for figure in section.figures}
    assert {path.stem for path in (tmp_path / "tables").glob("*.csv")} == tables
    assert {path.stem for path in (tmp_path / "figures").glob("*.svg")} == figures
