"""Models of the numerical settings of a request: method, resolution and search."""

from enum import StrEnum
from functools import cache
from typing import Annotated

from pydantic import MISSING, Field

import solver
from service.schemas.quantities import WHOLE, Count, Num, SolverPart, degrees, with_examples
from solver.strike import RETENTION_BOUNDS

NUMERICS = solver.Numerics()
SEARCH = solver.Search()

Obliquity = Annotated[Num, Field(ge=0.0, lt=90.0)]


class Method(StrEnum):
    """Method of computing a trajectory.

    `adaptive` uses closed-form arcs and error-controlled time steps; `panels` uses the surface elements and the fixed
    time step of the paper.
    """

    ADAPTIVE = "adaptive"
    PANELS = "panels"


class SearchMethod(StrEnum):
    """Method of a search.

    `outcome` brackets the change of outcome. `bisection` and `secant` are the searches of the paper, which find the
    angle at which the final position of the nose tip is zero.
    """

    OUTCOME = "outcome"
    BISECTION = "bisection"
    SECANT = "secant"


class Numerics(SolverPart[solver.Numerics]):
    """Method and resolution of a run."""

    model_config = with_examples(
        {"relative_tolerance": 1e-5}, {"method": "panels", "panels": 6000, "time_step_s": 2e-5}
    )

    method: Method | MISSING = MISSING
    """Method of computing a trajectory. The default is `adaptive`, except in the searches `bisection` and `secant`,
    where it is `panels`."""
    # The upper bound of the termination time is also its longest default. The reference runs had 96,000 panels, and the
    # time step may be a hundredth to a hundred times the time step of the paper. `max_panel_steps` of the settings
    # bounds the work of a run.
    termination_time_s: Annotated[Num, Field(ge=1e-6, le=1.0)] | MISSING = MISSING
    panels: Annotated[Count, Field(ge=100, le=100_000), WHOLE] = NUMERICS.panels
    time_step_s: Annotated[Num, Field(ge=1e-7, le=1e-3)] = NUMERICS.time_step
    relative_tolerance: Annotated[Num, Field(ge=1e-10, le=1e-2)] | MISSING = MISSING
    retention_energy_fraction: Annotated[Num, Field(ge=RETENTION_BOUNDS[0], le=RETENTION_BOUNDS[1])] = (
        NUMERICS.retention_energy_fraction
    )


@cache
def usual_range(method: SearchMethod) -> tuple[float, float]:
    """Return the default range of a search. [°]"""
    lower, upper = solver.Search(method=method.value).bounds
    return degrees(lower), degrees(upper)


class Search(SolverPart[solver.Search]):
    """Method, range and tolerance of a search for the critical angle."""

    model_config = with_examples({"method": "outcome", "lower_deg": 20.0, "upper_deg": 80.0}, {"method": "secant"})

    method: SearchMethod = SearchMethod(SEARCH.method)
    lower_deg: Obliquity | MISSING = MISSING
    upper_deg: Obliquity | MISSING = MISSING
    # The bounds of both tolerances are the same as in the solver.
    tolerance_deg: Annotated[Num, Field(ge=1e-6, le=10.0)] = degrees(SEARCH.tolerance)
    relative_tolerance: Annotated[Num, Field(ge=1e-8, le=0.5)] = SEARCH.relative_tolerance
