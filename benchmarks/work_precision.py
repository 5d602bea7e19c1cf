"""CPU time and error of the critical angle, for both numerical methods with many settings.

    python benchmarks/work_precision.py [--quick]

Each search for the critical angle of the paper's strike is by outcome and over the default range, and ends with a
bracket far narrower than the errors, so that times and errors depend only on the method and its settings. The reference
has finer settings than all others. Takes about five minutes; `--quick` uses a few fast settings.
"""

import argparse
import math
import time
from dataclasses import dataclass, field

from benchmarks.converged import degrees, paper_critical_angle
from benchmarks.machine import print_machine, print_table, time_spread
from solver import Numerics, RicochetError, Search, warm_up

BRACKET_DEG = 1e-5
REPETITIONS = 3
REPEATED_BELOW = 0.5
"""Searches that take less CPU time than this are measured `REPETITIONS` times, others once. [s]"""
FINEST = Numerics(method="adaptive", relative_tolerance=1e-8, stations=32, points=16)

QUADRATURES = ((4, 3), (6, 4), (8, 4), (16, 8))
"""Numbers of stations on each stretch of the body, and of points on each arc around it."""
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
PANELS = (750, 3_000, 12_000, 48_000)
"""Numbers of panels, each used with the paper's time step."""
TIME_STEPS = (4e-5, 2e-5, 1e-5, 5e-6)
"""Time steps, each used with the paper's number of panels. [s]"""


@dataclass(slots=True)
class Setting:
    """A row of the table: the settings of a search, its times and its answer."""

    label: str
    numerics: Numerics
    cpu: list[float] = field(default_factory=list)
    angle_deg: float = math.nan
    trajectories: int = 0

    def run(self) -> None:
        """Measure one search. The angle is nan if there is none, as with some coarse settings."""
        begin = time.process_time()
        try:
            answer = paper_critical_angle(numerics=self.numerics, search=Search(tolerance=math.radians(BRACKET_DEG)))
            self.angle_deg, self.trajectories = degrees(answer), len(answer.iterations)
        except (RicochetError, AssertionError):
            self.angle_deg = math.nan
        self.cpu.append(time.process_time() - begin)


def settings(*, quick: bool) -> list[Setting]:
    quadratures, tolerances = (((4, 3),), TOLERANCES[1:3]) if quick else (QUADRATURES, TOLERANCES)
    panels, time_steps = (PANELS[:1], ()) if quick else (PANELS, TIME_STEPS)
    adaptive = [
        Setting(
            f"adaptive, {stations} stations, {points} points, tolerance {tolerance:g}",
            Numerics(method="adaptive", relative_tolerance=tolerance, stations=stations, points=points),
        )
        for stations, points in quadratures
        for tolerance in tolerances
    ]
    more = [Setting(f"panels, {number:,}", Numerics(method="panels", panels=number)) for number in panels]
    finer = [Setting(f"panels, step {step:g} s", Numerics(method="panels", time_step=step)) for step in time_steps]
    return [*adaptive, *more, *finer]


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure CPU time against error.")
    parser.add_argument("--quick", action="store_true", help="use a few fast settings")
    options = parser.parse_args()
    print_machine()
    warm_up()
    reference = Setting("reference", Numerics(relative_tolerance=1e-5) if options.quick else FINEST)
    reference.run()
    rows = settings(quick=options.quick)
    for repetition in range(1 if options.quick else REPETITIONS):
        for row in rows:
            if not repetition or row.cpu[0] < REPEATED_BELOW:
                row.run()
    print_table(
        ["setting", "CPU time", "error", "trajectories"],
        [
            [row.label, time_spread(row.cpu), f"{abs(row.angle_deg - reference.angle_deg):.5f}°", row.trajectories]
            for row in rows
        ],
    )


if __name__ == "__main__":
    main()
