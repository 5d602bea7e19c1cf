"""Least thickness of a wall and limit speed: requests and answers as the contract has them."""

from typing import Annotated, Any, ClassVar, Self

from pydantic import MISSING, Field

import solver
from service.columns import Column
from service.schemas.answers import (
    EXIT,
    PROTRUSION,
    VERSIONED,
    WARNING,
    EngineVersion,
    Exit,
    Key,
    ModelWarning,
    Protrusion,
)
from service.schemas.fields import GIVEN, Described, Of, walk
from service.schemas.formulas import ROW, FormulaRow, FormulasRequest, formulas_answer
from service.schemas.quantities import Num, Part, with_examples
from service.schemas.requests import Case
from service.schemas.strike import PAPER, PAPER_AT_45, Approach, Impact
from solver import Outcome, ParameterError, PerforationStatus
from solver.perforation import RUN_TOLERANCE
from solver.strike import TERMINATION_TIME

WALL = PAPER | {
    "target": PAPER["target"] | {"thickness_m": 0.2},
    "impact": {"oblique_angle_deg": 20.0},
}
LEFT = {"outcome": "perforated", "exit": EXIT}
THICKNESS_TRIAL = {"thickness_m": 0.18} | LEFT
STOPPED = {"thickness_m": 0.27, "outcome": "embedded", "protrusion": PROTRUSION}
SPEED_TRIAL = {"velocity_m_s": 224.0} | LEFT
THICKNESS = {
    "status": "converged",
    "least_thickness_m": 0.2402,
    "bracket_m": [0.2402, 0.2402],
    "without_protrusion": 0.3153,
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
    "without_protrusion": 180.0,
    "iterations": [SPEED_TRIAL],
    "formulas": [SPEED_ROW],
    "warnings": [WARNING],
}


class ThicknessRequest(Case):
    """A strike on a wall whose thickness is sought; its target has none."""

    model_config = with_examples(PAPER_AT_45)

    impact: Impact

    def resolved(self) -> Self:
        """Return the same with what was left open filled in.

        Raises
        ------
        ParameterError
            If the target has a thickness.
        """
        if self.target.thickness_m is not MISSING:
            raise ParameterError("target.thickness", "must not be given: it is what is sought")
        end = self.usual_termination_time(self.impact.velocity_m_s)
        return self.adaptive(termination_time_s=end, relative_tolerance=RUN_TOLERANCE)

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `solver.least_thickness`.

        Raises
        ------
        ParameterError
            If values do not go together.
        """
        case = self.resolved()
        return case.shared_arguments() | {"impact": case.impact.to_solver()}

    def formulas(self) -> list[dict[str, Any]]:
        """Return what the empirical formulas say of the same strike; nothing without a velocity along the normal."""
        parts = self.model_dump(mode="json", include={"projectile", "target", "impact"})
        try:
            rows: list[dict[str, Any]] = formulas_answer(FormulasRequest.model_validate(parts))["formulas"]
        except ParameterError:
            return []
        return [row for row in rows if "perforation_thickness_m" in row]


class LimitSpeedRequest(Case):
    """A wall, and a projectile whose least speed that perforates is sought."""

    model_config = with_examples(WALL)

    impact: Approach

    def resolved(self) -> Self:
        """Return the same with what was left open filled in, but for the end of a run, which depends on its speed.

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
            If values do not go together.
        """
        case = self.resolved()
        return case.shared_arguments() | case.impact.arguments()

    def formulas(self) -> list[dict[str, Any]]:
        """Return the limit speeds of the empirical formulas; nothing for a strike along the face."""
        arguments = self.arguments()
        strike = {name: arguments[name] for name in ("projectile", "target", "oblique_angle")}
        try:
            found = solver.cea_edf_limit_speed(**strike, thickness=arguments["target"].thickness)
        except ParameterError:
            return []
        return [walk(FormulaRow, found)]


class PerforationTrial(Part):
    """How one run of a search for perforation ended."""

    answered_last: ClassVar = ("outcome", "exit", "protrusion")

    outcome: Annotated[Outcome, Described("how the trial ended")]
    exit: Exit | MISSING = MISSING
    """If the projectile left."""
    protrusion: Protrusion | MISSING = MISSING
    """If anything of the projectile comes out of the rear face, and it does not perforate."""


class ThicknessTrial(PerforationTrial):
    """One thickness tried."""

    model_config = with_examples(THICKNESS_TRIAL)

    thickness_m: Annotated[Num, Of("value"), Described("thickness tried")]
    """[m]"""


class SpeedTrial(PerforationTrial):
    """One speed tried."""

    model_config = with_examples(SPEED_TRIAL)

    velocity_m_s: Annotated[Num, Of("value"), Described("speed tried")]
    """[m/s]"""


class ThicknessAnswer(Part):
    """Answer to a search for the least thickness that is not perforated."""

    model_config = with_examples(THICKNESS | VERSIONED)

    status: Annotated[PerforationStatus, Described("how the search ended")]
    least_thickness_m: Annotated[
        Num | MISSING, Of("value"), Described("least thickness of a wall that is not perforated")
    ] = MISSING
    """Least thickness seen to stop the projectile, if there is one from a tenth to a thousand diameters. Unless
    `resistance` has a `rear_plug` and a `crater`, the wall has neither, and a real one has to be thicker. [m]"""
    bracket_m: Annotated[
        Annotated[list[Num], Field(min_length=2, max_length=2)] | MISSING,
        Column("bracket_low_m", "lower of the thicknesses between which the outcome changes"),
        Column("bracket_high_m", "upper of these"),
    ] = MISSING
    """Thicknesses between which the outcome changes. [m]"""
    without_protrusion: Annotated[
        Num | MISSING, Column("without_protrusion_m", "least thickness of a wall out of which nothing comes")
    ] = MISSING
    """Least thickness with which nothing of the projectile was seen to come out of the rear face: where a wall is as
    thick as `least_thickness_m`, its nose may stand out. [m]"""
    iterations: Annotated[list[ThicknessTrial], Column("trials", "number of thicknesses tried")]
    """Every thickness tried, in order."""
    formulas: Annotated[list[FormulaRow], GIVEN]
    """Empirical formulas with a perforation thickness for the same strike."""
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


class LimitSpeedAnswer(Part):
    """Answer to a search for the least speed that perforates a wall."""

    model_config = with_examples(SPEED | VERSIONED)

    status: Annotated[PerforationStatus, Described("how the search ended")]
    limit_speed_m_s: Annotated[Num | MISSING, Of("value"), Described("least speed that perforates")] = MISSING
    """Least speed seen to perforate, if there is one from 1 to 2,000 m/s. Unless `resistance` has a `rear_plug` and a
    `crater`, the wall has neither, and slower projectiles perforate real ones. [m/s]"""
    bracket_m_s: Annotated[
        Annotated[list[Num], Field(min_length=2, max_length=2)] | MISSING,
        Column("bracket_low_m_s", "lower of the speeds between which the outcome changes"),
        Column("bracket_high_m_s", "upper of these"),
    ] = MISSING
    """Speeds between which the outcome changes. [m/s]"""
    without_protrusion: Annotated[
        Num | MISSING, Column("without_protrusion_m_s", "greatest speed at which nothing comes out of the wall")
    ] = MISSING
    """Greatest speed at which nothing of the projectile was seen to come out of the rear face: just below
    `limit_speed_m_s` its nose may stand out. [m/s]"""
    iterations: Annotated[list[SpeedTrial], Column("trials", "number of speeds tried")]
    """Every speed tried, in order."""
    formulas: Annotated[list[FormulaRow], GIVEN]
    """Empirical formulas with a limit speed for the same wall and angle."""
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion
