"""The requests: one trajectory, one critical angle, the same under other laws, and the report of one strike."""

import math
from abc import abstractmethod
from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, Self, TypeVar, cast

import orjson
from pydantic import MISSING, Field

import solver
from service.schemas.fields import walk
from service.schemas.flight import FlightInput
from service.schemas.numerics import Method, Numerics, Search, SearchMethod, usual_range
from service.schemas.quantities import Flag, Num, Part, with_examples
from service.schemas.resistance import STRENGTH_FACTORS, Resistance
from service.schemas.strike import (
    HEMISPHERE,
    PAPER,
    PAPER_AT_45,
    PAPER_BY_SECANT,
    STRIKE,
    TRUNCATED_CONE,
    Impact,
    ObliqueAngle,
    Projectile,
    Strike,
    Target,
)
from solver import alternative_resistances
from solver.checks import ParameterError
from solver.search.critical_angle import PAPER_TERMINATION_TIME
from solver.strike import SEARCH_TOLERANCE, TRAJECTORY_TOLERANCE, usual_termination_time
from solver.sweeps import fitted_to, obliquity_shape
from solver.trajectory import SAMPLE_INTERVAL
from solver.uncertainty.usual import has_own_law

MOST_ROWS = 20_000
"""Rows of a history: some 4 MB of JSON, far finer than any plot shows."""

SampleInterval = Annotated[
    Num,
    Field(
        ge=1e-8,
        le=1.0,
        description=f"Interval of the history; at least the termination time over {MOST_ROWS:,}, which is its value "
        f"when not given and longer than {SAMPLE_INTERVAL:g}. [s]",
    ),
]


NO_PART_OF_THE_CASE = {"alternatives", "custom_id"}
"""Fields without effect on the result."""


class StrengthScatter(StrEnum):
    """Tests from which the scatter of the strength factor comes."""

    LAW = "law"
    PAPER_TABLE_1 = "paper_table_1"


Alternatives = Annotated[
    Flag,
    Field(
        description="Whether to add the answers under other laws: each decay near the face with each strength factor. "
        "Each is a case like any other, and is kept under a separate key."
    ),
]


class TrajectoryOutput(Part):
    """What the answer to a trajectory holds."""

    model_config = with_examples({"history": False}, {"sample_interval_s": 1e-4})

    history: Flag = True
    """Whether to give the motion over time."""
    sample_interval_s: SampleInterval | MISSING = MISSING


class CriticalAngleOutput(Part):
    """What the answer to a critical angle holds."""

    model_config = with_examples({"history": True, "sample_interval_s": 1e-4})

    history: Flag = False
    """Whether to give the trajectory at the critical angle."""
    sample_interval_s: SampleInterval | MISSING = MISSING


PartOfRequest = TypeVar("PartOfRequest", bound=Part)


def filled(part: PartOfRequest, **usual: Any) -> PartOfRequest:
    """Return a part of a request with usual values in the fields that were left open."""
    return part.model_copy(update={name: value for name, value in usual.items() if getattr(part, name) is MISSING})


class Case(Part):
    """What requests for one strike have in common, and those for many."""

    projectile: Projectile
    target: Target
    resistance: Annotated[Resistance, Field(default_factory=Resistance)]
    numerics: Annotated[Numerics, Field(default_factory=Numerics)]
    strength_scatter: StrengthScatter = StrengthScatter.LAW
    """Tests from which the scatter of S comes: the published ones behind the `law`, or own tests in the resistance;
    `paper_table_1` takes S to be known as well as after the paper's four shots, in whatever strike."""

    def shared_arguments(self) -> dict[str, Any]:
        """Return the arguments that all functions of the solver take."""
        return {
            "projectile": self.projectile.to_solver(),
            "target": self.target.to_solver(),
            "resistance": self.resistance.to_solver(),
            "numerics": self.numerics.to_solver(),
        }

    @abstractmethod
    def resolved(self) -> Self:
        """Return the same with what was left open filled in."""

    def adaptive(self, **numerics: float) -> Self:
        """Return the same with these numerics where they were left open, and adaptive steps."""
        return self.model_copy(update={"numerics": filled(self.numerics, method=Method.ADAPTIVE, **numerics)})

    def canonical(self) -> dict[str, Any]:
        """Return the resolved request as JSON data, the same for one case however it is sent."""
        return self.resolved().model_dump(mode="json", exclude=NO_PART_OF_THE_CASE)

    @property
    def by_panels(self) -> bool:
        """Whether it is computed by the paper's elements and fixed step."""
        return self.numerics.method is Method.PANELS

    def usual_termination_time(self, velocity_m_s: float) -> float:
        """Return the termination time of a run that is given none. [s]"""
        return usual_termination_time(
            length=self.projectile.length_m, velocity=velocity_m_s, method="panels" if self.by_panels else "adaptive"
        )

    @property
    def searches(self) -> int:
        """How many times an answer takes what the weight of its operation stands for."""
        return 1

    def panel_steps(self) -> float:
        """Return panels times time steps of one run at most, 0 if it has none. [1]"""
        if not self.by_panels:
            return 0.0
        numerics = self.resolved().numerics
        end = numerics.termination_time_s
        return 0.0 if end is MISSING else numerics.panels * end / numerics.time_step_s

    def sample_interval(self, output: TrajectoryOutput | CriticalAngleOutput) -> float | None:
        """Return the interval of the history, None if there is to be none."""
        if not output.history:
            return None
        end, interval = self.numerics.termination_time_s, output.sample_interval_s
        if interval is MISSING:
            return SAMPLE_INTERVAL if end is MISSING else max(SAMPLE_INTERVAL, end / MOST_ROWS)
        if end is not MISSING and end > MOST_ROWS * interval:
            raise ParameterError(
                "output.sample_interval",
                f"must be at least the termination time over {MOST_ROWS}, {end / MOST_ROWS:g} s, got {interval:g} s",
            )
        return interval


class TrajectoryFields(Case):
    """One strike, alone or among many."""

    impact: Impact
    output: Annotated[TrajectoryOutput, Field(default_factory=TrajectoryOutput)]
    flight: FlightInput | MISSING = MISSING
    """How the face stands: then an exit says where the body lands."""

    def resolved(self) -> Self:
        """Return the same with what was left open filled in."""
        end = self.usual_termination_time(self.impact.velocity_m_s)
        return self.adaptive(termination_time_s=end, relative_tolerance=TRAJECTORY_TOLERANCE)

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `solver.simulate`.

        Raises
        ------
        ParameterError
            If values do not go together.
        """
        case = self.resolved()
        arguments = case.shared_arguments()
        impact = case.impact.to_solver()
        solver.strength_factor(
            resistance=arguments["resistance"],
            oblique_angle=impact.oblique_angle,
            target=arguments["target"],
            projectile=arguments["projectile"],
        )
        return arguments | {
            "impact": impact,
            "sample_interval": case.sample_interval(case.output),
            "strength_scatter": case.strength_scatter.value,
        }


class TrajectoryRequest(TrajectoryFields):
    """One strike."""

    model_config = with_examples(PAPER_AT_45, TRUNCATED_CONE)

    alternatives: Alternatives = False


class CriticalAngleBase(Case):
    """Strikes that differ in their oblique angle alone, among many such requests."""

    model_config = with_examples(PAPER, PAPER_BY_SECANT, HEMISPHERE)

    impact: Strike
    search: Annotated[Search, Field(default_factory=Search)]
    output: Annotated[CriticalAngleOutput, Field(default_factory=CriticalAngleOutput)]

    @property
    def by_paper(self) -> bool:
        """Whether the search is one of the paper's, which look at the final position."""
        return self.search.method is not SearchMethod.OUTCOME

    @property
    def by_panels(self) -> bool:
        """Whether it is computed by the paper's elements and fixed step."""
        return super().by_panels or (self.numerics.method is MISSING and self.by_paper)

    def resolved(self) -> Self:
        """Return the same with what was left open filled in."""
        numerics = filled(
            self.numerics,
            method=Method.PANELS if self.by_paper else Method.ADAPTIVE,
            termination_time_s=(
                PAPER_TERMINATION_TIME if self.by_paper else self.usual_termination_time(self.impact.velocity_m_s)
            ),
            relative_tolerance=SEARCH_TOLERANCE,
        )
        lower, upper = usual_range(self.search.method)
        search = filled(self.search, lower_deg=lower, upper_deg=upper)
        return self.model_copy(update={"numerics": numerics, "search": search})

    def arguments(self) -> tuple[dict[str, Any], float | None]:
        """Return the arguments of `solver.critical_angle`, and the interval of a history if there is to be one.

        Raises
        ------
        ParameterError
            If values do not go together.
        """
        case = self.resolved()
        arguments = case.shared_arguments() | case.impact.arguments()
        arguments |= {"search": case.search.to_solver(), "strength_scatter": case.strength_scatter.value}
        return arguments, case.sample_interval(case.output)


class CriticalAngleRequest(CriticalAngleBase):
    """Strikes that differ in their oblique angle alone."""

    model_config = with_examples(PAPER, PAPER_BY_SECANT, HEMISPHERE)

    alternatives: Alternatives = False


Request = TypeVar("Request", bound=TrajectoryRequest | CriticalAngleRequest)

FOUND = ("status", "outcome", "critical_angle_deg")
"""Fields of an answer that stand in the list of alternatives."""


def alternatives_in(request: Any) -> list[tuple[dict[str, Any], Any]]:
    """Return the alternatives that a request of any operation has, as `alternative_requests`."""
    return alternative_requests(request) if getattr(request, "alternatives", False) else []


def alternative_requests(request: Request) -> list[tuple[dict[str, Any], Request]]:
    """Return the laws and the request of each alternative: the same case, with its inertia, under other laws."""
    found = []
    for each in alternative_resistances(request.resistance.to_solver()):
        laws = {"free_surface": each.free_surface.name, "strength_factor": each.strength_factor.name}
        decay = {"model": each.free_surface.name, "inertia": getattr(each.free_surface, "inertia", False)}
        strength = walk(
            STRENGTH_FACTORS[each.strength_factor.name], each.strength_factor, model=laws["strength_factor"]
        )
        law = Resistance.model_validate({"strength_factor": strength, "free_surface": decay})
        resistance = request.resistance.model_copy(
            update={"strength_factor": law.strength_factor, "free_surface": law.free_surface}
        )
        other = cast("Request", request.model_copy(update={"resistance": resistance, "alternatives": False}))
        found.append((laws | {"obliquity_shape": obliquity_shape(each), "fitted_to": fitted_to(each)}, other))
    return found


def answered_alternative(laws: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return an alternative with what its answer says."""
    return {**laws, **{name: answer[name] for name in FOUND if name in answer}}


def with_alternatives(answer: bytes, alternatives: list[dict[str, Any]]) -> bytes:
    """Return the JSON of an answer with its alternatives behind the other fields."""
    return b'%b,"alternatives":%b}' % (answer[:-1], orjson.dumps(alternatives))


class ReportedStrike(Strike):
    """The motion at first contact, with the oblique angle if one is to be judged."""

    model_config = with_examples(STRIKE, STRIKE | {"oblique_angle_deg": 45.0})

    oblique_angle_deg: ObliqueAngle | MISSING = MISSING
    """Angle to judge: its run and outcome are in the report. [°]"""


class ReportRequest(CriticalAngleRequest):
    """One strike as in a search for its critical angle; `output` and `alternatives` are without effect."""

    model_config = with_examples(PAPER, PAPER_AT_45)

    impact: ReportedStrike
    flight: FlightInput | MISSING = MISSING
    """How the face stands, for where a body lands that is turned away at the angle to judge; level with the ground
    unless given."""

    @property
    def oblique_angle(self) -> float | None:
        """Angle to judge, if any. [rad]"""
        angle = self.impact.oblique_angle_deg
        return None if angle is MISSING else math.radians(angle)

    @property
    def has_own_law(self) -> bool:
        """Whether the verdict is on a law of one's own, beside the theories."""
        return has_own_law(self.resistance.to_solver())

    def check(self) -> None:
        """Refuse routes that take seconds a case: a report is made of some hundreds.

        Raises
        ------
        ParameterError
            If the search or the numerics are the paper's.
        """
        if self.by_paper:
            raise ParameterError("search.method", "must be `outcome` in a report, which takes hundreds of searches")
        if self.numerics.method is Method.PANELS:
            raise ParameterError("numerics.method", "must be `adaptive` in a report, which takes hundreds of searches")
