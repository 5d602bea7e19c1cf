"""`ricochet calibrate`: strength factors from tests and from finite element histories."""

import argparse
import csv
import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from service.commands.calibration_flags import (
    GREATEST_DEPTH,
    add_depth,
    add_motion,
    add_obliquity,
    named,
)
from service.commands.calibration_tables import print_depth, print_motion, print_obliquity
from service.commands.case import DepthCase, MotionCase, case_arguments
from service.commands.errors import FAILED, WRONG, CommandError
from service.commands.flags import BODY, STRIKE
from service.commands.parsers import examples
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
from solver import ENGINE_VERSION, ParameterError, RicochetError
from solver.calibration import (
    MotionHistory,
    MotionRun,
    Weights,
    fit_decay_laws,
    fit_depth,
    fit_obliquity,
    penetration_depths,
    predict_motion,
)

CURVE_POINTS = 41
MARGIN = 0.1  # of the range of velocities, drawn beyond the tests on either side


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its three kinds."""
    parser.description = "Fit strength factors to tests or finite element histories."
    parser.epilog = examples("ricochet calibrate obliquity points.csv --json")
    kinds = parser.add_subparsers(dest="calibration", required=True)
    add_depth(kinds)
    add_motion(kinds)
    add_obliquity(kinds)


def run(asked: argparse.Namespace) -> int:
    """Do what was asked for; return the exit status: 1 if nothing fits, 2 if a file or a flag is wrong."""
    try:
        {"depth": _depth, "motion": _motion, "obliquity": _obliquity}[asked.calibration](asked)
    except (CommandError, FileError) as error:
        return _told(asked, error, WRONG)
    except ParameterError as error:
        # The tests or the history as a whole: they are well formed, but nothing fits them.
        return _told(asked, error, FAILED if error.field in {"tests", "history"} else WRONG)
    except RicochetError as error:
        return _told(asked, error, FAILED)
    return 0


def _told(asked: argparse.Namespace, error: Exception, status: int) -> int:
    print(f"ricochet calibrate {asked.calibration}: {error}", file=sys.stderr)
    return status


def _depth(asked: argparse.Namespace) -> None:
    case = case_arguments(asked, DepthCase, BODY)
    tests = read_depth_tests(
        asked.tests,
        named("--column", asked.column, DEPTH_TESTS),
        named("--unit", asked.unit, DEPTH_TESTS),
        diameter=case["projectile"].diameter,
        grouped=asked.group,
    )
    fit = fit_depth(tests=tests, confidence_level=asked.confidence, **case)
    curves = []
    if asked.curves or asked.strength_factors:
        measured = np.array([test.velocity for test in tests])
        margin = MARGIN * (np.ptp(measured) or measured[0])
        lowest = max(measured.min() - margin, 0.5 * measured.min())
        velocities = np.linspace(lowest, measured.max() + margin, CURVE_POINTS)
        for factor in _compared(asked.strength_factors, fit.estimate.strength_factor):
            depths = penetration_depths(velocities=velocities, strength_factor=factor, **case)
            curves.append((factor, velocities, depths))
    answer = depth_answer(fit, curves)
    if asked.curves:
        _write(asked.curves, answer["curves"])
    if asked.json:
        _print_json(answer)
    else:
        print_depth(tests, fit)


def _motion(asked: argparse.Namespace) -> None:
    case = case_arguments(asked, MotionCase, (*STRIKE, *BODY))
    weights = _weights(asked.weight)
    history = _read_motion(asked, Expected(impact=case["impact"], projectile=case["projectile"]))
    run = MotionRun(impact=case.pop("impact"), history=history, weights=weights)
    fits = fit_decay_laws(runs=[run], confidence_level=asked.confidence, **case)
    fit = fits.requested.runs[0]
    compared = []
    if asked.histories or asked.strength_factors:
        for factor in _compared(asked.strength_factors, fit.estimate.strength_factor):
            motion = predict_motion(strength_factor=factor, times=history.time, impact=run.impact, **case)
            compared.append((factor, motion))
    answer = motion_answer(fits, [compared], several=False)
    if asked.histories:
        tables = [{"strength_factor": each["strength_factor"], **each["history"]} for each in answer["compared"]]
        _write(asked.histories, tables)
    if asked.json:  # with the oblique angle, which a fit over it needs
        _print_json({"oblique_angle_deg": degrees(run.impact.oblique_angle)} | answer)
    else:
        print_motion(run.impact, fit)


def _obliquity(asked: argparse.Namespace) -> None:
    points = read_obliquity_points(
        asked.points,
        named("--column", asked.column, OBLIQUITY_POINTS),
        named("--unit", asked.unit, OBLIQUITY_POINTS),
    )
    try:
        fit = fit_obliquity(points=points, order=asked.order)
    except ParameterError as error:
        raise CommandError(f"{asked.points}: {error}") from None
    if asked.json:
        _print_json(obliquity_answer(fit))
    else:
        print_obliquity(points, fit)


def _read_motion(asked: argparse.Namespace, expected: Expected) -> MotionHistory:
    try:
        axes = {name: Axis.named(axis) for name, axis in named("--axis", asked.axis, MOTION[1:]).items()}
    except ValueError as error:
        raise CommandError(f"--axis: {error}") from None
    history = read_motion(
        asked.history,
        named("--column", asked.column, MOTION),
        named("--unit", asked.unit, MOTION),
        axes=axes,
        part=asked.part,
        node=asked.node,
        contact=asked.contact,
        expected=expected,
    )
    if asked.until is None:
        return history
    try:
        return history.until(history.time_of_greatest_depth if asked.until == GREATEST_DEPTH else asked.until)
    except ParameterError as error:
        raise CommandError(f"--until: {asked.history}: {error}") from None


def _weights(pairs: Iterable[tuple[str, str]]) -> Weights:
    values = {}
    for name, text in named("--weight", pairs, MOTION[1:]).items():
        try:
            values[name.removesuffix("_displacement")] = float(text)
        except ValueError:
            raise CommandError(f"--weight {name}={text}: must be a number") from None
    return Weights(**values)


def _compared(factors: Iterable[float], fitted: float) -> list[float]:
    return sorted({*factors, fitted})


def _write(path: Path, tables: Iterable[Mapping[str, Any]]) -> None:
    """Write tables as one, a row for each instant or velocity of each."""
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
