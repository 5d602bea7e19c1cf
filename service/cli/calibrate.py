"""`ricochet calibrate`: fit strength factors to tests and to finite element histories."""

import argparse
import csv
import io
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from service.cli.arguments import BODY, IMPACT, WRONG, CommandError, InputFile, examples
from service.cli.calibration_input import (
    GREATEST_DEPTH,
    CalibrationBody,
    StrikeCalibration,
    add_depth_flags,
    add_motion_flags,
    add_obliquity_flags,
    by_quantity,
    calibration_body,
)
from service.cli.outputs import OutputFile, check_outputs
from service.cli.writers import print_table, print_warnings
from service.names import CHOICES, named
from service.readers.calibration import (
    DEPTH_TESTS,
    MOTION,
    OBLIQUITY_POINTS,
    Expected,
    read_depth_tests,
    read_motion,
    read_motion_runs,
    read_obliquity_points,
)
from service.readers.dyna import CoordinateAxis
from service.readers.files import FileError
from service.schemas.calibration_motion import Calibration
from service.schemas.problems import unit_ends
from service.schemas.quantities import degrees
from solver import ParameterError
from solver.calibration import MotionHistory

DECAY_NAMES = CHOICES["resistance.free_surface.model"]


def add_calibrate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet calibrate`."""
    parser.description = "Fit strength factors to tests or finite element histories."
    parser.epilog = examples("ricochet calibrate obliquity points.csv --json")
    kinds = parser.add_subparsers(dest="calibration", required=True, metavar="KIND")
    for name, help_, add_flags in (
        ("depth", "one strength factor from depths in normal impact", add_depth_flags),
        ("motion", "one strength factor from the motion in an oblique impact", add_motion_flags),
        ("obliquity", "a polynomial in the oblique angle from strength factors", add_obliquity_flags),
    ):
        add_flags(kinds.add_parser(name, help=help_))
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run a fit, and print its result; return 1 if no fit is possible, 2 if a file or a flag is wrong."""
    fits: dict[str, Callable[[argparse.Namespace], None]] = {
        "depth": calibrate_depth,
        "motion": calibrate_motion,
        "obliquity": calibrate_obliquity,
    }
    try:
        fits[args.calibration](args)
    except (CommandError, FileError) as error:
        return _fail(args, error, error.status if isinstance(error, CommandError) else WRONG)
    return 0


def _fail(args: argparse.Namespace, error: Exception, status: int) -> int:
    print(f"ricochet calibrate {args.calibration}: {error}", file=sys.stderr)
    return status


def calibrate_depth(args: argparse.Namespace) -> None:
    """Fit a strength factor to depths, and print it."""
    body, case = calibration_body(args, Calibration, BODY, args.tests)
    found = read_depth_tests(
        args.tests,
        by_quantity("--column", args.column, DEPTH_TESTS),
        by_quantity("--unit", args.unit, DEPTH_TESTS),
        diameter=case.projectile.diameter_m,
        grouped=args.group,
    )
    tests = [_fields(asdict(test)) for test in found]
    # The first request compares no factors, because the fitted factor, which belongs among them, is not known yet.
    body.content.pop("compare_strength_factors", None)
    answer = body.answer("calibration_depth", args.url, tests=tests)
    if args.curves or args.strength_factors:  # The fitted factor is now known and gets a curve too.
        factors = sorted({*args.strength_factors, answer["strength_factor"]})
        answer = body.answer("calibration_depth", args.url, tests=tests, compare_strength_factors=factors)
    if args.curves:
        _write_csv(args.curves, answer["curves"])
    if args.json:
        _print_json(answer)
    elif args.uncertain:
        print(shots_as_uncertain(tests, answer["posterior"]))
    else:
        _print_depth(tests, answer, args)


def calibrate_motion(args: argparse.Namespace) -> None:
    """Fit a strength factor to one or several motions with each decay law, and print it."""
    if (args.history is None) == (args.runs is None):
        raise CommandError("either HISTORY or --runs RUNS.csv must be given")
    weights = _weights(args.weight)
    inputs = [_single_input(args)] if args.runs is None else _table_inputs(args)
    body = inputs[0].body
    if args.runs is None:
        data: dict[str, Any] = {"history": inputs[0].history}
    else:
        body = replace(body, data_file=str(args.runs))
        data = {"runs": [{"impact": each.impact, "history": each.history} for each in inputs]}
        del body.content["impact"]
    answer = body.answer("calibration_motion", args.url, weights=weights, **data)
    if args.histories or args.strength_factors:  # `compared` lacks the fitted factor; its motion is `predicted`.
        for run in answer.get("runs", [answer]):
            fitted = {"strength_factor": answer["strength_factor"], "history": run["predicted"]}
            others = [each for each in run.get("compared", ()) if each["strength_factor"] != answer["strength_factor"]]
            run["compared"] = sorted([*others, fitted], key=lambda each: float(each["strength_factor"]))
    if args.histories:
        _write_csv(args.histories, _compared_tables(answer))
    if args.json:
        _print_json(_with_impacts(answer, inputs))
    elif args.uncertain:
        print(as_uncertain(answer))
    else:
        _print_motion(inputs, answer, args)


def as_uncertain(answer: Mapping[str, Any]) -> str:
    """Return a fitted strength factor as TOML: a constant law, and its value as an uncertain input."""
    factor, error = f"{answer['strength_factor']:.6g}", f"{answer['standard_error']:.3g}"
    return f"""
[resistance.strength_factor]
model = "constant"
value = {factor}

[[uncertain]]
field = "resistance.strength_factor.value"
distribution = {{ type = "normal", mean = {factor}, standard_deviation = {error} }}"""


def shots_as_uncertain(tests: Sequence[Mapping[str, Any]], posterior: Mapping[str, float]) -> str:
    """Return depth tests as TOML: a strength factor of model `own_tests`, with its scatter as an uncertain input."""
    from solver.resistance import PLAUSIBLE_FACTORS

    kept = ("velocity_m_s", "depth_m", "mass_kg")
    rows = ("".join(f"{name} = {test[name]!r}, " for name in kept if name in test).rstrip(", ") for test in tests)
    shots = "\n".join(f"    {{ {row} }}," for row in rows)
    lower, upper = (f"{each / posterior['median']:.4g}" for each in PLAUSIBLE_FACTORS)
    spread = f"scale = {posterior['scale']:.4g}, degrees_of_freedom = {posterior['degrees_of_freedom']:g}"
    return f"""
[resistance.strength_factor]
model = "own_tests"
shots = [
{shots}
]

[[uncertain]]
field = "resistance.strength_residual"
distribution = {{ type = "log_student_t", median = 1.0, {spread}, lower = {lower}, upper = {upper} }}"""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Input:
    """A named history and its impact, as fields of a request, and the request body without histories."""

    name: str
    impact: dict[str, Any]
    history: dict[str, Any]
    body: CalibrationBody


def _single_input(args: argparse.Namespace) -> _Input:
    body, case = calibration_body(args, StrikeCalibration, (*IMPACT, *BODY), str(args.history))
    motion = _read_history(args, Expected(impact=case.impact.to_solver(), projectile=case.projectile.to_solver()))
    return _Input(name=args.history, impact=body.content["impact"], history=_fields(asdict(motion)), body=body)


def _table_inputs(args: argparse.Namespace) -> list[_Input]:
    """Read every run of a table, whose cells take precedence over the flags."""
    inputs = []
    for row in read_motion_runs(args.runs):
        cells = {f"impact/{name}": value for name, value in _fields(row.impact).items()}
        until = args.until if row.until is None else row.until
        own = argparse.Namespace(**(vars(args) | cells | {"history": InputFile(row.file), "until": until}))
        # The outputs are checked against the files of the runs, so that none of these is overwritten.
        check_outputs(own)
        try:
            inputs.append(replace(_single_input(own), name=row.name))
        except CommandError as error:
            raise CommandError(f"{args.runs}:{row.line}: {error}") from None
    return inputs


def _fields(quantities: Mapping[str, Any]) -> dict[str, Any]:
    """Convert quantities of the solver to fields of a request. Quantities that are None are left out."""
    fields, ends = {}, unit_ends()
    for name, quantity in quantities.items():
        value = quantity.tolist() if isinstance(quantity, np.ndarray) else quantity
        if value is not None and ends.get(name) == "_deg":
            value = list(map(degrees, value)) if isinstance(value, list) else degrees(value)
        if value is not None:
            fields[f"{name}{ends.get(name, '')}"] = value
    return fields


def _compared_tables(answer: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the compared motions as tables, with a run number if several runs were fitted."""
    if "runs" not in answer:
        return [{"strength_factor": each["strength_factor"], **each["history"]} for each in answer["compared"]]
    return [
        {"run": number, "strength_factor": each["strength_factor"], **each["history"]}
        for number, run in enumerate(answer["runs"])
        for each in run["compared"]
    ]


def _with_impacts(answer: Mapping[str, Any], inputs: Sequence[_Input]) -> dict[str, Any]:
    """Add the oblique angle, which `calibrate obliquity` needs, to an answer.

    If there are several runs, each gets its file, angle and speed instead.
    """
    if "runs" not in answer:
        return {"oblique_angle_deg": inputs[0].impact["oblique_angle_deg"], **answer}
    runs = [
        {
            "file": each.name,
            "oblique_angle_deg": each.impact["oblique_angle_deg"],
            "velocity_m_s": each.impact["velocity_m_s"],
            **run,
        }
        for each, run in zip(inputs, answer["runs"], strict=True)
    ]
    return {**answer, "runs": runs}


def calibrate_obliquity(args: argparse.Namespace) -> None:
    """Fit a polynomial in the oblique angle, and print it."""
    found = read_obliquity_points(
        args.points,
        by_quantity("--column", args.column, OBLIQUITY_POINTS),
        by_quantity("--unit", args.unit, OBLIQUITY_POINTS),
    )
    points = [_fields(asdict(point)) for point in found]
    body = CalibrationBody({"order": args.order}, None, {}, {"/order": "--order"}, args.points)
    answer = body.answer("calibration_obliquity", args.url, points=points)
    if args.json:
        _print_json(answer)
    else:
        _print_obliquity(points, answer, verbose=args.verbose)


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


def _weights(pairs: Iterable[tuple[str, str]]) -> dict[str, float]:
    values = {}
    for name, text in by_quantity("--weight", pairs, MOTION[1:]).items():
        try:
            values[name.removesuffix("_displacement")] = float(text)
        except ValueError:
            raise CommandError(f"--weight {name}={text}: must be a number") from None
    return values


def _write_csv(output: OutputFile, tables: Iterable[Mapping[str, Any]]) -> None:
    """Write tables one below the other, with a row for each time or velocity. Columns that a table lacks are empty."""
    tables, text = list(tables), io.StringIO()
    names = list(dict.fromkeys(name for table in tables for name in table))
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    for table in tables:
        columns = {name: values for name, values in table.items() if isinstance(values, list)}
        for row in zip(*columns.values(), strict=True):
            numbers = {**table, **dict(zip(columns, row, strict=True))}
            # Nine digits are far beyond the accuracy of any fit, but few enough to read.
            writer.writerow({name: f"{value:.9g}" for name, value in numbers.items()})
    output.write(text.getvalue().encode())


def _print_json(answer: Mapping[str, Any]) -> None:
    print(json.dumps(answer, allow_nan=False))


def _print_depth(tests: Sequence[Mapping[str, Any]], answer: Mapping[str, Any], args: argparse.Namespace) -> None:
    rows = [
        [f"{test['velocity_m_s']:g}", f"{test['depth_m']:g}", f"{predicted:.4f}", f"{1e3 * residual:+.1f}"]
        for test, predicted, residual in zip(tests, answer["predicted_depth_m"], answer["residuals"], strict=True)
    ]
    _print_rows(["velocity m/s", "depth m", "predicted m", "residual mm"], rows)
    if "groups" in answer:
        _print_rows(
            ["group", "strength factor", "standard error", "interval"],
            [[group["group"], *_columns(group)] for group in answer["groups"]],
        )
    print(_sentence(answer, args.confidence))
    print(f"root mean square {1e3 * answer['root_mean_square_m']:.1f} mm")
    posterior = answer["posterior"]
    print(
        f"next shot, with the published tests as prior: strength factor {posterior['median']:.3f}, scale "
        f"of its logarithm {posterior['scale']:.3f} ({posterior['degrees_of_freedom']:g} degrees of freedom)"
    )
    print_warnings(answer["warnings"], verbose=args.verbose)


def _print_motion(inputs: Sequence[_Input], answer: Mapping[str, Any], args: argparse.Namespace) -> None:
    requested = inputs[0].body.value_at("/resistance/free_surface/model") or "elastic_plastic"
    runs = answer.get("runs", [answer])
    if len(inputs) == 1:
        _print_quantities(runs[0])
    else:
        _print_runs(inputs, runs, answer["decay_laws"], requested)
    laws = []
    for law in answer["decay_laws"]:
        cells = ["", "", ""]
        if "strength_factor" in law:
            cells = [*_columns(law)[:2], f"{law['normalized_root_mean_square']:.4f}"]
        laws.append([named(DECAY_NAMES, law["free_surface"]), *cells])
    _print_rows(["decay law", "strength factor", "standard error", "normalised rms"], laws)
    described = f"{len(inputs)} runs"
    if len(inputs) == 1:
        angle, times = inputs[0].impact["oblique_angle_deg"], inputs[0].history["time_s"]
        described = f"{angle:g}° from the normal, {len(times)} instants up to {1e3 * times[-1]:.3g} ms"
    print(f"{named(DECAY_NAMES, requested)}: {_sentence(answer, args.confidence)}")
    print(f"best decay law: {named(DECAY_NAMES, answer['best_decay_law'])}")
    print(described)
    print_warnings(answer["warnings"], verbose=args.verbose)


def _print_quantities(run: Mapping[str, Any]) -> None:
    """Print the root-mean-square residual and the explained variance of each measured quantity of a single run."""
    rows = []
    for name, value in run["root_mean_square"].items():
        scatter = f"{value:.2f}°" if name == "rotation_deg" else f"{1e3 * value:.1f} mm"
        explained = f"{run['r_squared'][name]:.2%}" if name in run["r_squared"] else ""
        rows.append([name.rpartition("_")[0].replace("_", " "), scatter, explained])
    _print_rows(["quantity", "root mean square", "explained"], rows)


def _print_runs(
    inputs: Sequence[_Input], runs: Sequence[Mapping[str, Any]], laws: Sequence[Mapping[str, Any]], requested: str
) -> None:
    """Print the fit of each run with the strength factor fitted to it alone and with the common one."""
    own, rows = next(law["runs"] for law in laws if law["free_surface"] == requested), []
    for each, run, fitted in zip(inputs, runs, own, strict=True):
        cells = ["", ""]
        if alone := fitted.get("alone"):
            factor = f"{alone['strength_factor']:.3f} ± {alone['standard_error']:.3f}"
            cells = [factor, f"{alone['normalized_root_mean_square']:.4f}"]
        impact = (f"{each.impact[name]:g}" for name in ("oblique_angle_deg", "velocity_m_s"))
        rows.append([each.name, *impact, *cells, f"{run['normalized_root_mean_square']:.4f}"])
    _print_rows(["run", "angle °", "m/s", "own factor", "normalised rms", "at the common factor"], rows)


def _print_obliquity(points: Sequence[Mapping[str, Any]], answer: Mapping[str, Any], *, verbose: bool) -> None:
    coefficients = []
    for power, coefficient in enumerate(answer["coefficients"]):
        error = f"{answer['covariance'][power][power] ** 0.5:.4g}" if "covariance" in answer else ""
        coefficients.append([str(power), f"{coefficient:.6g}", error])
    _print_rows(["power of °", "coefficient", "standard error"], coefficients)
    rows = [
        [f"{point['oblique_angle_deg']:g}", f"{point['strength_factor']:g}", f"{residual:+.4f}"]
        for point, residual in zip(points, answer["residuals"], strict=True)
    ]
    _print_rows(["oblique angle °", "strength factor", "residual"], rows)
    print("strength_factor of a request:")
    print(json.dumps(answer["strength_factor_model"]))
    print_warnings(answer["warnings"], verbose=verbose)


def _print_rows(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table and an empty line."""
    print_table(columns, rows)
    print()


def _columns(estimate: Mapping[str, Any]) -> tuple[str, str, str]:
    if "standard_error" not in estimate:
        return f"{estimate['strength_factor']:.3f}", "", ""
    low, high = estimate["confidence_interval"]
    return f"{estimate['strength_factor']:.3f}", f"{estimate['standard_error']:.3f}", f"{low:.3f} to {high:.3f}"


def _sentence(estimate: Mapping[str, Any], confidence: float) -> str:
    value, error, interval = _columns(estimate)
    if not error:
        return f"strength factor {value}, from one test, which shows no scatter"
    text = f"strength factor {value}, standard error {error}, {confidence:.0%} interval {interval}"
    if estimate["standard_error"] == 0.0:
        return text
    return f"{text} ({_degrees_of_freedom(estimate, confidence):.3g} degrees of freedom)"


def _degrees_of_freedom(estimate: Mapping[str, Any], confidence: float) -> float:
    """Return the degrees of freedom of Student's distribution from the confidence interval of an answer.

    The upper end is used, because the lower one is truncated at 0.
    """
    from scipy.special import stdtridf

    reach = (estimate["confidence_interval"][1] - estimate["strength_factor"]) / estimate["standard_error"]
    return float(stdtridf(0.5 + 0.5 * confidence, reach))
