"""Models of requests for trajectories, critical angles and reports, and their variants with alternative laws."""

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
from service.schemas.quantities import Flag, Num, Part, Units, with_examples
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
from solver.units import Amount, UnitSystem, whole_number, written_in

MOST_ROWS = 20_000
"""Largest number of rows of a history: some 4 MB of JSON, and far more than a plot can show."""

SampleInterval = Annotated[
    Num,
    Field(
        ge=1e-8,
        le=1.0,
        description="Interval of the history, at least the termination time divided by "
        f"{whole_number(MOST_ROWS)}. The default is "
        f"{SAMPLE_INTERVAL:g} s or, if that is too short, this minimum. [s]",
    ),
]


NO_PART_OF_THE_CASE = {"alternatives", "custom_id"}
"""Fields without effect on the result, which are left out of its key."""


class StrengthScatter(StrEnum):
    """Source of the scatter of the strength factor."""

    LAW = "law"
    PAPER_TABLE_1 = "paper_table_1"


Alternatives = Annotated[
    Flag,
    Field(
        description="Include results with other laws: each decay law with each strength law. Each result is computed "
        "and stored as a separate case."
    ),
]


class TrajectoryOutput(Part):
    """Optional contents of the answer."""

    model_config = with_examples({"history": False}, {"sample_interval_s": 1e-4})

    history: Flag = True
    """Include the motion over time."""
    sample_interval_s: SampleInterval | MISSING = MISSING


class CriticalAngleOutput(Part):
    """Optional contents of the answer."""

    model_config = with_examples({"history": True, "sample_interval_s": 1e-4})

    history: Flag = False
    """Include the trajectory at the critical angle."""
    sample_interval_s: SampleInterval | MISSING = MISSING


PartOfRequest = TypeVar("PartOfRequest", bound=Part)


def filled(part: PartOfRequest, **usual: Any) -> PartOfRequest:
    """Return a part of a request with these values for the fields that it lacks."""
    return part.model_copy(update={name: value for name, value in usual.items() if getattr(part, name) is MISSING})


class Case(Part):
    """Base class of the requests for one case, single or in a batch."""

    projectile: Projectile
    target: Target
    resistance: Annotated[Resistance, Field(default_factory=Resistance)]
    numerics: Annotated[Numerics, Field(default_factory=Numerics)]
    strength_scatter: StrengthScatter = StrengthScatter.LAW
    """Source of the scatter of S: with `law`, the user's own tests in the resistance or, without any, the published
    tests; with `paper_table_1`, the four shots of the paper, as if fired into this concrete."""

    def shared_arguments(self) -> dict[str, Any]:
        """Return the arguments that the runs, searches and studies of the solver have in common."""
        return {
            "projectile": self.projectile.to_solver(),
            "target": self.target.to_solver(),
            "resistance": self.resistance.to_solver(),
            "numerics": self.numerics.to_solver(),
        }

    @abstractmethod
    def resolved(self) -> Self:
        """Return the request with all defaults filled in."""

    def check_fields(self) -> None:
        """Check that the fields that the request names exist. A sweep checks them once, for its base.

        Raises
        ------
        ParameterError
            If a field does not exist.
        """

    def adaptive(self, **numerics: float) -> Self:
        """Return the request with these defaults for its numerics, and the adaptive method if it names no method."""
        return self.model_copy(update={"numerics": filled(self.numerics, method=Method.ADAPTIVE, **numerics)})

    def canonical(self) -> dict[str, Any]:
        """Return the resolved request as JSON data, the same for all requests that describe the same case."""
        return self.resolved().model_dump(mode="json", exclude=NO_PART_OF_THE_CASE)

    @property
    def by_panels(self) -> bool:
        """True if the paper's surface elements and fixed step are used."""
        return self.numerics.method is Method.PANELS

    def usual_termination_time(self, velocity_m_s: float) -> float:
        """Return the default termination time of a run. [s]"""
        return usual_termination_time(
            length=self.projectile.length_m, velocity=velocity_m_s, method="panels" if self.by_panels else "adaptive"
        )

    @property
    def searches(self) -> int:
        """Cost of the answer, in multiples of the weight of its operation."""
        return 1

    def panel_steps(self) -> float:
        """Return the panels times the time steps of the longest run; 0 with the adaptive method. [1]"""
        if not self.by_panels:
            return 0.0
        numerics = self.resolved().numerics
        end = numerics.termination_time_s
        return 0.0 if end is MISSING else numerics.panels * end / numerics.time_step_s

    def sample_interval(self, output: TrajectoryOutput | CriticalAngleOutput) -> float | None:
        """Return the interval of the history, or None if no history is requested. [s]"""
        if not output.history:
            return None
        end, interval = self.numerics.termination_time_s, output.sample_interval_s
        if interval is MISSING:
            # The default is widened for a long run; otherwise the request would be refused because of an interval that
            # it does not contain.
            return SAMPLE_INTERVAL if end is MISSING else max(SAMPLE_INTERVAL, end / MOST_ROWS)
        # An interval that the client gave is refused rather than changed, because the key of the result depends on it.
        if end is not MISSING and end > MOST_ROWS * interval:
            raise ParameterError(
                "output.sample_interval",
                f"must be at least the termination time over {whole_number(MOST_ROWS)}, {{}}, got {{}}",
                Amount(end / MOST_ROWS, "ms"),
                Amount(interval, "ms"),
            )
        return interval


class TrajectoryFields(Case):
    """Request to simulate one strike, single or in a batch."""

    impact: Impact
    output: Annotated[TrajectoryOutput, Field(default_factory=TrajectoryOutput)]
    flight: FlightInput | MISSING = MISSING
    """Conditions of the flight. If they are given, the flight after an exit is computed."""

    def resolved(self) -> Self:
        """Return the request with all defaults filled in."""
        end = self.usual_termination_time(self.impact.velocity_m_s)
        return self.adaptive(termination_time_s=end, relative_tolerance=TRAJECTORY_TOLERANCE)

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `solver.simulate`.

        Raises
        ------
        ParameterError
            If values contradict each other.
        """
        case = self.resolved()
        arguments = case.shared_arguments()
        impact = case.impact.to_solver()
        # S is evaluated so that the check of a batch, which computes nothing, also refuses a polynomial that is not
        # positive at this angle.
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
    """Request to simulate one strike."""

    model_config = with_examples(PAPER_AT_45, TRUNCATED_CONE)

    alternatives: Alternatives = False
    units: Units = UnitSystem.SI


class CriticalAngleBase(Case):
    """Search for the critical angle of a strike, single or in a batch."""

    model_config = with_examples(PAPER, PAPER_BY_SECANT, HEMISPHERE)

    impact: Strike
    search: Annotated[Search, Field(default_factory=Search)]
    output: Annotated[CriticalAngleOutput, Field(default_factory=CriticalAngleOutput)]

    @property
    def by_paper(self) -> bool:
        """True if the search is the paper's bisection or secant search, which use the final position."""
        return self.search.method is not SearchMethod.OUTCOME

    @property
    def by_panels(self) -> bool:
        """True if the paper's surface elements and fixed step are used."""
        return super().by_panels or (self.numerics.method is MISSING and self.by_paper)

    def resolved(self) -> Self:
        """Return the request with all defaults filled in."""
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
        """Return the arguments of `solver.critical_angle`, and the interval of a history if one is requested. [s]

        Raises
        ------
        ParameterError
            If values contradict each other.
        """
        case = self.resolved()
        arguments = case.shared_arguments() | case.impact.arguments()
        arguments |= {"search": case.search.to_solver(), "strength_scatter": case.strength_scatter.value}
        return arguments, case.sample_interval(case.output)


class CriticalAngleRequest(CriticalAngleBase):
    """Search for the critical angle of a strike."""

    model_config = with_examples(PAPER, PAPER_BY_SECANT, HEMISPHERE)

    alternatives: Alternatives = False
    units: Units = UnitSystem.SI


Request = TypeVar("Request", bound=TrajectoryRequest | CriticalAngleRequest)

FOUND = ("status", "outcome", "critical_angle_deg")
"""Fields of an answer that are copied to an alternative."""


def alternatives_in(request: Any) -> list[tuple[dict[str, Any], Any]]:
    """Return the alternatives of a request of any operation; see `alternative_requests`."""
    return alternative_requests(request) if getattr(request, "alternatives", False) else []


def alternative_requests(request: Request) -> list[tuple[dict[str, Any], Request]]:
    """Return the laws and the request of each alternative: the same case, including its `inertia`, with these laws."""
    found = []
    for each in alternative_resistances(request.resistance.to_solver()):
        laws = {"free_surface": each.free_surface.name, "strength_factor": each.strength_factor.name}
        # The case, not the law, determines whether the inertia of the expanding solid counts.
        decay = {"model": each.free_surface.name, "inertia": getattr(each.free_surface, "inertia", False)}
        strength = walk(
            STRENGTH_FACTORS[each.strength_factor.name], each.strength_factor, model=laws["strength_factor"]
        )
        law = Resistance.model_validate({"strength_factor": strength, "free_surface": decay})
        resistance = request.resistance.model_copy(
            update={"strength_factor": law.strength_factor, "free_surface": law.free_surface}
        )
        # The answer shows no text of an alternative's result, so the units of the request need not be part of its key.
        changes = {"resistance": resistance, "alternatives": False, "units": UnitSystem.SI}
        other = cast("Request", request.model_copy(update=changes))
        with written_in(request.units):
            evidence = fitted_to(each)
        found.append((laws | {"obliquity_shape": obliquity_shape(each), "fitted_to": evidence}, other))
    return found


def answered_alternative(laws: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entry of an alternative in the answer: its laws and its result."""
    return {**laws, **{name: answer[name] for name in FOUND if name in answer}}


def with_alternatives(answer: bytes, alternatives: list[dict[str, Any]]) -> bytes:
    """Append alternatives to the JSON of an answer, without parsing it."""
    # The last byte of the answer is its closing brace, which is replaced.
    return b'%b,"alternatives":%b}' % (answer[:-1], orjson.dumps(alternatives))


class ReportedStrike(Strike):
    """Motion at first contact, with an optional oblique angle."""

    model_config = with_examples(STRIKE, STRIKE | {"oblique_angle_deg": 45.0})

    oblique_angle_deg: ObliqueAngle | MISSING = MISSING
    """Oblique angle at which the outcome is judged; the report also shows the run. [°]"""


class ReportRequest(CriticalAngleRequest):
    """One strike, in the form of a search for its critical angle. `output` and `alternatives` have no effect."""

    model_config = with_examples(PAPER, PAPER_AT_45)

    impact: ReportedStrike
    flight: FlightInput | MISSING = MISSING
    """Conditions of the flight of a body that ricochets at the oblique angle. By default the face is level."""

    @property
    def oblique_angle(self) -> float | None:
        """Oblique angle at which the outcome is judged; None if the request has none. [rad]"""
        angle = self.impact.oblique_angle_deg
        return None if angle is MISSING else math.radians(angle)

    @property
    def has_own_law(self) -> bool:
        """True if the request has its own law of S or of the decay, which is evaluated in addition to the theories."""
        return has_own_law(self.resistance.to_solver())

    def check(self) -> None:
        """Refuse methods that take seconds per case, because a report takes hundreds of cases.

        Raises
        ------
        ParameterError
            If the search or the numerics use a method of the paper.
        """
        if self.by_paper:
            raise ParameterError("search.method", "must be `outcome` in a report, which takes hundreds of searches")
        if self.numerics.method is Method.PANELS:
            raise ParameterError("numerics.method", "must be `adaptive` in a report, which takes hundreds of searches")
