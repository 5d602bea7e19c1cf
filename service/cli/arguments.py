"""Arguments that several commands share, errors, and exit statuses."""

import argparse
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from service.names import CHOICES, UNITS

if TYPE_CHECKING:
    from service.settings import Settings


FAILED, WRONG, SOME_FAILED, INTERRUPTED = 1, 2, 3, 130
"""Exit statuses: the computation or the service failed; the input or the usage is wrong; some cases of a batch have no
result; Ctrl-C was pressed, for which shells report 128 plus the number of SIGINT."""
EXIT_STATUSES = f"""\
exit status:
  0  success
  {FAILED}  the computation failed, or the service failed or cannot be reached
  {WRONG}  a file, a flag or a value is wrong
  {SOME_FAILED}  finished, but some cases of a batch have a problem instead of a result
  {INTERRUPTED}  interrupted (Ctrl-C)"""
INPUT_STATUSES = frozenset({400, 404, 405, 406, 413, 415})
"""HTTP statuses of errors in the request, after which the command ends with `WRONG`."""
MANY = ("cra", "trajectory", "thickness", "limit-speed", "cra_uncertainty", "trajectory_uncertainty")
"""Operations of batches and sweeps, the default first."""
INVALID = "urn:ricochet:problem:invalid-request"


class CommandError(Exception):
    """The command cannot continue. The message is printed for the user.

    Parameters
    ----------
    text
        Message.
    status
        Exit status of the command.
    """

    def __init__(self, text: str, status: int = WRONG) -> None:
        super().__init__(text)
        self.status = status


class UsageError(CommandError):
    """The command line is wrong. A pointer to `--help` is printed after the message.

    Parameters
    ----------
    text
        Message, beginning with the flag.
    command
        Command with its action, such as `ricochet jobs list`. By default the command that is running.
    """

    def __init__(self, text: str, command: str = "") -> None:
        super().__init__(text)
        self.command = command


class RefusedError(CommandError):
    """A request was answered with a problem document (RFC 9457).

    Parameters
    ----------
    problem
        Problem document.
    """

    def __init__(self, problem: Mapping[str, Any]) -> None:
        self.problem = problem
        status = problem.get("status", 0)
        wrong = problem.get("type") == INVALID or status in INPUT_STATUSES
        super().__init__(problem_text(problem), WRONG if wrong else FAILED)

    @property
    def errors(self) -> list[dict[str, str]]:
        """Invalid fields of the request, each a `pointer` and a `detail`."""
        return list(self.problem.get("errors", ()))


def reason_of(error: BaseException) -> str:
    """Return the text of a system error without its number."""
    return re.sub(r"\[Errno -?\d+\] ", "", str(error))


def problem_text(problem: Mapping[str, Any]) -> str:
    """Return a problem document as one sentence."""
    return ": ".join(str(problem[name]) for name in ("title", "detail") if problem.get(name))


URL, DATA_DIR = "RICOCHET_URL", "RICOCHET_DATA_DIR"
"""Environment variables with the defaults of `--url` and `--data-dir`."""


def read_numbers(text: str) -> list[float]:
    """Parse numbers separated by commas.

    Raises
    ------
    ArgumentTypeError
        If one of them is not a number.
    """
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be numbers with commas between them, got {text!r}") from None


def read_points(text: str) -> list[list[float]]:
    """Parse the points X,R:X,R:... of a profile.

    Raises
    ------
    ArgumentTypeError
        If the text does not have this form.
    """
    points = [point.split(",") for point in text.split(":")]
    try:
        return [[float(x), float(radius)] for x, radius in points]
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be points X,R:X,R:..., got {text!r}") from None


class InputFile(str):
    """Path of an input file as typed; `-` is standard input."""

    __slots__ = ()


class Flag(NamedTuple):
    """A flag for one field of a case.

    The flags are written out as a table, because deriving them from the models would delay every help text by a second.
    A test compares the table with the models: fields, choices, units, defaults and bounds.

    Parameters
    ----------
    steps
        Path of the field in the request body.
    read
        Function that converts the text on the command line to the value of the field.
    choices
        Allowed values.
    implies
        Variants of a union that have the field, such as the shapes of a nose. The flag selects the first of them,
        unless the file or another flag selects one of the others.
    """

    name: str
    steps: tuple[str, ...]
    help: str
    short: tuple[str, ...] = ()
    read: Callable[[str], Any] = float
    metavar: str = "NUMBER"
    choices: tuple[str, ...] | None = None
    implies: tuple[str, ...] = ()

    @property
    def pointer(self) -> str:
        """JSON pointer of the field."""
        return "".join(f"/{step}" for step in self.steps)


NOSE, STRENGTH, FREE_SURFACE = ("projectile", "nose"), ("resistance", "strength_factor"), ("resistance", "free_surface")
"""Paths of the parts of a case that are unions of several models."""
MODEL_NAMES: Mapping[tuple[str, ...], str] = {NOSE: "shape", STRENGTH: "model", FREE_SURFACE: "model"}
"""Discriminator of each of these unions, by the path of the union."""
SHAPES, LAWS, DECAYS = (tuple(CHOICES[".".join((*part, name))]) for part, name in MODEL_NAMES.items())
"""Values of the discriminators."""
BODY = (
    Flag("--diameter", ("projectile", "diameter_m"), "shank diameter [m]"),
    Flag("--length", ("projectile", "length_m"), "length from nose tip to base [m]"),
    Flag("--mass", ("projectile", "mass_kg"), "mass of the projectile [kg]"),
    Flag("--nose", ("projectile", "nose", "shape"), "shape of the nose", read=str, metavar="SHAPE", choices=SHAPES),
    Flag(
        "--caliber-radius-head",
        ("projectile", "nose", "caliber_radius_head"),
        "radius of an ogive, or with --nose spherical of a cap, over the diameter [1]",
        implies=("ogive", "spherical"),
    ),
    Flag(
        "--length-to-diameter",
        ("projectile", "nose", "length_to_diameter"),
        "height of a cone over the diameter [1]",
        implies=("conical",),
    ),
    Flag(
        "--profile",
        ("projectile", "nose", "points"),
        "points of a convex nose or body from the tip, distances behind it and from the axis [m]",
        read=read_points,
        metavar="X,R:X,R...",
        implies=("profile",),
    ),
    Flag("--boat-tail-length", ("projectile", "boat_tail", "length_m"), "length of the taper before the base [m]"),
    Flag("--base-diameter", ("projectile", "boat_tail", "base_diameter_m"), "diameter of the base behind a taper [m]"),
    Flag(
        "--center-of-gravity",
        ("projectile", "center_of_gravity_m"),
        "distance of the centre of gravity behind the nose tip [m] (default: homogeneous projectile)",
    ),
    Flag(
        "--moment-of-inertia",
        ("projectile", "moment_of_inertia_kg_m2"),
        "transverse moment of inertia about the centre of gravity [kg m²] (default: homogeneous projectile)",
    ),
    Flag("--compressive-strength", ("target", "compressive_strength_pa"), "compressive strength of the concrete [Pa]"),
    Flag("--density", ("target", "density_kg_m3"), "density of the concrete [kg/m³]"),
    Flag(
        "--youngs-modulus",
        ("target", "youngs_modulus_pa"),
        "Young's modulus of the concrete [Pa] (default: from the strength, ACI 318-19)",
    ),
    Flag("--poissons-ratio", ("target", "poissons_ratio"), "Poisson's ratio of the concrete [1] (default: 0.5)"),
    Flag("--thickness", ("target", "thickness_m"), "thickness of the wall [m] (default: half-space)"),
)
RESISTANCE = (
    Flag(
        "--strength-law",
        (*STRENGTH, "model"),
        "law of the strength factor S (default: obliquity_polynomial, eq. 9)",
        read=str,
        metavar="LAW",
        choices=LAWS,
    ),
    Flag(
        "--shots",
        (*STRENGTH, "shots"),
        "CSV file of your own shots (velocity, depth, optionally mass and diameter), from which S is estimated",
        read=InputFile,
        metavar="FILE",
        implies=("own_tests",),
    ),
    Flag("--strength-factor", (*STRENGTH, "value"), "constant strength factor S [1]", implies=("constant",)),
    Flag(
        "--strength-coefficients",
        (*STRENGTH, "coefficients"),
        "coefficients of a polynomial S in the oblique angle, from the constant term [1, 1/°, 1/°²...]",
        read=read_numbers,
        metavar="A,B,C...",
        implies=("obliquity_polynomial",),
    ),
    Flag(
        "--strength-coefficient",
        (*STRENGTH, "coefficient"),
        "coefficient of a power law S of the compressive strength [1] (default: 82.6)",
        implies=("strength_power_law",),
    ),
    Flag(
        "--strength-exponent",
        (*STRENGTH, "exponent"),
        "exponent of the strength in that power law [1] (default: -0.544)",
        implies=("strength_power_law",),
    ),
    Flag(
        "--reference-strength",
        (*STRENGTH, "reference_strength_pa"),
        "reference strength of the power law [Pa] (default: 1e6)",
        implies=("strength_power_law",),
    ),
    Flag(
        "--diameter-exponent",
        (*STRENGTH, "diameter_exponent"),
        "exponent of the diameter in the power law [1] (default: 0)",
        implies=("strength_power_law",),
    ),
    Flag(
        "--reference-diameter",
        (*STRENGTH, "reference_diameter_m"),
        "reference diameter of the power law [m] (default: 0.0762)",
        implies=("strength_power_law",),
    ),
    Flag(
        "--obliquity-shape",
        (*STRENGTH, "obliquity_shape"),
        "change of the power law, or of the law of published tests, with the oblique angle",
        read=str,
        metavar="SHAPE",
        choices=tuple(CHOICES["resistance.strength_factor.obliquity_shape"]),
        implies=("published_tests", "own_tests", "strength_power_law"),
    ),
    Flag(
        "--free-surface",
        (*FREE_SURFACE, "model"),
        "decay of the resistance near the faces (default: elastic_plastic)",
        read=str,
        metavar="MODEL",
        choices=DECAYS,
    ),
    Flag(
        "--strength-scatter",
        ("strength_scatter",),
        "tests from which the scatter of S comes (default: law)",
        read=str,
        metavar="TESTS",
        choices=tuple(CHOICES["strength_scatter"]),
    ),
)
VELOCITY = Flag("--velocity", ("impact", "velocity_m_s"), "speed at first contact [m/s]")
OBLIQUE_ANGLE = Flag(
    "--oblique-angle",
    ("impact", "oblique_angle_deg"),
    "angle from the inward normal to the velocity [°]",
    short=("--angle",),
)
ATTACK = (
    Flag("--angle-of-attack", ("impact", "angle_of_attack_deg"), "axis angle minus velocity angle [°] (default: 0)"),
    Flag("--angular-velocity", ("impact", "angular_velocity_rad_s"), "rotation rate of the axis [rad/s] (default: 0)"),
)
IMPACT = (VELOCITY, OBLIQUE_ANGLE, *ATTACK)
STRIKE = (*IMPACT, *BODY, *RESISTANCE)
"""All flags of a strike."""
SHOWN_UNITS = Flag(
    "--units",
    ("units",),
    "units of the report; the input is in SI (default: si)",
    read=str,
    metavar="SYSTEM",
    choices=tuple(UNITS),
)


def add_case(parser: argparse.ArgumentParser, flags: Sequence[Flag]) -> None:
    """Add the arguments of one case: a file, flags for its fields, and `--set` for any other field."""
    parser.add_argument(
        "case",
        nargs="?",
        type=InputFile,
        metavar="CASE",
        help="TOML or JSON file with a request body; - reads JSON from a pipe",
    )
    group = add_numbers(parser, flags)
    group.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="FIELD=VALUE",
        help="set any field, such as resistance.free_surface.model=none",
    )


def add_numbers(parser: argparse.ArgumentParser, flags: Sequence[Flag]) -> Any:
    """Add the flags for the fields of a case, and return their group."""
    group = parser.add_argument_group("case", "SI units, angles in degrees from the normal; flags override the file")
    for flag in flags:
        group.add_argument(
            flag.name,
            *flag.short,
            dest="/".join(flag.steps),
            type=flag.read,
            metavar=flag.metavar,
            choices=flag.choices,
            help=f"{flag.help}: {', '.join(flag.choices)}" if flag.choices else flag.help,
        )
    return group


def add_verbose(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the flag `--verbose`; `what` is its help text."""
    parser.add_argument("-v", "--verbose", action="store_true", help=what)


def add_alternatives(parser: argparse.ArgumentParser) -> None:
    """Add the flag `--alternatives`, which also computes the case with other laws."""
    parser.add_argument(
        "--alternatives",
        action="store_true",
        help="also compute the case with each decay law and strength law; with --csv print these alone",
    )


def add_url(parser: argparse.ArgumentParser, default: str = "compute locally") -> None:
    """Add the flag `--url`. In its help text, `default` says what the command does without the flag."""
    parser.add_argument(
        "--url",
        default=os.environ.get(URL) or None,
        help=f"address of a service, also set by {URL} (default: {default}); its API key is read from RICOCHET_API_KEY",
    )


def add_data_dir(parser: argparse.ArgumentParser) -> None:
    """Add the flag `--data-dir`, which keeps locally computed results in a folder."""
    parser.add_argument(
        "--data-dir",
        type=Path,
        default=os.environ.get(DATA_DIR) or None,
        metavar="FOLDER",
        help=f"keep locally computed results in this folder, also set by {DATA_DIR} (default: keep nothing)",
    )


def add_operation(parser: argparse.ArgumentParser) -> None:
    """Add the flag `--operation` of batches and sweeps."""
    parser.add_argument(
        "--operation", choices=MANY, default="cra", help="operation to compute for each case (default: %(default)s)"
    )


def add_actions(
    parser: argparse.ArgumentParser, actions: Sequence[tuple[str, str, str]]
) -> dict[str, argparse.ArgumentParser]:
    """Add the actions of a command, each with a name, a help text and an example; return their parsers by name."""
    subparsers: Any = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    return {
        action: subparsers.add_parser(
            action,
            help=help_,
            description=f"{help_[0].upper()}{help_[1:]}.",
            epilog=examples(example),
        )
        for action, help_, example in actions
    }


def examples(*commands: str) -> str:
    """Format examples for the end of a help text."""
    return "\n".join(("example:" if len(commands) == 1 else "examples:", *(f"  {command}" for command in commands)))


def read_settings(**fixed: Any) -> "Settings":
    """Read the settings of the service from the environment; keyword arguments override it.

    Raises
    ------
    UsageError
        If a setting is invalid.
    """
    from pydantic import ValidationError

    from service.schemas.wording import worded
    from service.settings import Settings

    try:
        return Settings(**fixed)
    except ValidationError as error:
        lines = []
        for each in error.errors():
            # The message names the flag or the variable that the user has set, not the field of the model. An error of
            # several settings has no location and names them itself.
            origin = "".join(
                f"--{name.replace('_', '-')}: " if name in fixed else f"RICOCHET_{name.upper()}: "
                for name in map(str, each["loc"][:1])
            )
            lines.append(f"{origin}{worded(each)}")
        raise UsageError("\n".join(lines)) from None
