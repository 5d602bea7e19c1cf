"""The law over strength and diameter: its constants, series that it has not seen, and what its residual follows."""

from dataclasses import replace

import numpy as np
import pytest

from service.reports import style
from solver import PublishedTests
from validation.depth_tests import OUTLIER_ROW, TRAJECTORY, Assessment, trajectory_depth
from validation.size_law import (
    LARGE,
    REFERENCE_DIAMETER,
    REFERENCE_STRENGTH,
    fit_places,
    fit_size_law,
    fitted_places,
    leave_out,
    log_scatter,
    pooled,
    predicted_ratios,
    size_law_section,
    trend,
    trends,
)


def test_exact_factors_give_the_measured_depths(assessment: Assessment) -> None:
    for place in assessment.chosen()[::6]:
        strike = assessment.strikes[place]
        depth = trajectory_depth(strike, float(assessment.exact_factors[place]))
        assert depth == pytest.approx(strike.test.depth, rel=1e-4)


def test_constants_are_those_of_the_law_of_published_tests(assessment: Assessment) -> None:
    law, published = fit_places(assessment, fitted_places(assessment), diameter=True).model, PublishedTests.law
    assert (published.reference_strength, published.reference_diameter) == (REFERENCE_STRENGTH, REFERENCE_DIAMETER)
    assert law.coefficient == pytest.approx(published.coefficient, abs=0.01)
    assert law.exponent == pytest.approx(published.exponent, abs=0.005)
    assert law.diameter_exponent == pytest.approx(published.diameter_exponent, abs=0.005)


def test_law_is_fitted_to_45_tests_below_900_m_s_and_predicts_54(assessment: Assessment) -> None:
    assert len(fitted_places(assessment)) == 45
    for diameter in (True, False):
        found = [each for each in leave_out(assessment, diameter=diameter) if each.name != LARGE]
        rows = [assessment.strikes[place].test.row for place in pooled(found)[0]]
        assert len(rows) == len(set(rows)) == 54
        assert OUTLIER_ROW not in rows


def test_fit_finds_the_law_that_made_the_factors(assessment: Assessment) -> None:
    made = [
        7.0 * (each.test.compressive_strength / 39e6) ** -0.2 * (each.test.diameter / 0.0762) ** -0.5
        for each in assessment.strikes
    ]
    law = fit_size_law(assessment.strikes, np.array(made))
    assert (law.model.coefficient, law.model.exponent, law.model.diameter_exponent) == pytest.approx((7.0, -0.2, -0.5))
    assert max(law.standard_errors) < 1e-9
    plain = fit_size_law(assessment.strikes, np.array(made), diameter=False)
    assert plain.model.diameter_exponent == 0.0
    assert plain.model.exponent > -0.2  # takes over what the diameter explains, for large ones met weak concrete


def test_series_left_out_does_not_move_the_law_that_predicts_it(assessment: Assessment) -> None:
    factors = assessment.exact_factors.copy()
    for place in assessment.chosen():
        if assessment.strikes[place].test.series == "forrestal-2003":
            factors[place] *= 1.5
    moved = leave_out(replace(assessment, exact_factors=factors), diameter=True)
    for before, after in zip(leave_out(assessment, diameter=True), moved, strict=True):
        assert (before.law == after.law) == (before.name in {"forrestal-2003", LARGE})


def test_diameter_does_not_help_for_a_series_that_was_left_out(assessment: Assessment) -> None:
    """Strength, diameter and series go together in these data: the exponent moves from -0.7 to 0."""
    scatter, exponents = {}, []
    for diameter in (True, False):
        found = [each for each in leave_out(assessment, diameter=diameter) if each.name != LARGE]
        scatter[diameter] = log_scatter(np.concatenate([each.slow for each in found]))
        exponents += [each.law.model.diameter_exponent for each in found if diameter]
    assert scatter[True] == pytest.approx(0.273, abs=0.01)
    assert scatter[False] == pytest.approx(0.250, abs=0.01)
    assert min(exponents) < -0.6
    assert max(exponents) > 0.0


def test_largest_projectiles_go_deeper_than_a_law_of_smaller_ones_says(assessment: Assessment) -> None:
    with_diameter, without = (leave_out(assessment, diameter=diameter)[-1] for diameter in (True, False))
    assert with_diameter.name == without.name == LARGE
    assert len(with_diameter.ratios) == 22
    assert without.ratios.mean() < with_diameter.ratios.mean() < 0.75


def test_residual_of_the_law_follows_neither_speed_nor_strength_nor_diameter(assessment: Assessment) -> None:
    law = fit_places(assessment, fitted_places(assessment), diameter=True)
    places = assessment.chosen()
    for each in trends(assessment, places, predicted_ratios(assessment, law, places)):
        assert abs(each.exponent) < 2.0 * each.standard_error
        assert abs(each.change) < 0.1
    for each in trends(assessment, places, assessment.ratios(TRAJECTORY, "82.6 f'c^−0.544")[places]):
        assert abs(each.exponent) > 5.0 * each.standard_error


def test_trend_is_the_power_that_made_the_ratios() -> None:
    values = np.geomspace(20.0, 80.0, 9)
    found = trend(values, 1.1 * values**0.25)
    assert found.exponent == pytest.approx(0.25)
    assert found.standard_error == pytest.approx(0.0, abs=1e-9)
    assert found.change == pytest.approx(4.0**0.25 - 1.0)


def test_section_names_the_confounding_and_shows_every_test(assessment: Assessment) -> None:
    with style.styled():
        section = size_law_section(assessment)
    text = " ".join(section.text)
    assert "S = 6.55 (f'c / 39 MPa)^−0.31 (d / 76.2 mm)^−0.42" in text
    assert "the diameter does not help" in text
    assert "may be the target's" in text
    assert [comparison.holds for comparison in section.comparisons] == [True] * 3
    (figure,) = section.figures
    assert {len(column) for column in figure.data.values()} == {2 * 54}
    assert [table.name for table in section.tables] == ["leave-one-series-out", "residual-trends"]
