"""Speed and error of the method `adaptive`, compared with the paper's method in plain NumPy and compiled.

    python benchmarks/routes.py [--quick] [--repetitions 5]

Compares `numpy_script.py` in its own process, the method `panels` with the same grid, and the method `adaptive`, for
the critical angle of the paper's strike and for one trajectory at 45°. A repetition measures each of them once, in
rotating order, so that slow phases of the machine affect all of them. CPU ratios are the time of the script divided by
that of the method in the same repetition. Takes about a minute; `--quick` does one repetition.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.converged import (
    DEPTH_TIMES,
    OBLIQUE_ANGLE_DEG,
    References,
    compute_references,
    degrees,
    paper_critical_angle,
    paper_trajectory,
    tip_depths,
)
from benchmarks.machine import print_machine, print_table, spread, time_spread
from benchmarks.numpy_script import STEP
from benchmarks.timing import Timing, time_call
from solver import CriticalAngle, Numerics, Search, warm_up
from solver.search.critical_angle import PAPER_TERMINATION_TIME

PAPER_PANELS = Numerics(method="panels", termination_time=PAPER_TERMINATION_TIME)
"""Numerics like those of the script: 12,000 panels, and steps of 0.01 ms until 5 ms."""
SCRIPT = Path(__file__).with_name("numpy_script.py")


@dataclass(slots=True)
class Contender:
    """A call of the solver to be compared, its timings, and its last answer."""

    label: str
    call: Callable[[], Any]
    timings: list[Timing] = field(default_factory=list)
    answer: Any = None

    def run(self) -> None:
        """Measure the call, and add its time to `timings`."""
        self.timings.append(time_call(self._call))

    def _call(self) -> None:
        self.answer = self.call()


class Script(Contender):
    """The NumPy script with its arguments; it measures its own time."""

    def run(self) -> None:
        """Run the script once, and add the time that it prints to `timings`."""
        done = subprocess.run([sys.executable, SCRIPT, *self.call()], capture_output=True, check=True)
        self.answer = json.loads(done.stdout)
        self.timings.append(Timing(self.answer["cpu_s"], self.answer["wall_s"]))


def times(contender: Contender, script: Contender) -> list[str]:
    """Return the cells for label, CPU time, wall time and CPU ratio."""
    ratios = [slow.cpu / fast.cpu for slow, fast in zip(script.timings, contender.timings, strict=True)]
    cpu, wall = ([getattr(timing, name) for timing in contender.timings] for name in Timing._fields)
    return [contender.label, time_spread(cpu), time_spread(wall), spread(ratios)]


def print_angles(angles: list[Contender], references: References) -> None:
    """Print the times of each search, and its errors by outcome and by the criterion that the search uses."""
    rows = []
    for contender in angles:
        answer = contender.answer
        if isinstance(answer, CriticalAngle):
            angle, trajectories = degrees(answer), len(answer.iterations)
        else:
            angle, trajectories = answer["angle_deg"], answer["trajectories"]
        sought = references.by_outcome if contender is angles[-1] else references.by_tip
        errors = (f"{abs(angle - reference):.3f}°" for reference in (references.by_outcome, sought))
        rows.append([*times(contender, angles[0]), f"{angle:.3f}°", *errors, trajectories])
    head = ["critical angle", "CPU time", "wall time", "CPU ratio", "angle", "error", "own criterion", "trajectories"]
    print_table(head, rows)
    print(f"Converged, by outcome: {references.by_outcome:.4f}°; tip back at the face after 5 ms, the paper's ", end="")
    print(f"criterion: {references.by_tip:.4f}°.")
    print(f"CPU time of the script charged by the operating system: {angles[0].answer['system_s']:.2f} s.\n")


def print_trajectories(trajectories: list[Contender], references: References) -> None:
    """Print the times of each trajectory, and the errors of its depth of the nose tip."""
    steps = [round(time / STEP) for time in DEPTH_TIMES]
    adaptive = tip_depths(Numerics())
    depths = [np.array(trajectories[0].answer["tip_depth_m"])[steps], tip_depths(PAPER_PANELS), adaptive, adaptive]
    rows = [
        [*times(contender, trajectories[0]), f"{1e3 * np.abs(depth - references.tip_depths).max():.3f} mm"]
        for contender, depth in zip(trajectories, depths, strict=True)
    ]
    print_table([f"trajectory at {OBLIQUE_ANGLE_DEG:g}°", "CPU time", "wall time", "CPU ratio", "greatest error"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare the numerical methods with a NumPy script.")
    parser.add_argument("--quick", action="store_true", help="measure one repetition")
    parser.add_argument("--repetitions", type=int, default=5)
    options = parser.parse_args()
    print_machine()
    warm_up()
    angles = [
        Script("NumPy script, secant to 1 %", list),
        Contender("panels, same grid, secant to 1 %", partial(paper_critical_angle, search=Search(method="secant"))),
        Contender("adaptive, outcome to 0.01°", paper_critical_angle),
    ]
    trajectories = [
        Script("NumPy script", lambda: [f"{OBLIQUE_ANGLE_DEG:g}"]),
        Contender("panels, same grid", partial(paper_trajectory, numerics=PAPER_PANELS, sample_interval=None)),
        Contender("adaptive", partial(paper_trajectory, sample_interval=None)),
        Contender("adaptive, with history", paper_trajectory),
    ]
    order = [*angles, *trajectories]
    for _ in range(1 if options.quick else options.repetitions):
        for contender in order:
            contender.run()
        order = [*order[1:], order[0]]
    references = compute_references()
    print_angles(angles, references)
    print_trajectories(trajectories, references)


if __name__ == "__main__":
    main()
