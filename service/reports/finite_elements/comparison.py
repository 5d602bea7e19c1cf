"""The finite element comparison: calibrate on some runs, predict the critical angle, look at the others."""

import math
from collections.abc import Mapping

from service.reports.contents import Comparison, Section, Table, Tell
from service.reports.finite_elements import figures
from service.reports.finite_elements.account import paragraphs
from service.reports.finite_elements.calibration import (
    BRACKETING,
    CALIBRATED,
    Calibrations,
    calibrations,
)
from service.reports.finite_elements.prediction import CHOSEN, PAPER, Prediction, bracket, polynomials, predictions
from service.reports.reference import finite_element_run, finite_element_runs, table_2
from solver.calibration import ObliquityFit

QUANTITIES = ("depth_displacement", "lateral_displacement", "rotation")
TELLING = (
    "scatter_beyond_standard_errors",
    "covariance_unknown",
    "standard_error_unknown",
    "strength_fit_extrapolated",
)
"""Warnings that tell one reading of the calibration from another."""


def section(tell: Tell) -> Section:
    """Return the comparison with this project's finite element runs."""
    return compare(calibrations(tell), tell)


def compare(found: Calibrations, tell: Tell) -> Section:
    """Return the comparison from what was fitted."""
    tell("finite elements: critical angles")
    fits = polynomials(found)
    predicted = predictions(found, fits)
    ends = bracket(finite_element_runs())
    model = fits[CHOSEN].model
    tell("finite elements: figures")
    return Section(
        title="Finite elements of the same strike",
        text=paragraphs(found, fits, predicted, ends),
        comparisons=_comparisons(found, predicted, ends),
        tables=(_fits(found), _goodness(found), _depths(found), _angles(fits, predicted), _cost(found, predicted)),
        figures=(
            figures.fitted_figure(found.of(CALIBRATED)),
            figures.factor_figure(found, model, predicted[CHOSEN].answer.angle, ends),
            figures.predicted_figure([finite_element_run(name) for name in BRACKETING], model),
            figures.tip_figure(found.of(BRACKETING), model),
        ),
    )


def _comparisons(
    found: Calibrations, predicted: dict[str, Prediction], ends: tuple[float, float]
) -> tuple[Comparison, ...]:
    low, high = (math.degrees(angle) for angle in ends)
    strengths = [
        Comparison(
            what=f"S at {degrees:g}°, finite element {'motion' if degrees else 'depths'}",
            ours=each.strength_factor,
            reference=printed,
            unit="1",
            tolerance=None,
            reference_source="Table 2, from LS-DYNA (0°: tests)",
            note="95 % interval {:.2f} to {:.2f}".format(*each.confidence_interval),
        )
        for each, (degrees, printed) in zip(found.points.values(), table_2(), strict=True)
    ]
    angles = [
        Comparison(
            what=f"critical angle, {what}",
            ours=predicted[what].degrees or math.nan,
            reference=0.5 * (low + high),
            unit="°",
            tolerance=None,
            reference_source=f"middle of {low:g}° (sliding) and {high:g}° (ricochet), finite elements",
            note=note,
        )
        for what, note in (
            (CHOSEN, _with_error(predicted[CHOSEN])),
            (PAPER, "calibrated by the paper on other finite elements"),
        )
    ]
    return (*angles, *strengths)


def _with_error(prediction: Prediction) -> str:
    error = prediction.error_degrees
    return "standard error unknown" if error is None else f"standard error {error:.1f}°"


def _fits(found: Calibrations) -> Table:
    rows = []
    for each in found.by_motion:
        alone = [each.alone[name].strength_factor if name in each.alone else None for name in QUANTITIES]
        interval = "{:.2f} to {:.2f}".format(*each.estimate.confidence_interval)
        end = float(each.fit.predicted.time[-1]) * 1e3
        rows.append((each.run.name, end, each.estimate.strength_factor, each.estimate.standard_error, interval, *alone))
    return Table(
        name="finite-elements-fits",
        caption="S fitted to each run until its nose tip is deepest, from all quantities together and from each alone. "
        "The first run and the last four are not in the polynomial.",
        columns=("run", "until [ms]", "S", "standard error", "95 %", "depth alone", "lateral alone", "rotation alone"),
        rows=rows,
    )


def _goodness(found: Calibrations) -> Table:
    rows = []
    for each in found.by_motion:
        left = each.fit.root_mean_square
        shown = {name: math.degrees(value) if name == "rotation" else value * 1e3 for name, value in left.items()}
        explained = each.fit.r_squared
        rows.append((each.run.name, *map(shown.get, QUANTITIES), *map(explained.get, QUANTITIES)))
    return Table(
        name="finite-elements-goodness",
        caption="Goodness of these fits, all quantities together: root mean square of what is left, and the share of "
        "the variance that the model explains.",
        columns=("run", "depth [mm]", "lateral [mm]", "rotation [°]", "R² depth", "R² lateral", "R² rotation"),
        rows=rows,
    )


def _depths(found: Calibrations) -> Table:
    fit = found.by_depth
    normal = [run for run in finite_element_runs() if run.oblique_angle == 0.0]
    rows = [
        (run.velocity, float(run.depth_displacement.max()), float(predicted), float(residual) * 1e3)
        for run, predicted, residual in zip(normal, fit.predicted, fit.residuals, strict=True)
    ]
    low, high = fit.estimate.confidence_interval
    return Table(
        name="finite-elements-depths",
        caption=f"Greatest depths in normal impact, and the model at the S that fits them best, "
        f"{fit.estimate.strength_factor:.2f} ± {fit.estimate.standard_error:.2f} (95 %: {low:.2f} to {high:.2f}).",
        columns=("velocity [m/s]", "finite elements [m]", "model [m]", "difference [mm]"),
        rows=rows,
    )


def _angles(fits: Mapping[str, ObliquityFit], predicted: Mapping[str, Prediction]) -> Table:
    rows = []
    for what, each in predicted.items():
        warnings = (fits[what].warnings if what in fits else ()) + each.answer.warnings
        codes = [f"`{warning.code}`" for warning in warnings if warning.code in TELLING]
        rows.append((what, each.degrees, each.error_degrees, each.factor, ", ".join(codes)))
    return Table(
        name="finite-elements-angles",
        caption="Critical angle by each reading of the calibration.",
        columns=("strength factor", "critical angle [°]", "standard error [°]", "S there", "warnings"),
        rows=rows,
    )


def _cost(found: Calibrations, predicted: dict[str, Prediction]) -> Table:
    calibrated, near = found.of(CALIBRATED), found.of(BRACKETING)
    fits = sum(each.cpu_seconds for each in calibrated)
    search = predicted[PAPER].cpu_seconds
    normal = [run for run in finite_element_runs() if run.oblique_angle == 0.0]
    spent = sum(run.cpu_seconds for run in normal) + sum(each.run.cpu_seconds for each in calibrated)
    rows = (
        (f"{len(normal) + len(calibrated)} runs to calibrate on", spent, None),
        (f"{len(near)} runs around the critical angle", sum(each.run.cpu_seconds for each in near), None),
        (f"{len(calibrated)} fits of S to the motion", None, fits),
        ("critical angle at a known S", None, search),
        ("critical angle with its standard error", None, predicted[CHOSEN].cpu_seconds),
    )
    return Table(
        name="finite-elements-cost",
        caption="CPU seconds: finite elements as measured when they were made, this model now.",
        columns=("what", "finite elements [s]", "this model [s]"),
        rows=rows,
    )
