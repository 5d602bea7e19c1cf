"""Models of the searches for the least thickness of a wall and for its limit speed."""

from typing import Annotated, Any, ClassVar, Self

from pydantic import MISSING, Field

import solver
from service.columns import Column
from service.schemas.answers import (
    VERSIONED,
    WARNING,
    EngineVersion,
    Exit,
    Key,
    ModelWarning,
    Protrusion,
)
from service.schemas.fields import GIVEN, NOT_TABLED, walk
from service.schemas.formulas import ROW, FormulaRow
from service.schemas.quantities import Flag, Num, Of, Part, Units, with_examples
from service.schemas.requests import Case
from service.schemas.strike import PAPER, PAPER_AT_45, Approach, Impact
from service.schemas.wall import VARIANTS, Variants
from solver import FormulaResult, Outcome, ParameterError, PerforationStatus
from solver.formulas import limit_speeds
from solver.perforation import RUN_TOLERANCE
from solver.strike import TERMINATION_TIME
from solver.uncertainty import PerforationSpread, limit_speed_spread, thickness_spread
from solver.uncertainty.walls import PROBABILITY, limit_speed_sentence, thickness_sentence
from solver.units import UnitSystem

RANGE = {"lower": 0.1623, "upper": 0.2139, "probability": PROBABILITY}
RANGE_COLUMNS = {
    unit: (
        Column(f"range_low_{unit}", "lower end of the 90 % range"),
        Column(f"range_high_{unit}", "upper end of the 90 % range"),
    )
    for unit in ("m", "m_s")
}
"""Columns of the 90 % range, keyed by the unit of the answer."""
VARIANT_COLUMNS = {
    unit: tuple(
        Column(f"{name}_{unit}", text)
        for name, text in (
            ("plain", "limit without a plug and a crater"),
            ("rear_plug", "limit with a plug that shears out of the rear"),
            ("rear_plug_and_crater", "limit with a plug and a crater"),
        )
    )
    for unit in ("m", "m_s")
}
"""Columns of the variants, keyed by the unit of the answer."""
WALL = PAPER | {
    "target": PAPER["target"] | {"thickness_m": 0.2},
    "impact": {"oblique_angle_deg": 20.0},
}
BEHIND = {
    "speed_m_s": 186.1,
    "direction_deg": 43.63,
    "elevation_deg": 46.37,
    "axis_angle_deg": 44.22,
    "angular_velocity_rad_s": -8.263,
    "kinetic_energy_j": 225000.0,
    "lateral_m": 0.5305,
}
THICKNESS_TRIAL = {"thickness_m": 0.1, "outcome": "perforated", "exit": BEHIND}
STOPPED = {"thickness_m": 0.1959, "outcome": "embedded", "protrusion": {"final_m": 0.0004, "greatest_m": 0.0004}}
SPEED_TRIAL = {
    "velocity_m_s": 243.3,
    "outcome": "perforated",
    "exit": {
        "speed_m_s": 105.0,
        "direction_deg": 19.82,
        "elevation_deg": 70.18,
        "axis_angle_deg": 19.82,
        "angular_velocity_rad_s": -0.0022,
        "kinetic_energy_j": 71720.0,
        "lateral_m": 0.1428,
    },
}
THICKNESS = {
    "status": "converged",
    "least_thickness_m": 0.1864,
    "bracket_m": [0.1864, 0.1864],
    "range": RANGE,
    "variants": VARIANTS,
    "sentence": "Not perforated from 367 mm on by Hughes, the largest of the formulas within their range, without a "
    "margin. This model, which is unconservative: 163 mm to 214 mm (90 % range over S, 187 mm with S as given).",
    "without_protrusion": 0.1961,
    "iterations": [THICKNESS_TRIAL, STOPPED],
    "formulas": [ROW],
    "warnings": [WARNING],
}
SPEED_ROW = {
    "formula": "cea_edf",
    "limit_speed_m_s": 123.0,
    "in_range": False,
    "range_known": True,
    "out_of_range": [{"pointer": "/projectile/nose", "detail": "fitted to flat noses, here sharp"}],
    "verified": False,
    "source": "Berriaud et al. 1978",
}
SPEED = {
    "status": "converged",
    "limit_speed_m_s": 218.7,
    "bracket_m_s": [218.7, 218.7],
    "without_protrusion": 193.5,
    "range": {"lower": 199.4, "upper": 239.9, "probability": PROBABILITY},
    "variants": {"plain": 218.7, "rear_plug": 175.8, "rear_plug_and_crater": 143.9},
    "sentence": "Perforated from 79 m/s on by Hughes, the lowest of the formulas within their range. This model, which "
    "is unconservative: 199 m/s to 239 m/s (90 % range over S, 218 m/s with S as given).",
    "iterations": [SPEED_TRIAL],
    "formulas": [SPEED_ROW],
    "warnings": [WARNING],
}


class LimitOutput(Part):
    """Optional contents of the answer."""

    model_config = with_examples({"range": False})

    range: Flag = True
    """Include the 90 % range over the strength factor, the values with a plug and a crater, and the `sentence`. They
    take five more searches."""


class BatchLimitOutput(LimitOutput):
    """Contents of the answer to one case of a batch or one point of a sweep."""

    range: Flag = False
    """Include the 90 % range over the strength factor, the values with a plug and a crater, and the `sentence`. They
    take five more searches, and are left out by default."""


class PerforationCase(Case):
    """Base class of the requests for a least thickness or a limit speed."""

    output: Annotated[LimitOutput, Field(default_factory=LimitOutput)]

    @property
    def searches(self) -> int:
        """Number of searches needed for the answer."""
        # The range takes two more searches, with S at both ends of its range, and the variants take three.
        return 6 if self.output.range else 1


class ThicknessFields(PerforationCase):
    """Search for the least thickness of a wall that a strike does not perforate, single or in a batch."""

    model_config = with_examples(PAPER_AT_45)

    impact: Impact

    def resolved(self) -> Self:
        """Return the request with all defaults filled in.

        Raises
        ------
        ParameterError
            If the target has a thickness.
        """
        if self.target.thickness_m is not MISSING:
            raise ParameterError("target.thickness", "must be absent: the search determines it")
        end = self.usual_termination_time(self.impact.velocity_m_s)
        return self.adaptive(termination_time_s=end, relative_tolerance=RUN_TOLERANCE)

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `solver.least_thickness`.

        Raises
        ------
        ParameterError
            If values contradict each other.
        """
        case = self.resolved()
        return case.shared_arguments() | {"impact": case.impact.to_solver()}

    def formulas(self) -> list[FormulaResult]:
        """Return the results of the empirical formulas; none for a strike without a velocity along the normal."""
        arguments = self.arguments()
        try:
            rows = solver.formulas(**{name: arguments[name] for name in ("projectile", "target", "impact")})
        except ParameterError:
            return []
        return [row for row in rows if row.perforation_thickness is not None]


class ThicknessRequest(ThicknessFields):
    """Search for the least thickness of a wall that a strike does not perforate. The target must have no thickness."""

    model_config = with_examples(PAPER_AT_45)

    units: Units = UnitSystem.SI


class ThicknessBase(ThicknessFields):
    """Search for the least thickness of a wall, in a batch or a sweep. By default, the answer has no 90 % range."""

    model_config = with_examples(PAPER_AT_45)

    output: Annotated[BatchLimitOutput, Field(default_factory=BatchLimitOutput)]


class LimitSpeedFields(PerforationCase):
    """Search for the least speed at which a projectile perforates a wall, single or in a batch."""

    model_config = with_examples(WALL)

    impact: Approach

    def resolved(self) -> Self:
        """Return the request with defaults filled in.

        With the adaptive method the termination time stays absent, since it depends on the speed of each run.

        Raises
        ------
        ParameterError
            If the target has no thickness.
        """
        if self.target.thickness_m is MISSING:
            raise ParameterError("target.thickness", "must be given: a half-space is not perforated")
        end = {"termination_time_s": TERMINATION_TIME} if self.by_panels else {}
        return self.adaptive(**end, relative_tolerance=RUN_TOLERANCE)

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `solver.limit_velocity`.

        Raises
        ------
        ParameterError
            If values contradict each other.
        """
        case = self.resolved()
        return case.shared_arguments() | case.impact.arguments()

    def formulas(self) -> list[FormulaResult]:
        """Return the limit speeds of the empirical formulas; none for a strike without a velocity along the normal."""
        arguments = self.arguments()
        strike = {name: arguments[name] for name in ("projectile", "target", "oblique_angle")}
        try:
            return list(limit_speeds(**strike, thickness=arguments["target"].thickness))
        except ParameterError:
            return []


class LimitSpeedRequest(LimitSpeedFields):
    """Search for the least speed at which a projectile perforates a wall."""

    model_config = with_examples(WALL)

    units: Units = UnitSystem.SI


class LimitSpeedBase(LimitSpeedFields):
    """Search for the limit speed of a wall, in a batch or a sweep. By default, the answer has no 90 % range."""

    model_config = with_examples(WALL)

    output: Annotated[BatchLimitOutput, Field(default_factory=BatchLimitOutput)]


class LimitRange(Part):
    """Range of a limit over the scatter of the strength factor, in the unit of the answer."""

    model_config = with_examples(RANGE)

    lower: Num
    upper: Num
    probability: Annotated[Num, Field(ge=0.0, le=1.0)]
    """Probability that the limit of this model is within the range. [1]"""


class PerforationTrial(Part):
    """Base class of the results of one run in a search for a least thickness or a limit speed."""

    solved = solver.PerforationTrial
    answered_last: ClassVar = ("outcome", "exit", "protrusion")

    outcome: Outcome
    exit: Exit | MISSING = MISSING
    """State at the exit, if the projectile left the wall."""
    protrusion: Protrusion | MISSING = MISSING
    """Protrusion from the rear face of a wall that is not perforated, if any part comes out."""


class ThicknessTrial(PerforationTrial):
    """One thickness tried in a search."""

    model_config = with_examples(THICKNESS_TRIAL)

    thickness_m: Annotated[Num, Of("value")]
    """Thickness tried. [m]"""


class SpeedTrial(PerforationTrial):
    """One speed tried in a search."""

    model_config = with_examples(SPEED_TRIAL)

    velocity_m_s: Annotated[Num, Of("value")]
    """Speed tried. [m/s]"""


class ThicknessAnswer(Part):
    """Answer to a search for the least thickness that is not perforated."""

    model_config = with_examples(THICKNESS | VERSIONED)

    solved = solver.PerforationLimit

    status: PerforationStatus
    least_thickness_m: Annotated[Num | MISSING, Of("value")] = MISSING
    """Least thickness found that stops the projectile, if there is one between a tenth and a thousand diameters. The
    model includes a rear plug and a crater only if `resistance` has them; without them, a real wall has to be thicker.
    [m]"""
    bracket_m: Annotated[
        Annotated[list[Num], Field(min_length=2, max_length=2)] | MISSING,
        Column("bracket_low_m", "lower of the two thicknesses between which the outcome changes"),
        Column("bracket_high_m", "upper of the two thicknesses between which the outcome changes"),
    ] = MISSING
    """Thicknesses between which the outcome changes. [m]"""
    without_protrusion: Annotated[
        Num | MISSING, Column("without_protrusion_m", "least thickness without a protrusion from the rear")
    ] = MISSING
    """Least thickness found at which no part of the projectile comes out of the rear face. At `least_thickness_m` its
    nose may protrude. [m]"""
    iterations: Annotated[list[ThicknessTrial], Column("trials", "number of thicknesses tried")]
    """All thicknesses tried, in order."""
    range: Annotated[LimitRange | MISSING, GIVEN, *RANGE_COLUMNS["m"]] = MISSING
    """90 % range over the scatter of the strength factor, if requested and if there is a thickness at both ends. [m]"""
    variants: Annotated[Variants | MISSING, GIVEN, *VARIANT_COLUMNS["m"]] = MISSING
    """Least thickness with and without a plug at the rear and a crater at the front, if requested. [m]"""
    sentence: Annotated[str | MISSING, GIVEN, NOT_TABLED] = MISSING
    """Results of the formulas and of the model in words, with the range. For design values see `/wall`."""
    formulas: Annotated[list[FormulaRow], GIVEN]
    """Results of the empirical formulas that predict a perforation thickness, for the same strike."""
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


class LimitSpeedAnswer(Part):
    """Answer to a search for the least speed that perforates a wall."""

    model_config = with_examples(SPEED | VERSIONED)

    solved = solver.PerforationLimit

    status: PerforationStatus
    limit_speed_m_s: Annotated[Num | MISSING, Of("value")] = MISSING
    """Least speed found that perforates, if there is one between 1 and 2000 m/s. The model includes a rear plug
    and a crater only if `resistance` has them; without them, slower projectiles perforate real walls. [m/s]"""
    bracket_m_s: Annotated[
        Annotated[list[Num], Field(min_length=2, max_length=2)] | MISSING,
        Column("bracket_low_m_s", "lower of the two speeds between which the outcome changes"),
        Column("bracket_high_m_s", "upper of the two speeds between which the outcome changes"),
    ] = MISSING
    """Speeds between which the outcome changes. [m/s]"""
    without_protrusion: Annotated[
        Num | MISSING, Column("without_protrusion_m_s", "greatest speed without a protrusion from the rear")
    ] = MISSING
    """Greatest speed found at which no part of the projectile comes out of the rear face. Just below `limit_speed_m_s`
    its nose may protrude. [m/s]"""
    iterations: Annotated[list[SpeedTrial], Column("trials", "number of speeds tried")]
    """All speeds tried, in order."""
    range: Annotated[LimitRange | MISSING, GIVEN, *RANGE_COLUMNS["m_s"]] = MISSING
    """90 % range over the scatter of the strength factor, if requested and if there is a speed at both ends. [m/s]"""
    variants: Annotated[Variants | MISSING, GIVEN, *VARIANT_COLUMNS["m_s"]] = MISSING
    """Limit speed with and without a plug at the rear and a crater at the front, if requested. [m/s]"""
    sentence: Annotated[str | MISSING, GIVEN, NOT_TABLED] = MISSING
    """Results of the formulas and of the model in words, with the range."""
    formulas: Annotated[list[FormulaRow], GIVEN]
    """Limit speeds of the empirical formulas for the same wall and angle."""
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


def thickness_answer(request: ThicknessFields) -> dict[str, Any]:
    """Find the least thickness, and return the answer without its key and version.

    Raises
    ------
    ParameterError
        If values contradict each other.
    IntegrationError
        If a run could not be integrated.
    """
    arguments, rows = request.arguments(), request.formulas()
    found = solver.least_thickness(**arguments)
    given: dict[str, Any] = {}
    if request.output.range:
        spread, law = (
            thickness_spread(**arguments, strength_scatter=request.strength_scatter.value),
            arguments["resistance"],
        )
        given = _spread_answer(spread) | {"sentence": thickness_sentence(found, spread, rows, law)}
    return walk(ThicknessAnswer, found, formulas=rows, **given)


def limit_speed_answer(request: LimitSpeedFields) -> dict[str, Any]:
    """Find the limit speed, and return the answer without its key and version.

    Raises the same errors as `thickness_answer`.
    """
    arguments, rows = request.arguments(), request.formulas()
    found = solver.limit_velocity(**arguments)
    given: dict[str, Any] = {}
    if request.output.range:
        spread = limit_speed_spread(**arguments, strength_scatter=request.strength_scatter.value)
        given = _spread_answer(spread) | {
            "sentence": limit_speed_sentence(found, spread, rows, arguments["resistance"])
        }
    return walk(LimitSpeedAnswer, found, formulas=rows, **given)


def _spread_answer(spread: PerforationSpread) -> dict[str, Any]:
    given: dict[str, Any] = {"variants": spread.variants}
    if spread.range is not None:
        lower, upper = spread.range
        given["range"] = {"lower": lower, "upper": upper, "probability": PROBABILITY}
    return given
