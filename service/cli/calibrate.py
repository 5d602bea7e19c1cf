"""`ricochet calibrate`: strength factors from tests and from finite element histories."""

import argparse
import csv
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from service.cli.arguments import BODY, FAILED, IMPACT, WRONG, CommandError, Formatter, examples
from service.cli.calibration_input import (
    GREATEST_DEPTH,
    DepthCase,
    MotionCase,
    add_depth_flags,
    add_motion_flags,
    add_obliquity_flags,
    by_quantity,
    case_arguments,
)
from service.readers import (
    DEPTH_TESTS,
    MOTION,
    OBLIQUITY_POINTS,
    CoordinateAxis,
    Expected,
    FileError,
    read_depth_tests,
    read_motion,
    read_motion_runs,
    read_obliquity_points,
)
from service.schemas import depth_answer, motion_answer, obliquity_answer
from service.schemas.quantities import degrees
from solver import ENGINE_VERSION, Impact, ModelWarning, ParameterError, RicochetError
from solver.calibration import (
    DecayLawFits,
    DepthFit,
    DepthTest,
    Estimate,
    MotionFit,
    MotionHistory,
    MotionRun,
    MotionsFit,
    ObliquityFit,
    ObliquityPoint,
    Weights,
    fit_decay_laws,
    fit_depth,
    fit_obliquity,
    penetration_depths,
    predict_motion,
)

IMPACT_FIELDS = {
    "velocity": "velocity_m_s",
    "oblique_angle": "oblique_angle_deg",
    "angle_of_attack": "angle_of_attack_deg",
    "angular_velocity": "angular_velocity_rad_s",
}
"""Columns of a table of runs, and the fields of a request that they set."""
CURVE_POINTS = 41
CURVE_MARGIN = 0.1
"""Curves extend beyond the tests by this part of their range of velocities. [1]"""


def add_calibrate(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet calibrate`."""
    parser.description = "Fit strength factors to tests or finite element histories."
    parser.epilog = examples("ricochet calibrate obliquity points.csv --json")
    kinds = parser.add_subparsers(dest="calibration", required=True, metavar="KIND")
    for name, help_, add_flags in (
        ("depth", "one strength factor from depths in normal impact", add_depth_flags),
        ("motion", "one strength factor from the motion in an oblique impact", add_motion_flags),
        ("obliquity", "a polynomial over the oblique angle from strength factors", add_obliquity_flags),
    ):
        add_flags(kinds.add_parser(name, help=help_, formatter_class=Formatter))
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Fit and print; return 1 if no fit is possible, 2 if a file or a flag is wrong."""
    fits: dict[str, Callable[[argparse.Namespace], None]] = {
        "depth": calibrate_depth,
        "motion": calibrate_motion,
        "obliquity": calibrate_obliquity,
    }
    try:
        fits[args.calibration](args)
    except (CommandError, FileError) as error:
        return _fail(args, error, WRONG)
    except ParameterError as error:
        # The tests or the history as a whole are well formed but cannot be fitted.
        return _fail(args, error, FAILED if error.field in {"tests", "history", "runs"} else WRONG)
    except RicochetError as error:
        return _fail(args, error, FAILED)
    return 0


def _fail(args: argparse.Namespace, error: Exception, status: int) -> int:
    print(f"ricochet calibrate {args.calibration}: {error}", file=sys.stderr)
    return status


def calibrate_depth(args: argparse.Namespace) -> None:
    """Fit a strength factor to depths and print it."""
    case = case_arguments(args, DepthCase, BODY)
    tests = read_depth_tests(
        args.tests,
        by_quantity("--column", args.column, DEPTH_TESTS),
        by_quantity("--unit", args.unit, DEPTH_TESTS),
        diameter=case["projectile"].diameter,
        grouped=args.group,
    )
    fit = fit_depth(tests=tests, confidence_level=args.confidence, **case)
    curves = []
    if args.curves or args.strength_factors:
        measured = np.array([test.velocity for test in tests])
        margin = CURVE_MARGIN * (np.ptp(measured) or measured[0])
        lowest = max(measured.min() - margin, 0.5 * measured.min())
        velocities = np.linspace(lowest, measured.max() + margin, CURVE_POINTS)
        for factor in sorted({*args.strength_factors, fit.estimate.strength_factor}):
            depths = penetration_depths(velocities=velocities, strength_factor=factor, **case)
            curves.append((factor, velocities, depths))
    answer = depth_answer(fit, curves)
    if args.curves:
        _write_csv(args.curves, answer["curves"])
    if args.json:
        _print_json(answer)
    elif args.uncertain:
        print(as_uncertain(fit.estimate))
    else:
        _print_depth(tests, fit)


def calibrate_motion(args: argparse.Namespace) -> None:
    """Fit a strength factor to one or several motions with every decay law and print it."""
    if (args.history is None) == (args.runs is None):
        raise CommandError("either HISTORY or --runs RUNS.csv must be given")
    weights = _weights(args.weight)
    inputs = [_single_input(args)] if args.runs is None else _table_inputs(args)
    case = inputs[0].case
    fits = fit_decay_laws(
        runs=[MotionRun(impact=each.impact, history=each.history, weights=weights) for each in inputs],
        confidence_level=args.confidence,
        **case,
    )
    compared: list[list[tuple[float, MotionHistory]]] = [[] for _ in inputs]
    if args.histories or args.strength_factors:
        for factor in sorted({*args.strength_factors, fits.requested.estimate.strength_factor}):
            for each, motions in zip(inputs, compared, strict=True):
                motion = predict_motion(strength_factor=factor, times=each.history.time, impact=each.impact, **case)
                motions.append((factor, motion))
    answer = motion_answer(fits, compared, several=args.runs is not None)
    if args.histories:
        _write_csv(args.histories, _compared_tables(answer))
    if args.json:
        _print_json(_with_impacts(answer, inputs))
    elif args.uncertain:
        print(as_uncertain(fits.requested.estimate))
    else:
        _print_motion(inputs, fits)


def as_uncertain(estimate: Estimate) -> str:
    """Return a fitted strength factor as tables of a case: the constant law, and its value as an uncertain input."""
    factor, error = f"{estimate.strength_factor:.6g}", f"{estimate.standard_error:.3g}"
    return f"""
[resistance.strength_factor]
model = "constant"
value = {factor}

[[uncertain]]
field = "resistance.strength_factor.value"
distribution = {{ type = "normal", mean = {factor}, standard_deviation = {error} }}"""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Input:
    """A history with its impact, and the other arguments of the solver."""

    name: str
    impact: Impact
    history: MotionHistory
    case: dict[str, Any]


def _single_input(args: argparse.Namespace) -> _Input:
    case = case_arguments(args, MotionCase, (*IMPACT, *BODY))
    impact = case.pop("impact")
    expected = Expected(impact=impact, projectile=case["projectile"])
    return _Input(name=args.history, impact=impact, history=_read_history(args, expected), case=case)


def _table_inputs(args: argparse.Namespace) -> list[_Input]:
    """Read every run of a table, whose cells take precedence over the flags."""
    inputs = []
    for row in read_motion_runs(args.runs):
        cells = {
            f"impact/{IMPACT_FIELDS[name]}": degrees(value) if IMPACT_FIELDS[name].endswith("_deg") else value
            for name, value in row.impact.items()
        }
        until = args.until if row.until is None else row.until
        own = argparse.Namespace(**(vars(args) | cells | {"history": row.file, "until": until}))
        try:
            inputs.append(replace(_single_input(own), name=row.name))
        except CommandError as error:
            raise CommandError(f"{args.runs}:{row.line}: {error}") from None
    return inputs


def _compared_tables(answer: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the motions that are compared, of several runs with the number of each."""
    if "runs" not in answer:
        return [{"strength_factor": each["strength_factor"], **each["history"]} for each in answer["compared"]]
    return [
        {"run": number, "strength_factor": each["strength_factor"], **each["history"]}
        for number, run in enumerate(answer["runs"])
        for each in run["compared"]
    ]


def _with_impacts(answer: Mapping[str, Any], inputs: Sequence[_Input]) -> dict[str, Any]:
    """Return the answer with the oblique angle, for `calibrate obliquity`, or with the file and impact of each run."""
    if "runs" not in answer:
        return {"oblique_angle_deg": degrees(inputs[0].impact.oblique_angle), **answer}
    runs = [
        {
            "file": each.name,
            "oblique_angle_deg": degrees(each.impact.oblique_angle),
            "velocity_m_s": each.impact.velocity,
            **run,
        }
        for each, run in zip(inputs, answer["runs"], strict=True)
    ]
    return {**answer, "runs": runs}


def calibrate_obliquity(args: argparse.Namespace) -> None:
    """Fit a polynomial over the oblique angle and print it."""
    points = read_obliquity_points(
        args.points,
        by_quantity("--column", args.column, OBLIQUITY_POINTS),
        by_quantity("--unit", args.unit, OBLIQUITY_POINTS),
    )
    try:
        fit = fit_obliquity(points=points, order=args.order)
    except ParameterError as error:
        raise CommandError(f"{args.points}: {error}") from None
    if args.json:
        _print_json(obliquity_answer(fit))
    else:
        _print_obliquity(points, fit)


def _read_history(args: argparse.Namespace, expected: Expected) -> MotionHistory:
    try:
        axes = {name: CoordinateAxis.named(axis) for name, axis in by_quantity("--axis", args.axis, MOTION[1:]).items()}
    except ValueError as error:
        raise CommandError(f"--axis: {error}") from None
    history = read_motion(
        args.history,
        by_quantity("--column", args.column, MOTION),
        by_quantity("--unit", args.unit, MOTION),
        axes=axes,
        part=args.part,
        node=args.node,
        contact=args.contact,
        expected=expected,
    )
    if args.until is None:
        return history
    try:
        return history.until(history.time_of_greatest_depth if args.until == GREATEST_DEPTH else args.until)
    except ParameterError as error:
        raise CommandError(f"--until: {args.history}: {error}") from None


def _weights(pairs: Iterable[tuple[str, str]]) -> Weights:
    values = {}
    for name, text in by_quantity("--weight", pairs, MOTION[1:]).items():
        try:
            values[name.removesuffix("_displacement")] = float(text)
        except ValueError:
            raise CommandError(f"--weight {name}={text}: must be a number") from None
    return Weights(**values)


def _write_csv(path: Path, tables: Iterable[Mapping[str, Any]]) -> None:
    """Write tables below each other, a row for each instant or velocity; a column that a table lacks is empty."""
    tables = list(tables)
    names = list(dict.fromkeys(name for table in tables for name in table))
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, names, lineterminator="\n")
            writer.writeheader()
            for table in tables:
                columns = {name: values for name, values in table.items() if isinstance(values, list)}
                for row in zip(*columns.values(), strict=True):
                    numbers = {**table, **dict(zip(columns, row, strict=True))}
                    writer.writerow({name: f"{value:.9g}" for name, value in numbers.items()})
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from None


def _print_json(answer: Mapping[str, Any]) -> None:
    print(json.dumps({**answer, "engine_version": ENGINE_VERSION}, allow_nan=False))


def _print_depth(tests: Sequence[DepthTest], fit: DepthFit) -> None:
    table = _table("velocity m/s", "depth m", "predicted m", "residual mm")
    for test, predicted, residual in zip(tests, fit.predicted, fit.residuals, strict=True):
        table.add_row(f"{test.velocity:g}", f"{test.depth:g}", f"{predicted:.4f}", f"{1e3 * residual:+.1f}")
    console = Console(highlight=False)
    console.print(table)
    if fit.groups:
        groups = _table("strength factor", "standard error", "interval", first="group")
        for name, group in fit.groups.items():
            groups.add_row(escape(name), *_columns(group.estimate))
        console.print(groups)
    scatter = f"root mean square {1e3 * fit.root_mean_square:.1f} mm"
    console.print(_sentence(fit.estimate), scatter, sep="\n", markup=False, soft_wrap=True)
    _print_warnings(fit.warnings)


def _print_motion(inputs: Sequence[_Input], fits: DecayLawFits) -> None:
    requested, console = fits.requested, Console(highlight=False)
    console.print(_quantities(requested.runs[0]) if len(inputs) == 1 else _runs(inputs, requested))
    laws = _table("strength factor", "standard error", "normalised rms", first="decay law")
    for name, fit in fits.laws.items():
        cells = ("", "", "")
        if fit is not None:
            cells = (*_columns(fit.estimate)[:2], f"{fit.normalized_root_mean_square:.4f}")
        laws.add_row(name.replace("_", " "), *cells)
    console.print(laws)
    history = inputs[0].history.time
    described = f"{len(inputs)} runs"
    if len(inputs) == 1:
        angle = degrees(inputs[0].impact.oblique_angle)
        described = f"{angle:g}° from the normal, {len(history)} instants up to {1e3 * history[-1]:.3g} ms"
    law = requested.free_surface.name.replace("_", " ")
    best = f"best decay law: {fits.best.replace('_', ' ')}"
    console.print(f"{law}: {_sentence(requested.estimate)}", best, described, sep="\n", markup=False, soft_wrap=True)
    _print_warnings(fits.warnings)


def _quantities(fit: MotionFit) -> Table:
    """Return the root mean squares of a single run."""
    table = _table("root mean square", "explained", first="quantity")
    for name, value in fit.root_mean_square.items():
        scatter = f"{degrees(value):.2f}°" if name == "rotation" else f"{1e3 * value:.1f} mm"
        table.add_row(name.replace("_", " "), scatter, f"{fit.r_squared[name]:.2%}" if name in fit.r_squared else "")
    return table


def _runs(inputs: Sequence[_Input], fit: MotionsFit) -> Table:
    """Return each of several runs at its own strength factor and at the common one."""
    table = _table("angle °", "m/s", "own factor", "normalised rms", "at the common factor", first="run")
    for each, run, alone in zip(inputs, fit.runs, fit.alone, strict=True):
        own = ("", "")
        if alone is not None:
            error = f"{alone.estimate.strength_factor:.3f} ± {alone.estimate.standard_error:.3f}"
            own = (error, f"{alone.normalized_root_mean_square:.4f}")
        table.add_row(
            escape(each.name),
            f"{degrees(each.impact.oblique_angle):g}",
            f"{each.impact.velocity:g}",
            *own,
            f"{run.normalized_root_mean_square:.4f}",
        )
    return table


def _print_obliquity(points: Sequence[ObliquityPoint], fit: ObliquityFit) -> None:
    coefficients = _table("coefficient", "standard error", first="power of °")
    for power, coefficient in enumerate(fit.coefficients):
        error = "" if fit.covariance is None else f"{fit.covariance[power][power] ** 0.5:.4g}"
        coefficients.add_row(str(power), f"{coefficient:.6g}", error)
    rows = _table("oblique angle °", "strength factor", "residual")
    for point, residual in zip(points, fit.residuals, strict=True):
        rows.add_row(f"{degrees(point.oblique_angle):g}", f"{point.strength_factor:g}", f"{residual:+.4f}")
    console = Console(highlight=False)
    console.print(coefficients, rows)
    console.print("strength_factor of a request:", markup=False)
    console.print_json(data=obliquity_answer(fit)["strength_factor_model"], indent=None)
    _print_warnings(fit.warnings)


def _table(*columns: str, first: str = "") -> Table:
    table = Table()
    if first:
        table.add_column(first, overflow="fold")
    for column in columns:
        table.add_column(column, justify="right")
    return table


def _columns(estimate: Estimate) -> tuple[str, str, str]:
    low, high = estimate.confidence_interval
    return f"{estimate.strength_factor:.3f}", f"{estimate.standard_error:.3f}", f"{low:.3f} to {high:.3f}"


def _sentence(estimate: Estimate) -> str:
    value, error, interval = _columns(estimate)
    return (
        f"strength factor {value}, standard error {error}, {estimate.confidence_level:.0%} interval {interval} "
        f"({estimate.degrees_of_freedom:.3g} degrees of freedom)"
    )


def _print_warnings(warnings: Sequence[ModelWarning]) -> None:
    for warning in warnings:
        print(f"warning: {warning.detail}", file=sys.stderr)
