"""Input of `ricochet calibrate`: flags, and the request body made from flags, a case and a data file."""

import argparse
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from service.cli.arguments import (
    BODY,
    FAILED,
    IMPACT,
    CommandError,
    Flag,
    InputFile,
    RefusedError,
    add_numbers,
    add_url,
    add_verbose,
    examples,
)
from service.cli.local import refusals
from service.cli.outputs import add_output_file
from service.cli.request_body import RequestBody, read_body
from service.cli.single import answer_of
from service.errors import validated_as
from service.readers.calibration import DEPTH_TESTS, MOTION, OBLIQUITY_POINTS
from service.readers.table import Quantity
from service.schemas.calibration_motion import Calibration
from service.schemas.strike import Impact

GREATEST_DEPTH = "greatest-depth"
SHORT_NAMES = {
    "depth": ("depth_displacement",),
    "lateral": ("lateral_displacement",),
    "displacement": ("depth_displacement", "lateral_displacement"),
}
"""Quantities of a motion, by the short names that flags accept."""
NOT_USED = ("output", "search", "custom_id")
"""Fields of a case that a calibration ignores."""
DATA = ("tests", "history", "runs", "points")
"""Fields of a calibration that come from a data file."""
NOT_FITTED = frozenset({"/tests", "/history", "/runs"})
"""Pointers to the data of a fit as a whole. An error with such a pointer means that valid data cannot be fitted."""
VERBOSE = "print the warnings in full, with the standing notes"
CSV_FILES = (
    "Columns are found by their names, with the unit at the end (time_s, depth_displacement_mm, rotation_deg, "
    "velocity_m_s, mass_kg) or in brackets (time [ms]); without a unit they are SI. Separators are commas, semicolons "
    "or tabs."
)
DYNA_FILES = (
    "LS-DYNA's rbdout and nodout text files and its binary binout are recognized by their content. They are in the "
    "units of the model, SI unless set by --unit, and along its axes, which --axis assigns."
)


def add_depth_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `ricochet calibrate depth`."""
    parser.description = f"Fit the strength factor to depths of normal-impact tests. {CSV_FILES}"
    parser.epilog = examples("ricochet calibrate depth tests.csv --case strike.toml")
    parser.add_argument(
        "tests",
        type=InputFile,
        metavar="TESTS.csv",
        help="CSV file with velocity and depth of each test, optionally its mass and weight",
    )
    _add_file_flags(parser, DEPTH_TESTS, "velocity=V0", "depth=mm")
    parser.add_argument("--group", action="store_true", help="also fit each group of the group column")
    _add_fit_flags(parser)
    described = "write depth over velocity for each factor"
    add_output_file(parser, "--curves", endings=(".csv",), metavar="FILE.csv", help=described)
    _add_case_flags(parser, BODY)


def add_motion_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `ricochet calibrate motion`."""
    parser.description = (
        "Fit the strength factor to the motion of the centre of gravity since first contact: depth displacement, "
        "lateral displacement and rotation (positive as the nose turns toward the face), or some of them. "
        f"S is fitted with every decay law. {CSV_FILES} {DYNA_FILES}"
    )
    parser.epilog = examples(
        "ricochet calibrate motion history.csv --case strike.toml --oblique-angle 30 --until greatest-depth",
        "ricochet calibrate motion --runs runs.csv --case strike.toml --until greatest-depth",
    )
    parser.add_argument(
        "history",
        nargs="?",
        type=InputFile,
        metavar="HISTORY",
        help="file of the motion: CSV, rbdout, nodout or binout",
    )
    parser.add_argument(
        "--runs",
        type=InputFile,
        metavar="RUNS.csv",
        help="fit several histories together: a table with the file, oblique_angle, velocity and until of each run; "
        "flags set the columns that it lacks",
    )
    _add_file_flags(parser, MOTION, "time=T(ms)", "time=ms")
    dyna = parser.add_argument_group("LS-DYNA files")
    dyna.add_argument(
        "--axis",
        action="append",
        type=_pair,
        default=[],
        metavar="NAME=AXIS",
        help="global axis of depth, lateral or rotation, such as depth=-z; quantities without an axis are not fitted",
    )
    dyna.add_argument("--part", type=int, metavar="ID", help="id of the rigid body to read, if the file has several")
    dyna.add_argument(
        "--node", type=int, metavar="ID", help="id of the node to read, which must be at the centre of gravity"
    )
    parser.add_argument(
        "--contact",
        type=float,
        metavar="SECONDS",
        help="time of first contact, if the file begins earlier (default: the first state; in CSV files 0)",
    )
    parser.add_argument(
        "--until",
        type=_until,
        metavar="WHEN",
        help=f"end of the fitted part: {GREATEST_DEPTH} or a time in seconds (default: the end of the file)",
    )
    parser.add_argument(
        "--weight",
        action="append",
        type=_pair,
        default=[],
        metavar="NAME=NUMBER",
        help="weight of depth, lateral or rotation (default: 1); 0 excludes it",
    )
    _add_fit_flags(parser)
    described = "write the motion for each factor"
    add_output_file(parser, "--histories", endings=(".csv",), metavar="FILE.csv", help=described)
    _add_case_flags(parser, (*IMPACT, *BODY))


def add_obliquity_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `ricochet calibrate obliquity`."""
    parser.description = (
        "Fit a polynomial in the oblique angle to strength factors, weighted by their standard errors if given, and "
        f"print it as the strength_factor of a request. {CSV_FILES}"
    )
    parser.epilog = examples("ricochet calibrate obliquity points.csv")
    parser.add_argument(
        "points",
        type=InputFile,
        metavar="POINTS.csv",
        help="CSV file with oblique_angle_deg, strength_factor and optionally standard_error",
    )
    _add_file_flags(parser, OBLIQUITY_POINTS, "oblique_angle=theta", "oblique_angle=deg")
    parser.add_argument(
        "--order", type=int, default=2, metavar="N", help="degree of the polynomial in the angle (%(default)s)"
    )
    parser.add_argument("--json", action="store_true", help="print the answer as one line of JSON")
    add_verbose(parser, VERBOSE)
    add_url(parser)


def _add_file_flags(parser: argparse.ArgumentParser, quantities: Sequence[Quantity], column: str, unit: str) -> None:
    names = ", ".join(quantity.name for quantity in quantities)
    known = "; ".join(f"{q.name} {' '.join(q.units)}" for q in quantities if q.units and len(q.units) > 1)
    group = parser.add_argument_group("file")
    group.add_argument(
        "--column",
        action="append",
        type=_pair,
        default=[],
        metavar="NAME=HEADER",
        help=f"column of one of {names}, such as {column}; -HEADER changes the sign, an empty header ignores it",
    )
    group.add_argument(
        "--unit",
        action="append",
        type=_pair,
        default=[],
        metavar="NAME=UNIT",
        help=f"unit of a column, such as {unit}; known are: {known}",
    )


def _add_fit_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--confidence", type=float, default=0.95, metavar="P", help="confidence level of the interval (%(default)s)"
    )
    forms = parser.add_mutually_exclusive_group()
    forms.add_argument("--json", action="store_true", help="print the answer as one line of JSON")
    forms.add_argument(
        "--uncertain",
        action="store_true",
        help="print the strength factor and its standard error as TOML tables, to append to a file for `ricochet "
        "uncertainty`",
    )
    parser.add_argument(
        "--strength-factors",
        type=float,
        nargs="+",
        default=[],
        metavar="S",
        help="further strength factors to predict with",
    )
    add_verbose(parser, VERBOSE)
    add_url(parser)


def _add_case_flags(parser: argparse.ArgumentParser, flags: Sequence[Flag]) -> None:
    add_numbers(parser, flags).add_argument(
        "--case", type=InputFile, metavar="FILE", help="TOML or JSON file with a request body of /trajectory"
    )


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE, got {text!r}")
    return name.strip(), value


def _until(text: str) -> str | float:
    if text == GREATEST_DEPTH:
        return text
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise argparse.ArgumentTypeError(f"must be {GREATEST_DEPTH} or a time in seconds above 0, got {text!r}")
    return seconds


def by_quantity(flag: str, pairs: Iterable[tuple[str, str]], quantities: Sequence[Quantity]) -> dict[str, str]:
    """Return the values of a repeated flag by quantity.

    Raises
    ------
    CommandError
        If a name is unknown or repeated.
    """
    values: dict[str, str] = {}
    names = [quantity.name for quantity in quantities]
    for given, value in pairs:
        for name in (given,) if given in names else SHORT_NAMES.get(given, (given,)):
            if name not in names:
                raise CommandError(f"{flag} {given}={value}: unknown quantity, known are {', '.join(names)}")
            if name in values:
                raise CommandError(f"{flag} {given}={value}: {name} is given twice")
            values[name] = value
    return values


CalibrationT = TypeVar("CalibrationT", bound=Calibration)


class StrikeCalibration(Calibration):
    """Body of a calibration with the impact of a single run."""

    impact: Impact


@dataclass(frozen=True)
class CalibrationBody(RequestBody):
    """Request body of a calibration, with the flag or the file from which each field comes.

    Parameters
    ----------
    data_file
        File of the tests, the history, the runs or the points.
    """

    data_file: str

    def describe(self, pointer: str, detail: str) -> str:
        """Return an error message that names the flag or the file of the field."""
        if pointer.removeprefix("/").partition("/")[0] not in DATA:
            return super().describe(pointer, detail)
        return f"{self.data_file}: {pointer[1:].replace('/', '.')}: {detail}"

    def explain(self, error: RefusedError) -> CommandError:
        """Return an error that names flags and files, with exit status 1 instead of 2 if the data cannot be fitted."""
        found = super().explain(error)
        if any(each["pointer"] in NOT_FITTED for each in error.errors):
            found.status = FAILED
        return found

    def answer(self, operation: str, url: str | None, **further: Any) -> dict[str, Any]:
        """Return the answer to this body with further fields, from the service at `url` or computed here."""
        answer: dict[str, Any] = json.loads(answer_of(operation, replace(self, content=self.content | further), url))
        return answer


def calibration_body(
    args: argparse.Namespace, model: type[CalibrationT], flags: Sequence[Flag], data_file: str
) -> tuple[CalibrationBody, CalibrationT]:
    """Return the request body of a fit without its data, from flags and the `--case` file, and its validated form.

    The body is validated before the data are read, because the data are checked against the projectile and the impact.

    Raises
    ------
    CommandError
        If the file holds no JSON object or a field is invalid; the message names the flag or the pointer.
    """
    case = read_body(args.case, args, flags)
    # These fields are ignored rather than refused, so that a strike file can also be used for a calibration.
    content = {name: value for name, value in case.content.items() if name not in NOT_USED}
    if "impact" not in model.model_fields:
        content.pop("impact", None)
    if isinstance(content.get("resistance"), dict):
        # The fit determines the strength factor, so the strength factor of the case is ignored.
        content["resistance"] = {k: v for k, v in content["resistance"].items() if k != "strength_factor"}
    content["confidence_level"] = args.confidence
    given = {**case.given, "/confidence_level": "--confidence", "/weights": "--weight"}
    given |= {f"/weights/{name}": f"--weight {name}" for name in ("depth", "lateral", "rotation")}
    if args.strength_factors:
        content["compare_strength_factors"] = args.strength_factors
        given |= dict.fromkeys(
            [
                "/compare_strength_factors",
                *(f"/compare_strength_factors/{i}" for i in range(len(args.strength_factors))),
            ],
            "--strength-factors",
        )
    body = CalibrationBody(content, case.file, case.flags, given, data_file)
    try:
        with refusals():
            valid = validated_as(model, content)
            # The conversion to the solver checks that the fields do not contradict each other.
            valid.model_arguments()
    except RefusedError as error:
        raise body.explain(error) from None
    return body, valid
