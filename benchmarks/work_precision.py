"""CPU time against the error of the critical angle, for both routes and many settings.

Every setting answers the paper's strike by the outcome, over the default range, to a bracket far below the errors, so
that times and errors are those of the route. The reference is finer than any of them.
"""

import math
import sys
import time
from dataclasses import dataclass, field
from typing import Any

from benchmarks.converged import degrees, paper_critical_angle
from benchmarks.timing import spread
from solver import Numerics, RicochetError, Search

BRACKET_DEG = 1e-5
REPEATED_BELOW = 0.5
"""A search that takes longer is timed once. [s]"""
FINEST = Numerics(method="adaptive", relative_tolerance=1e-8, stations=32, points=16)

QUADRATURES = ((4, 3), (6, 4), (8, 4), (16, 8))
"""Stations and points."""
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
PANELS = (750, 3_000, 12_000, 48_000)
"""At the paper's step."""
TIME_STEPS = (4e-5, 2e-5, 1e-5, 5e-6)
"""With the paper's panels. [s]"""


@dataclass(slots=True)
class Setting:
    """A point of the diagram."""

    series: str
    numerics: Numerics
    cpu: list[float] = field(default_factory=list)
    angle_deg: float = math.nan
    trajectories: int = 0

    def repeat(self) -> None:
        """Search once more."""
        begin = time.process_time()
        answer = paper_critical_angle(numerics=self.numerics, search=Search(tolerance=math.radians(BRACKET_DEG)))
        self.cpu.append(time.process_time() - begin)
        self.angle_deg, self.trajectories = degrees(answer), len(answer.iterations)

    def row(self, reference_deg: float) -> dict[str, Any]:
        """Point of the diagram with what it was computed with."""
        numerics = self.numerics
        if numerics.method == "panels":
            with_: dict[str, Any] = {"panels": numerics.panels, "time_step_s": numerics.time_step}
        else:
            with_ = {
                "relative_tolerance": numerics.relative_tolerance,
                "stations": numerics.stations,
                "points": numerics.points,
            }
        return {
            "series": self.series,
            "route": numerics.method,
            **with_,
            "cpu_s": spread(self.cpu),
            "trajectories": self.trajectories,
            "angle_deg": self.angle_deg,
            "error_deg": abs(self.angle_deg - reference_deg),
        }


def measure_work_precision(repetitions: int, *, coarse: bool) -> dict[str, Any]:
    """Points of both routes; `coarse` takes only a few that are quick."""
    finest = Numerics(method="adaptive", relative_tolerance=1e-5) if coarse else FINEST
    reference = Setting("reference", finest)
    reference.repeat()
    settings = _settings(coarse=coarse)
    for repetition in range(repetitions):
        for setting in settings:
            if repetition == 0 or (setting.cpu and setting.cpu[0] < REPEATED_BELOW):
                _try(setting, repetition)
    return {
        "bracket_deg": BRACKET_DEG,
        "reference": reference.row(reference.angle_deg),
        "points": [setting.row(reference.angle_deg) for setting in settings if setting.cpu],
    }


def _try(setting: Setting, repetition: int) -> None:
    print(f"work-precision, repetition {repetition + 1}: {setting.series}", file=sys.stderr)
    try:
        setting.repeat()
    except (RicochetError, AssertionError) as error:  # a coarse setting may find no angle at all
        print(f"  left out: {error!r}", file=sys.stderr)


def _settings(*, coarse: bool) -> list[Setting]:
    quadratures, tolerances = (((4, 3),), TOLERANCES[1:3]) if coarse else (QUADRATURES, TOLERANCES)
    panels, time_steps = (PANELS[:1], ()) if coarse else (PANELS, TIME_STEPS)
    return [
        *(
            Setting(
                f"adaptive, {stations} stations, {points} points",
                Numerics(method="adaptive", relative_tolerance=tolerance, stations=stations, points=points),
            )
            for stations, points in quadratures
            for tolerance in tolerances
        ),
        *(Setting("panels, more of them", Numerics(method="panels", panels=number)) for number in panels),
        *(Setting("panels, smaller steps", Numerics(method="panels", time_step=step)) for step in time_steps),
    ]
