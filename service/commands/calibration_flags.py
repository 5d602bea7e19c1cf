"""The flags of `ricochet calibrate`."""

import argparse
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from service.commands.case import add_case_flags
from service.commands.errors import CommandError
from service.commands.flags import BODY, STRIKE
from service.commands.parsers import Formatter, examples
from service.readers import DEPTH_TESTS, MOTION, OBLIQUITY_POINTS, Quantity

GREATEST_DEPTH = "greatest-depth"
SHORT = {
    "depth": ("depth_displacement",),
    "lateral": ("lateral_displacement",),
    "displacement": ("depth_displacement", "lateral_displacement"),
}
"""Short names of the quantities of a motion."""
CSV_FILES = (
    "Columns are known by their names, with the unit behind them (time_s, depth_displacement_mm, rotation_deg, "
    "velocity_m_s, mass_kg) or in brackets (time [ms]); SI where there is none. Commas, semicolons and tabs part them."
)
DYNA_FILES = (
    "LS-DYNA's rbdout and nodout as text and its binary binout are known by their content. They are in the units of "
    "the model, SI unless --unit says otherwise, and along its axes, which --axis names."
)


def add_depth(kinds: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the fit to depths."""
    parser = kinds.add_parser(
        "depth",
        help="one strength factor from depths in normal impact",
        description=f"Fit the strength factor to depths of normal-impact tests. {CSV_FILES}",
        formatter_class=Formatter,
        epilog=examples("ricochet calibrate depth tests.csv --case strike.toml"),
    )
    parser.add_argument("tests", metavar="TESTS.csv", help="velocity and depth of each test; mass and weight if there")
    _add_file_flags(parser, DEPTH_TESTS, "velocity=V0", "depth=mm")
    parser.add_argument("--group", action="store_true", help="fit each group of the column of groups too")
    _add_fit_flags(parser)
    parser.add_argument("--curves", type=Path, metavar="FILE.csv", help="write depth over velocity for each factor")
    add_case_flags(parser, BODY)


def add_motion(kinds: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the fit to a motion."""
    parser = kinds.add_parser(
        "motion",
        help="one strength factor from the motion in an oblique strike",
        description="Fit the strength factor to the motion of the centre of gravity since first contact: depth and "
        "lateral displacement and rotation, positive as the nose turns toward the face, or some of them. "
        f"{CSV_FILES} {DYNA_FILES}",
        formatter_class=Formatter,
        epilog=examples(
            "ricochet calibrate motion history.csv --case strike.toml --oblique-angle 30 --until greatest-depth"
        ),
    )
    parser.add_argument("history", metavar="HISTORY", help="CSV, rbdout, nodout or binout")
    _add_file_flags(parser, MOTION, "time=T(ms)", "time=ms")
    dyna = parser.add_argument_group("LS-DYNA's files")
    dyna.add_argument(
        "--axis",
        action="append",
        type=_pair,
        default=[],
        metavar="NAME=AXIS",
        help="depth, lateral or rotation by global axis, such as depth=-z; what is not named is left out",
    )
    dyna.add_argument("--part", type=int, metavar="ID", help="the rigid body, where there are several")
    dyna.add_argument("--node", type=int, metavar="ID", help="the node, which must be at the centre of gravity")
    parser.add_argument(
        "--contact",
        type=float,
        metavar="SECONDS",
        help="of first contact, where the file begins earlier; the first state if not given, 0 in CSV files",
    )
    parser.add_argument(
        "--until",
        type=_until,
        metavar="WHEN",
        help=f"fit up to {GREATEST_DEPTH} or up to so many seconds; to the end if not given",
    )
    parser.add_argument(
        "--weight",
        action="append",
        type=_pair,
        default=[],
        metavar="NAME=NUMBER",
        help="of depth, lateral or rotation, 1 if not given; 0 leaves it out",
    )
    _add_fit_flags(parser)
    parser.add_argument("--histories", type=Path, metavar="FILE.csv", help="write the motion for each factor")
    add_case_flags(parser, (*STRIKE, *BODY))


def add_obliquity(kinds: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the fit over the oblique angle."""
    parser = kinds.add_parser(
        "obliquity",
        help="a polynomial over the oblique angle from strength factors",
        description="Fit a polynomial to strength factors over the oblique angle, weighted by their standard errors if "
        f"there are, and print it as a request to /cra takes it. {CSV_FILES}",
        formatter_class=Formatter,
        epilog=examples("ricochet calibrate obliquity points.csv"),
    )
    parser.add_argument(
        "points", metavar="POINTS.csv", help="oblique_angle_deg, strength_factor and, if there, standard_error"
    )
    _add_file_flags(parser, OBLIQUITY_POINTS, "oblique_angle=theta", "oblique_angle=deg")
    parser.add_argument("--order", type=int, default=2, help="highest power of the angle (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print the answer as one line of JSON")


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
        help=f"where one of {names} stands, such as {column}; -HEADER turns the sign, an empty one leaves it out",
    )
    group.add_argument(
        "--unit",
        action="append",
        type=_pair,
        default=[],
        metavar="NAME=UNIT",
        help=f"such as {unit}; known are: {known}",
    )


def _add_fit_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--confidence", type=float, default=0.95, help="level of the interval (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print the answer as one line of JSON")
    parser.add_argument(
        "--strength-factors", type=float, nargs="+", default=[], metavar="S", help="to compare with the fitted one"
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


def named(flag: str, pairs: Iterable[tuple[str, str]], quantities: Sequence[Quantity]) -> dict[str, str]:
    """Return the values of a flag that is given once for each quantity.

    Raises
    ------
    CommandError
        If a name is not known, or comes twice.
    """
    values: dict[str, str] = {}
    names = [quantity.name for quantity in quantities]
    for given, value in pairs:
        for name in (given,) if given in names else SHORT.get(given, (given,)):
            if name not in names:
                raise CommandError(f"{flag} {given}={value}: no such quantity, known are {', '.join(names)}")
            if name in values:
                raise CommandError(f"{flag} {given}={value}: {name} is given twice")
            values[name] = value
    return values
