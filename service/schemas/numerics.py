"""How a request is computed, as the contract has it."""

from enum import StrEnum
from functools import cache
from typing import Annotated

from pydantic import MISSING, Field

import solver
from service.schemas.quantities import WHOLE, Count, Num, SolverPart, degrees, with_examples
from solver.search.critical_angle import PAPER_TERMINATION_TIME
from solver.strike import RETENTION_BOUNDS, SEARCH_TOLERANCE, TERMINATION_TIME, TRAJECTORY_TOLERANCE, TRANSITS

NUMERICS = solver.Numerics()
SEARCH = solver.Search()

Obliquity = Annotated[Num, Field(ge=0.0, lt=90.0)]


class Method(StrEnum):
    """`adaptive`: closed-form arcs and error-controlled steps; `panels`: the paper's elements and fixed step."""

    ADAPTIVE = "adaptive"
    PANELS = "panels"


class SearchMethod(StrEnum):
    """`outcome` brackets the change of outcome; `bisection` and `secant` are the paper's, on the final position."""

    OUTCOME = "outcome"
    BISECTION = "bisection"
    SECANT = "secant"


class Numerics(SolverPart[solver.Numerics]):
    """Route and resolution of a run."""

    model_config = with_examples(
        {"relative_tolerance": 1e-5}, {"method": "panels", "panels": 6000, "time_step_s": 2e-5}
    )

    method: Method | MISSING = MISSING
    """`adaptive` when not given, `panels` in the searches `bisection` and `secant`."""
    termination_time_s: (
        Annotated[
            Num,
            Field(
                ge=1e-6,
                le=1.0,
                description=f"When a run is given up undecided. When not given, {TERMINATION_TIME:g} or, if that is "
                f"longer, the time to travel {TRANSITS:g} lengths of the projectile, at most 1; {TERMINATION_TIME:g} "
                f"for `panels`, {PAPER_TERMINATION_TIME:g} in the searches `bisection` and `secant`. [s] A strike "
                "takes milliseconds.",
            ),
        ]
        | MISSING
    ) = MISSING
    panels: Annotated[Count, Field(ge=100, le=100_000), WHOLE] = NUMERICS.panels
    """Surface elements of `panels`. [1] The reference runs used 96,000."""
    time_step_s: Annotated[Num, Field(ge=1e-7, le=1e-3)] = NUMERICS.time_step
    """Step of `panels`. [s] A hundredth to a hundred of the paper's."""
    relative_tolerance: (
        Annotated[
            Num,
            Field(
                ge=1e-10,
                le=1e-2,
                description="Error of one step of `adaptive`, over the scale of the motion; "
                f"{TRAJECTORY_TOLERANCE:g} for a trajectory and {SEARCH_TOLERANCE:g} in a search when not given. [1]",
            ),
        ]
        | MISSING
    ) = MISSING

    retention_energy_fraction: Annotated[Num, Field(ge=RETENTION_BOUNDS[0], le=RETENTION_BOUNDS[1])] = (
        NUMERICS.retention_energy_fraction
    )
    """Share of the initial kinetic energy with which a projectile must leave to count as turned away; below it, it is
    embedded. Not used by the searches `bisection` and `secant`. [1]"""


@cache
def usual_range(method: SearchMethod) -> tuple[float, float]:
    """Return the range of a search that is given none. [°]"""
    lower, upper = solver.Search(method=method.value).bounds
    return degrees(lower), degrees(upper)


class Search(SolverPart[solver.Search]):
    """How the critical angle is sought."""

    model_config = with_examples({"method": "outcome", "lower_deg": 20.0, "upper_deg": 80.0}, {"method": "secant"})

    method: SearchMethod = SearchMethod(SEARCH.method)
    lower_deg: Obliquity | MISSING = MISSING
    """Lower end of the range; 5 when not given, 40 in the paper's searches. [°]"""
    upper_deg: Obliquity | MISSING = MISSING
    """Upper end of the range; 85 when not given, 60 in the paper's searches. [°]"""
    tolerance_deg: Annotated[Num, Field(ge=1e-6, le=10.0)] = degrees(SEARCH.tolerance)
    """Width of the final bracket of `outcome`. [°]"""
    relative_tolerance: Annotated[Num, Field(ge=1e-8, le=0.5)] = SEARCH.relative_tolerance
    """The paper's searches end when two angles in a row differ by less than this fraction. [1]"""
