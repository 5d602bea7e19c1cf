"""The three ways side by side: the NumPy script, the same panels compiled, and the adaptive route.

One repetition runs every contender once, in an order that turns, so that a slow spell of the machine meets them all.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from benchmarks.converged import (
    DEPTH_TIMES,
    OBLIQUE_ANGLE_DEG,
    References,
    degrees,
    paper_critical_angle,
    paper_trajectory,
    tip_depths,
)
from benchmarks.numpy_script import STEP as SCRIPT_STEP
from benchmarks.startup import run_alone
from benchmarks.timing import Timing, spread, summary, time_call
from solver import CriticalAngle, Numerics, Search
from solver.search.critical_angle import PAPER_TERMINATION_TIME

PAPER_PANELS = Numerics(method="panels", termination_time=PAPER_TERMINATION_TIME)
"""12,000 panels and steps of 0.01 ms, as the script has."""


@dataclass(slots=True)
class Contender:
    """A call of the solver, and what was seen of it."""

    label: str
    call: Callable[[], object]
    timings: list[Timing] = field(default_factory=list)
    answer: object = None
    """Of the last call."""

    def repeat(self) -> None:
        """Run and time it once more."""
        self.timings.append(time_call(self._answer))

    def _answer(self) -> None:
        self.answer = self.call()

    def result(self, yardstick: "Contender") -> dict[str, Any]:
        """Times, and how many times faster it was than the yardstick in the same repetition."""
        pairs = list(zip(yardstick.timings, self.timings, strict=True))
        return {
            "label": self.label,
            **summary(self.timings),
            "cpu_ratio": spread([slow.cpu / fast.cpu for slow, fast in pairs]),
            "wall_ratio": spread([slow.wall / fast.wall for slow, fast in pairs]),
        }


@dataclass(slots=True)
class Script(Contender):
    """The NumPy script in a process of its own; `call` gives what it printed."""

    call: Callable[[], dict[str, Any]]
    said: list[dict[str, Any]] = field(default_factory=list)

    def repeat(self) -> None:
        """Run it once more; it times itself."""
        said = self.call()
        self.said.append(said)
        self.timings.append(Timing(said["cpu_s"], said["wall_s"]))

    def result(self, yardstick: Contender) -> dict[str, Any]:
        """Times, and the part of the CPU time that was the operating system's."""
        result = super(Script, self).result(yardstick)
        return result | {"system_s": spread([said["system_s"] for said in self.said])}


def measure_routes(repetitions: int, references: References) -> dict[str, Any]:
    """Times and errors of the critical angle and of one trajectory."""
    script_angle = Script("NumPy script, secant to 1 %", partial(run_alone, "numpy_script.py"))
    angles = {
        "panels_secant": Contender(
            "panels, same grid, secant to 1 %", partial(paper_critical_angle, search=Search(method="secant"))
        ),
        "adaptive_outcome": Contender("adaptive, outcome to 0.01°", paper_critical_angle),
    }
    script_path = Script("NumPy script", partial(run_alone, "numpy_script.py", f"{OBLIQUE_ANGLE_DEG:g}"))
    paths = {
        "panels": Contender(
            "panels, same grid", partial(paper_trajectory, numerics=PAPER_PANELS, sample_interval=None)
        ),
        "adaptive": Contender("adaptive", partial(paper_trajectory, sample_interval=None)),
        "adaptive_history": Contender("adaptive, with history", paper_trajectory),
    }
    order = [script_angle, *angles.values(), script_path, *paths.values()]
    for repetition in range(repetitions):
        print(f"routes: repetition {repetition + 1} of {repetitions}", file=sys.stderr)
        for contender in order:
            contender.repeat()
        order = [*order[1:], order[0]]
    return {
        "angles": _angle_results(script_angle, angles, references),
        "trajectories": _path_results(script_path, paths, references),
    }


def _angle_results(script: Script, contenders: dict[str, Contender], references: References) -> dict[str, Any]:
    said = script.said[-1]
    found = {"numpy_script": (said["angle_deg"], said["trajectories"])}
    for name, contender in contenders.items():
        answer = contender.answer
        assert isinstance(answer, CriticalAngle)  # noqa: S101
        found[name] = degrees(answer), len(answer.iterations)
    results: dict[str, Any] = {}
    for name, contender in {"numpy_script": script, **contenders}.items():
        angle, trajectories = found[name]
        own = references.by_outcome if name == "adaptive_outcome" else references.by_tip
        results[name] = contender.result(script) | {
            "angle_deg": angle,
            "trajectories": trajectories,
            "error_deg": abs(angle - references.by_outcome),
            "error_of_own_criterion_deg": abs(angle - own),
        }
    return results


def _path_results(script: Script, contenders: dict[str, Contender], references: References) -> dict[str, Any]:
    steps = [round(time / SCRIPT_STEP) for time in DEPTH_TIMES]
    adaptive = tip_depths(Numerics())
    depths = {
        "numpy_script": np.array(script.said[-1]["tip_depth_m"])[steps],
        "panels": tip_depths(PAPER_PANELS),
        "adaptive": adaptive,
        "adaptive_history": adaptive,
    }
    results: dict[str, Any] = {}
    for name, contender in {"numpy_script": script, **contenders}.items():
        errors = np.abs(depths[name] - references.tip_depths)
        results[name] = contender.result(script) | {
            "times_s": list(DEPTH_TIMES),
            "tip_depth_m": depths[name].tolist(),
            "error_m": errors.tolist(),
            "greatest_error_m": float(errors.max()),
        }
    return results
