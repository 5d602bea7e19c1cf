"""`ricochet calibrate`: strength factors from tests and from finite element histories."""

import argparse
import csv
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from service.cli.arguments import BODY, IMPACT, Formatter, examples
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
from service.cli.errors import FAILED, WRONG, CommandError
from service.readers import (
    DEPTH_TESTS,
    MOTION,
    OBLIQUITY_POINTS,
    Axis,
    Expected,
    FileError,
    read_depth_tests,
    read_motion,
    read_obliquity_points,
)
from service.schemas import depth_answer, motion_answer, obliquity_answer
from service.schemas.quantities import degrees
from solver import ENGINE_VERSION, Impact, ModelWarning, ParameterError, RicochetError
from solver.calibration import (
    DepthFit,
    DepthTest,
    Estimate,
    MotionFit,
    MotionHistory,
    ObliquityFit,
    ObliquityPoint,
    Weights,
    fit_depth,
    fit_motion,
    fit_obliquity,
    penetration_depths,
    predict_motion,
)

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
        return _fail(args, error, FAILED if error.field in {"tests", "history"} else WRONG)
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
    else:
        _print_depth(tests, fit)


def calibrate_motion(args: argparse.Namespace) -> None:
    """Fit a strength factor to a motion and print it."""
    case = case_arguments(args, MotionCase, (*IMPACT, *BODY))
    weights = _weights(args.weight)
    history = _read_history(args, Expected(impact=case["impact"], projectile=case["projectile"]))
    fit = fit_motion(history=history, weights=weights, confidence_level=args.confidence, **case)
    compared = []
    if args.histories or args.strength_factors:
        for factor in sorted({*args.strength_factors, fit.estimate.strength_factor}):
            motion = predict_motion(strength_factor=factor, times=history.time, **case)
            compared.append((factor, motion))
    answer = motion_answer(fit, compared)
    if args.histories:
        tables = [{"strength_factor": each["strength_factor"], **each["history"]} for each in answer["compared"]]
        _write_csv(args.histories, tables)
    if args.json:  # with the oblique angle, which `calibrate obliquity` needs
        _print_json({"oblique_angle_deg": degrees(case["impact"].oblique_angle)} | answer)
    else:
        _print_motion(case["impact"], fit)


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
        axes = {name: Axis.named(axis) for name, axis in by_quantity("--axis", args.axis, MOTION[1:]).items()}
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
    """Write tables below each other, a row for each instant or velocity."""
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            for number, table in enumerate(tables):
                if number == 0:
                    writer.writerow(table)
                names = [name for name in table if isinstance(table[name], list)]
                for row in zip(*(table[name] for name in names), strict=True):
                    writer.writerow([f"{value:.9g}" for value in (table["strength_factor"], *row)])
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


def _print_motion(impact: Impact, fit: MotionFit) -> None:
    table = _table("root mean square", "explained", first="quantity")
    for name, value in fit.root_mean_square.items():
        scatter = f"{degrees(value):.2f}°" if name == "rotation" else f"{1e3 * value:.1f} mm"
        table.add_row(name.replace("_", " "), scatter, f"{fit.r_squared[name]:.2%}" if name in fit.r_squared else "")
    console = Console(highlight=False)
    console.print(table)
    range_ = f"{len(fit.predicted.time)} instants up to {1e3 * fit.predicted.time[-1]:.3g} ms"
    angle = f"{degrees(impact.oblique_angle):g}° from the normal, {range_}"
    console.print(_sentence(fit.estimate), angle, sep="\n", markup=False, soft_wrap=True)
    _print_warnings(fit.warnings)


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
        table.add_column(first)
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
