"""The finite element comparison: both meshes, both decay laws, and marks of extrapolation."""

from collections.abc import Mapping

import numpy as np
import pytest

from service.reports import style
from solver import mass_properties
from solver.resistance import FINITE_ELEMENT_SHAPES, FINITE_ELEMENTS_TO
from solver.strike import PAPER_PROJECTILE
from validation.finite_elements import compare
from validation.finite_elements_fits import (
    CHOSEN,
    LAWS,
    PAPER_ANGLES,
    TO_45,
    Calibration,
    Predictions,
    bracket,
    calibrations,
    ending,
    predictions,
)
from validation.finite_elements_text import outcomes, place
from validation.reference import MESHES, Mesh, finite_element_run, finite_element_runs, time_of_deepest_tip
from validation.report import Section

NO_DECAY = "none"


@pytest.fixture(scope="module")
def found() -> dict[Mesh, Calibration]:
    return calibrations(lambda what: None)


@pytest.fixture(scope="module")
def predicted(found: Mapping[Mesh, Calibration]) -> Predictions:
    return predictions(found)


@pytest.fixture(scope="module")
def report(found: Mapping[Mesh, Calibration]) -> Section:
    with style.styled():
        return compare(found, lambda what: None)


@pytest.mark.parametrize(("mesh", "ends"), [("coarse", [48.0, 50.0]), ("fine", [45.0, 48.0])])
def test_finer_mesh_changes_its_outcome_at_lower_angles(mesh: Mesh, ends: list[float]) -> None:
    assert np.degrees(bracket(finite_element_runs(mesh))) == pytest.approx(ends)


@pytest.mark.parametrize("mesh", MESHES)
def test_outcomes_follow_from_the_last_rows(mesh: Mesh) -> None:
    """A run counts as turned away if nose tip and centre of gravity move out with at least 1 % of the energy."""
    properties = mass_properties(PAPER_PROJECTILE)
    for run in finite_element_runs(mesh):
        axis = run.oblique_angle + run.rotation
        tip = run.depth_displacement + properties.center_of_gravity * np.cos(axis)
        velocity = (tip[-1] - tip[-3]) / (run.time[-1] - run.time[-3])
        energy = run.depth_velocity**2 + run.lateral_velocity**2
        energy += properties.moment_of_inertia / properties.mass * run.angular_velocity**2
        leaves = velocity < 0.0 and run.depth_velocity[-1] < 0.0 and energy[-1] >= 0.01 * energy[0]
        assert leaves == (run.outcome == "ricochet") == ending(run).turned_away, run.name
        assert ending(run).tip_velocity == pytest.approx(velocity, rel=0.1, abs=1.0)


def test_tip_leaves_with_the_expected_velocity_near_the_change_of_outcome() -> None:
    """The tip moves out with 9 m/s at 50° on the coarse mesh and with 19 m/s at 48° on the fine one."""
    for name, velocity in (("oblique-50", -9.0), ("fine-oblique-48", -19.0)):
        last = ending(finite_element_run(name))
        assert last.tip_velocity == pytest.approx(velocity, abs=0.5)
        assert last.energy_share == pytest.approx(0.10, abs=0.01)


@pytest.mark.parametrize("mesh", MESHES)
def test_each_run_is_fitted_until_its_nose_tip_is_deepest(found: Mapping[Mesh, Calibration], mesh: Mesh) -> None:
    ends = {run.degrees: time_of_deepest_tip(run) for run in found[mesh].runs}
    for law in LAWS:
        assert {angle: fit.predicted.time[-1] for angle, fit in found[mesh].own(law).items()} == ends


def test_normalised_root_mean_squares_agree_with_a_separate_calculation(found: Mapping[Mesh, Calibration]) -> None:
    """Without decay only a lower limit is tested, because the separate calculation gives 0.216, and ours 0.174."""
    rms = {law: found["coarse"].normalized_root_mean_square(law) for law in (*LAWS, NO_DECAY)}
    assert rms["mohr_coulomb"] == pytest.approx(0.051, abs=0.001)
    assert rms["elastic_plastic"] == pytest.approx(0.090, abs=0.001)
    assert rms[NO_DECAY] > 1.8 * rms["elastic_plastic"]


@pytest.mark.parametrize("mesh", MESHES)
def test_mohr_coulomb_fits_long_motions_better_and_elastic_plastic_short_ones(
    found: Mapping[Mesh, Calibration], mesh: Mesh
) -> None:
    plain, other = (found[mesh].own(law) for law in LAWS)
    for angle in plain:
        better = other[angle].normalized_root_mean_square < plain[angle].normalized_root_mean_square
        assert better == (angle <= 45.0), angle


@pytest.mark.parametrize("mesh", MESHES)
def test_only_mohr_coulomb_reproduces_every_outcome(found: Mapping[Mesh, Calibration], mesh: Mesh) -> None:
    computed = {run.degrees: ending(run).turned_away for run in found[mesh].runs}
    assert outcomes(found[mesh], "mohr_coulomb") == computed
    missed = [angle for angle, away in outcomes(found[mesh], "elastic_plastic").items() if away != computed[angle]]
    assert missed == ([50.0] if mesh == "coarse" else [48.0])


@pytest.mark.parametrize("law", LAWS)
def test_strength_factors_fall_with_the_angle_as_in_the_paper(found: Mapping[Mesh, Calibration], law: str) -> None:
    for calibration in found.values():
        factors = calibration.factors(law)
        assert list(factors) == sorted(factors)
        fitted = [factors[angle].strength_factor for angle in factors if angle <= PAPER_ANGLES[-1]]
        assert fitted == sorted(fitted, reverse=True)
        for estimate in factors.values():
            assert estimate.confidence_interval[0] < estimate.strength_factor < estimate.confidence_interval[1]


def test_no_single_strength_factor_fits_position_and_rotation(found: Mapping[Mesh, Calibration]) -> None:
    fits, alone = found["coarse"].own("elastic_plastic"), found["coarse"].alone["elastic_plastic"]
    for angle in PAPER_ANGLES:
        factors = {name: estimate.strength_factor for name, estimate in alone[angle].items() if estimate}
        assert factors["depth_displacement"] < fits[angle].estimate.strength_factor < factors["rotation"]
        assert factors["lateral_displacement"] < fits[angle].estimate.strength_factor


@pytest.mark.parametrize(
    ("law", "mesh", "reading", "angle", "error"),
    [
        ("mohr_coulomb", "coarse", CHOSEN, 46.8, 0.7),
        ("mohr_coulomb", "fine", CHOSEN, 46.5, 0.7),
        ("elastic_plastic", "coarse", TO_45, 51.4, 1.3),
        ("elastic_plastic", "fine", TO_45, 49.1, None),
    ],
)
def test_calibrated_angles_agree_with_a_separate_calculation(
    predicted: Predictions, law: str, mesh: Mesh, reading: str, angle: float, error: float | None
) -> None:
    each = predicted.of(law, mesh, reading)
    assert each.degrees == pytest.approx(angle, abs=0.2)
    if error is None:
        assert each.error_degrees is None
    else:
        assert each.error_degrees == pytest.approx(error, abs=0.1)


def test_angles_beyond_the_fitted_ones_are_called_extrapolated(predicted: Predictions, report: Section) -> None:
    for each in predicted.each:
        assert each.extrapolated == (each.degrees is not None and each.degrees > each.fitted_to)
    for law in LAWS:
        for mesh in MESHES:
            assert not predicted.chosen(law, mesh).extrapolated
            assert predicted.of(law, mesh, TO_45).extrapolated
    (table,) = (table for table in report.tables if table.name == "finite-elements-angles")
    for row in table.rows:
        assert "extrapolated" in str(row[3]) or row[1] != TO_45
    assert "What extrapolation does" in " ".join(report.text)


def test_polynomials_are_drawn_only_between_the_fitted_angles(report: Section) -> None:
    (figure,) = (figure for figure in report.figures if figure.name == "finite-elements-factor")
    ends: dict[str, float] = {}
    for series, angle in zip(figure.data["series"], figure.data["oblique_angle_deg"], strict=True):
        ends[str(series)] = max(float(str(angle)), ends.get(str(series), 0.0))
    assert ends["Mohr-Coulomb, coarse mesh, polynomial"] == 55.0
    assert ends["Mohr-Coulomb, fine mesh, polynomial"] == 50.0
    assert ends["equation 9"] == 45.0


def test_table_compares_angles_with_brackets(report: Section, predicted: Predictions) -> None:
    compared = {each.what: each for each in report.comparisons}
    for law, name in (("elastic_plastic", "elastic-plastic"), ("mohr_coulomb", "Mohr-Coulomb")):
        for mesh, middle in zip(MESHES, (49.0, 46.5), strict=True):
            each = compared[f"critical angle, {name}, S from all runs with the {mesh} mesh"]
            assert each.ours == predicted.chosen(law, mesh).degrees
            assert each.reference == pytest.approx(middle)
            assert "standard error" in each.note
    text = " ".join(report.text)
    assert "Between 48° and 50° the coarse model changes from retained to turned away" in text
    assert "the fine one between 45° and 48°" in text
    assert "no test of this angle is known" in text


@pytest.mark.parametrize(
    ("angle", "error", "words"),
    [
        (51.0, 1.0, "between these"),
        (52.3, 1.0, "0.3° above both, less than its standard error"),
        (47.0, 1.0, "3.0° below both, more than its standard error"),
        (55.0, None, "3.0° above both"),
        (None, None, "which cannot be compared"),
    ],
)
def test_place_of_a_prediction_relative_to_the_bracket_is_stated(
    angle: float | None, error: float | None, words: str
) -> None:
    assert place(angle, error, 50.0, 52.0) == words


def test_report_states_the_cost_of_finite_elements_and_of_the_model(report: Section) -> None:
    (table,) = (table for table in report.tables if table.name == "finite-elements-cost")
    assert table.rows[0][1] == sum(run.cpu_seconds or 0.0 for run in finite_element_runs())
    search = table.rows[2][2]
    assert isinstance(search, float)
    assert search < 1.0


def test_figures_of_finite_elements_show_both_meshes_and_both_laws(report: Section) -> None:
    figures = {figure.name: {str(name) for name in figure.data.get("series", ())} for figure in report.figures}
    assert len(figures) == 5
    for name in ("finite-elements-fitted", "finite-elements-tip", "finite-elements-factor"):
        for part in ("coarse", "fine", "elastic-plastic", "Mohr-Coulomb"):
            assert any(part in series for series in figures[name]), (name, part)


@pytest.mark.parametrize("law", FINITE_ELEMENT_SHAPES)
def test_obliquity_shape_of_the_solver_is_the_cubic_fit_to_both_meshes(
    found: Mapping[Mesh, Calibration], law: str
) -> None:
    points = [
        (angle, estimate.strength_factor)
        for calibration in found.values()
        for angle, estimate in calibration.factors(law).items()
    ]
    angles, strengths = np.array(points).T
    assert angles.max() == pytest.approx(np.degrees(FINITE_ELEMENTS_TO))
    coefficients = np.polynomial.polynomial.polyfit(angles, strengths, 3)
    grid = np.linspace(0.0, 55.0, 12)
    fitted = np.polynomial.polynomial.polyval(grid, coefficients / coefficients[0])
    shape = np.polynomial.polynomial.polyval(grid, FINITE_ELEMENT_SHAPES[law])
    assert shape == pytest.approx(fitted, abs=2e-3)


def test_strength_fitted_with_mohr_coulomb_falls_to_half_and_levels_off(
    found: Mapping[Mesh, Calibration],
) -> None:
    expected = {
        0.0: (8.4, 8.5),
        15.0: (7.7, 7.8),
        30.0: (5.7, 6.0),
        45.0: (3.5, 4.1),
        48.0: (3.5, 4.0),
        50.0: (3.8, 4.6),
    }
    for calibration in found.values():
        for angle, estimate in calibration.factors("mohr_coulomb").items():
            low, high = expected.get(angle, (3.8, 4.6))
            assert low <= estimate.strength_factor <= high
