"""Numerical settings of a run: which of the two routes, and how finely."""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from solver.validation import require, require_between, require_positive

Method: TypeAlias = Literal["adaptive", "panels"]

TERMINATION_TIME = 0.05
"""Far beyond the few milliseconds a strike takes. [s]"""
TRAJECTORY_TOLERANCE, SEARCH_TOLERANCE = 3e-7, 3e-4
TRAJECTORY_STATIONS, SEARCH_STATIONS = 12, 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Numerics:
    """How a run is computed.

    Parameters
    ----------
    method
        ``"adaptive"``: Gauss points on closed-form arcs and error-controlled steps. ``"panels"``: the paper's surface
        elements and fixed step. Left open, it is adaptive, or panels in the searches of the paper.
    termination_time
        When a run is given up undecided; left open, 50 ms, or 5 ms in the searches of the paper. [s]
    panels, time_step
        Surface elements and step of the panel route. [1, s]
    relative_tolerance
        Error of one step of the adaptive route, over the scale of the motion; left open, 3e-7 for a trajectory, which
        balances energy to 1e-6, and 3e-4 for a search, which goes on more finely where that may not do. [1]
    stations, points
        Gauss-Legendre points of the adaptive route, along a stretch of the outline and around an arc. Stations left
        open are 12 for a trajectory and 8 for a search. [1]
    """

    method: Method | None = None
    termination_time: float | None = None
    panels: int = 12_000
    time_step: float = 1e-5
    relative_tolerance: float | None = None
    stations: int | None = None
    points: int = 4

    def __post_init__(self) -> None:
        require(self.method in (None, "adaptive", "panels"), "numerics.method", "must be 'adaptive' or 'panels'")
        if self.termination_time is not None:
            require_positive("numerics.termination_time", self.termination_time)
        require_between("numerics.panels", self.panels, 100, 1_000_000)
        require_positive("numerics.time_step", self.time_step)
        if self.relative_tolerance is not None:
            require_between("numerics.relative_tolerance", self.relative_tolerance, 1e-10, 1e-2)
        if self.stations is not None:
            require_between("numerics.stations", self.stations, 2, 256)
        require_between("numerics.points", self.points, 2, 256)

    def resolved(
        self,
        *,
        method: Method = "adaptive",
        termination_time: float = TERMINATION_TIME,
        relative_tolerance: float = TRAJECTORY_TOLERANCE,
        stations: int = TRAJECTORY_STATIONS,
    ) -> "ResolvedNumerics":
        """The same settings with what was left open filled in."""
        return ResolvedNumerics(
            method=self.method or method,
            termination_time=termination_time if self.termination_time is None else self.termination_time,
            panels=self.panels,
            time_step=self.time_step,
            relative_tolerance=relative_tolerance if self.relative_tolerance is None else self.relative_tolerance,
            stations=stations if self.stations is None else self.stations,
            points=self.points,
        )


USUAL = Numerics()
"""With everything left open."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedNumerics:
    """Numerical settings with nothing left open; fields as in `Numerics`."""

    method: Method
    termination_time: float
    panels: int
    time_step: float
    relative_tolerance: float
    stations: int
    points: int

    @property
    def fixed_steps(self) -> int:
        """Steps of the panel route up to the termination time."""
        return math.ceil(self.termination_time / self.time_step)
