"""The comparison with finite elements: S fitted with each decay law and mesh, and the resulting critical angles."""

import math
from collections.abc import Iterator, Mapping, Sequence

from validation.finite_elements_figures import angle_figure, factor_figure, fitted_figure, rms_figure, tip_figure
from validation.finite_elements_fits import (
    ALONE,
    CHOSEN,
    LAW_NAMES,
    LAWS,
    TO_45,
    Calibration,
    Prediction,
    Predictions,
    bracket,
    calibrations,
    ending,
    endings_table,
    overall,
    predictions,
)
from validation.finite_elements_text import outcomes, paragraphs, short, with_extrapolation
from validation.reference import MESHES, Mesh, finite_element_runs, table_2
from validation.report import Comparison, Progress, ReportTable, Section

SEPARATE_CALCULATION = "a separate calculation on the same runs"
SEPARATE_RMS = {"mohr_coulomb": 0.051, "elastic_plastic": 0.090, "none": 0.216}
"""Normalised RMS misfit over the oblique runs of the coarse mesh by decay law, from a separate calculation. [1]"""
SEPARATE_ANGLES: Mapping[tuple[str, Mesh, str], float] = {
    ("mohr_coulomb", "coarse", CHOSEN): 46.8,
    ("mohr_coulomb", "fine", CHOSEN): 46.5,
    ("elastic_plastic", "coarse", TO_45): 51.4,
    ("elastic_plastic", "fine", TO_45): 49.1,
}
"""Critical angles by decay law, mesh and fit of S, from the same separate calculation. [°]"""


def section(progress: Progress) -> Section:
    """Compute all fits, and return the section that compares the model with this project's finite element runs."""
    return compare(calibrations(progress), progress)


def compare(found: Mapping[Mesh, Calibration], progress: Progress) -> Section:
    """Return the section that compares the model with the finite element runs, from the computed fits."""
    progress("finite elements: critical angles")
    predicted = predictions(found)
    ends = {mesh: bracket(finite_element_runs(mesh)) for mesh in MESHES}
    progress("finite elements: figures")
    return Section(
        title="Finite elements of the same strike",
        text=paragraphs(found, predicted, ends),
        comparisons=tuple(_comparisons(found, predicted, ends)),
        tables=(
            endings_table([run for mesh in MESHES for run in finite_element_runs(mesh)]),
            _laws(found),
            _fits(found),
            _quantities(found),
            _outcomes(found),
            _depths(found),
            _angles(predicted),
            _cost(found, predicted),
        ),
        figures=(
            rms_figure(found),
            fitted_figure(found),
            factor_figure(found, predicted, ends),
            tip_figure(found),
            angle_figure(predicted, ends),
        ),
    )


def _comparisons(
    found: Mapping[Mesh, Calibration], predicted: Predictions, ends: Mapping[Mesh, tuple[float, float]]
) -> Iterator[Comparison]:
    for mesh in MESHES:
        low, high = (math.degrees(angle) for angle in ends[mesh])
        for law in LAWS:
            chosen = predicted.chosen(law, mesh)
            yield Comparison(
                what=f"critical angle, {LAW_NAMES[law]}, S from all runs with the {mesh} mesh",
                ours=chosen.degrees or math.nan,
                reference=0.5 * (low + high),
                unit="°",
                tolerance=None,
                reference_source=f"middle of {low:g}° (not turned away) and {high:g}° (turned away), {mesh} mesh",
                note=_with_error(chosen),
            )
    for (law, mesh, reading), angle in SEPARATE_ANGLES.items():
        each = predicted.of(law, mesh, reading)
        yield Comparison(
            what=f"critical angle, {LAW_NAMES[law]}, {mesh} mesh, {reading}",
            ours=each.degrees or math.nan,
            reference=angle,
            unit="°",
            tolerance=None,
            reference_source=SEPARATE_CALCULATION,
            note=f"{_with_error(each)}{', extrapolated' if each.extrapolated else ''}",
        )
    for law, rms in SEPARATE_RMS.items():
        yield Comparison(
            what=f"normalised rms over the oblique runs, coarse mesh, {LAW_NAMES[law]}",
            ours=found["coarse"].normalized_root_mean_square(law),
            reference=rms,
            unit="1",
            tolerance=None,
            reference_source=SEPARATE_CALCULATION,
            note="until the nose tip is deepest; "
            f"{found['coarse'].normalized_root_mean_square(law, later=True):.3f} until the centre of gravity is",
        )
    factors = found["coarse"].factors("elastic_plastic")
    for degrees, printed in table_2():
        estimate = factors[degrees]
        yield Comparison(
            what=f"S at {degrees:g}°, finite element {'motion' if degrees else 'depths'}, elastic-plastic",
            ours=estimate.strength_factor,
            reference=printed,
            unit="1",
            tolerance=None,
            reference_source="Table 2, from LS-DYNA (0°: tests)",
            note="95 % interval {:.2f} to {:.2f}".format(*estimate.confidence_interval),
        )


def _with_error(prediction: Prediction) -> str:
    error = prediction.error_degrees
    return "standard error unknown" if error is None else f"standard error {error:.1f}°"


def _laws(found: Mapping[Mesh, Calibration]) -> ReportTable:
    rows: list[Sequence[object]] = []
    for mesh, calibration in found.items():
        for law, name in LAW_NAMES.items():
            common, own = calibration.fits.laws[law], calibration.own(law)
            later = calibration.own(law, later=True)
            rows.append(
                (
                    *(mesh, name, len(own), overall(own.values())),
                    overall(later.values()) if len(later) == len(own) else None,
                    common and common.estimate.strength_factor,
                    common and common.normalized_root_mean_square,
                )
            )
    return ReportTable(
        name="finite-elements-laws",
        caption="Normalised root mean square over all oblique runs of a mesh: each run at its own S, fitted until its "
        "nose tip or until its centre of gravity is deepest (empty if a run leaves S open), and at one S for all runs, "
        "until the tip is deepest.",
        columns=("mesh", "decay law", "runs", "own S, tip", "own S, centre of gravity", "common S", "at common S"),
        rows=rows,
    )


def _fits(found: Mapping[Mesh, Calibration]) -> ReportTable:
    rows: list[Sequence[object]] = []
    for calibration in found.values():
        for run in calibration.runs:
            fits = [calibration.own(law).get(run.degrees) for law in LAW_NAMES]
            end = next(float(fit.predicted.time[-1]) * 1e3 for fit in fits if fit)
            cells = [
                cell
                for fit in fits
                for cell in ((short(fit.estimate), fit.normalized_root_mean_square) if fit else ("", None))
            ]
            rows.append((run.name, end, *cells))
    columns = [cell for name in LAW_NAMES.values() for cell in (f"S, {name}", "rms")]
    return ReportTable(
        name="finite-elements-fits",
        caption="S fitted to each run until its nose tip is deepest, with its standard error, and the normalised root "
        "mean square of what is left, by decay law.",
        columns=("run", "until [ms]", *columns),
        rows=rows,
    )


def _quantities(found: Mapping[Mesh, Calibration]) -> ReportTable:
    rows: list[Sequence[object]] = []
    for calibration in found.values():
        for run in calibration.runs:
            for law in LAWS:
                alone = calibration.alone[law][run.degrees]
                left = calibration.own(law)[run.degrees].root_mean_square
                rows.append(
                    (
                        *(run.name, LAW_NAMES[law]),
                        *(left["depth_displacement"] * 1e3, left["lateral_displacement"] * 1e3),
                        math.degrees(left["rotation"]),
                        *(estimate and estimate.strength_factor for estimate in map(alone.get, ALONE)),
                    )
                )
    return ReportTable(
        name="finite-elements-quantities",
        caption="Root mean square of what these fits leave of each quantity, and S fitted to each quantity alone.",
        columns=(
            *("run", "decay law", "depth [mm]", "lateral [mm]", "rotation [°]"),
            *("S, depth alone", "S, lateral alone", "S, rotation alone"),
        ),
        rows=rows,
    )


def _outcomes(found: Mapping[Mesh, Calibration]) -> ReportTable:
    rows: list[Sequence[object]] = []
    for calibration in found.values():
        for run in calibration.runs:
            away = [ending(run).turned_away, *(outcomes(calibration, law)[run.degrees] for law in LAWS)]
            rows.append((run.name, *("turned away" if each else "retained" for each in away)))
    return ReportTable(
        name="finite-elements-outcomes",
        caption="Outcome of each run, and of the model at the S fitted to it until its nose tip is deepest.",
        columns=("run", "finite elements", *(LAW_NAMES[law] for law in LAWS)),
        rows=rows,
    )


def _depths(found: Mapping[Mesh, Calibration]) -> ReportTable:
    rows = []
    for mesh, calibration in found.items():
        fit, normal = calibration.by_depth, [run for run in finite_element_runs(mesh) if run.oblique_angle == 0.0]
        for run, predicted, residual in zip(normal, fit.predicted, fit.residuals, strict=True):
            greatest = float(run.depth_displacement.max())
            rows.append((mesh, run.velocity, greatest, float(predicted), float(residual) * 1e3))
    values = [
        f"{each.by_depth.estimate.strength_factor:.2f} ± {each.by_depth.estimate.standard_error:.2f} ({mesh} mesh)"
        for mesh, each in found.items()
    ]
    return ReportTable(
        name="finite-elements-depths",
        caption=f"Greatest depths in normal impact, and the model at the S that fits those of a mesh best, "
        f"{' and '.join(values)}.",
        columns=("mesh", "velocity [m/s]", "finite elements [m]", "model [m]", "difference [mm]"),
        rows=rows,
    )


def _angles(predicted: Predictions) -> ReportTable:
    readings: dict[tuple[Mesh | None, str], dict[str, Prediction]] = {}
    for each in predicted.each:
        readings.setdefault((each.mesh, each.reading), {})[each.law] = each
    rows: list[Sequence[object]] = []
    for (mesh, reading), by_law in readings.items():
        cells = [
            cell
            for law in LAWS
            for cell in ((with_extrapolation(by_law[law]), by_law[law].factor) if law in by_law else ("", None))
        ]
        rows.append((mesh or "LS-DYNA", reading, f"{next(iter(by_law.values())).fitted_to:g}°", *cells))
    return ReportTable(
        name="finite-elements-angles",
        caption="Critical angle by mesh, reading of the calibration and decay law, with its standard error where there "
        "is one, and S at it. Extrapolated: beyond the last angle to which S was fitted.",
        columns=("mesh", "strength factor", "fitted up to", *_by_law("critical angle", "S there")),
        rows=rows,
    )


def _by_law(*columns: str) -> tuple[str, ...]:
    return tuple(
        f"{column}, {LAW_NAMES[law]}" if place == 0 else column for law in LAWS for place, column in enumerate(columns)
    )


def _cost(found: Mapping[Mesh, Calibration], predicted: Predictions) -> ReportTable:
    coarse = found["coarse"]
    spent = sum(run.cpu_seconds or 0.0 for run in finite_element_runs("coarse"))
    rows = (
        (f"{len(finite_element_runs('coarse'))} runs with the coarse mesh", spent, None),
        (f"{len(LAW_NAMES) * (len(coarse.runs) + 1)} fits of S to the motion", None, coarse.cpu_seconds),
        ("critical angle at a known S", None, predicted.paper.cpu_seconds),
        ("critical angle with its standard error", None, predicted.chosen("elastic_plastic", "coarse").cpu_seconds),
    )
    return ReportTable(
        name="finite-elements-cost",
        caption="CPU seconds: finite elements as measured when they were made (not recorded for the finer mesh), this "
        "model now.",
        columns=("what", "finite elements [s]", "this model [s]"),
        rows=rows,
    )
