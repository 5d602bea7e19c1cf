"""Strength factors from the finite element runs, by their motion and by their depths in normal impact."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from service.reports.contents import Tell
from service.reports.paper.strike import (
    finite_element_depths,
    finite_element_fit,
    history_of,
    impact_of,
    time_of_deepest_tip,
)
from service.reports.reference import FiniteElementRun, finite_element_run
from solver import Numerics
from solver.calibration import DepthFit, Estimate, MotionFit, Weights, fit_motion
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET

CALIBRATED = ("oblique-15", "oblique-30", "oblique-45")
"""Runs whose motion the polynomial goes through; at 0° it takes the depths of all normal runs, as the paper does."""
NORMAL = "normal-238.1"
"""The normal run at the speed of the oblique ones: its motion is another reading of S at 0°."""
BRACKETING = ("oblique-48", "oblique-50", "oblique-52", "oblique-55")
"""Runs near the critical angle."""
ROUGHER = Numerics(relative_tolerance=1e-5)
"""For fits that only show what another reading gives: S to the second decimal, except where it is not told anyway."""
ALONE = {
    "depth_displacement": Weights(lateral=0.0, rotation=0.0),
    "lateral_displacement": Weights(depth=0.0, rotation=0.0),
    "rotation": Weights(depth=0.0, lateral=0.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """One run and what was fitted to it until its nose tip is deepest."""

    run: FiniteElementRun
    fit: MotionFit
    alone: Mapping[str, Estimate]
    """S from each quantity alone, for oblique runs."""
    cpu_seconds: float
    """Of the first of these fits."""

    @property
    def estimate(self) -> Estimate:
        """From all quantities together."""
        return self.fit.estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrations:
    """Everything fitted to the finite element runs."""

    by_motion: Sequence[Calibration]
    """The normal run, calibrated runs, then the bracketing ones."""
    by_depth: DepthFit
    """The four greatest depths of normal impact."""

    @property
    def points(self) -> dict[float, Estimate]:
        """What the polynomial goes through, by oblique angle: S from depths at 0°, from motion elsewhere. [rad]"""
        oblique = {each.run.oblique_angle: each.estimate for each in self.of(CALIBRATED)}
        return {0.0: self.by_depth.estimate, **oblique}

    def of(self, names: Sequence[str]) -> list[Calibration]:
        """Some of the runs, by name."""
        return [next(each for each in self.by_motion if each.run.name == name) for name in names]


def calibrations(tell: Tell) -> Calibrations:
    """Fit every run."""
    tell("finite elements: depths of normal impact")
    by_depth = finite_element_depths()
    finite_element_fit(CALIBRATED[0])  # what must be compiled is, before any time is taken
    by_motion = []
    for name in (NORMAL, *CALIBRATED, *BRACKETING):
        tell(f"finite elements: fit of {name}")
        by_motion.append(_calibrate(finite_element_run(name)))
    return Calibrations(by_motion=by_motion, by_depth=by_depth)


def fit_until(
    run: FiniteElementRun, end: float, weights: Weights | None = None, numerics: Numerics | None = None
) -> MotionFit:
    """Fit the motion of a run up to some instant. [s]"""
    return fit_motion(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=impact_of(run),
        history=history_of(run).until(end),
        weights=weights,
        numerics=numerics,
    )


def _calibrate(run: FiniteElementRun) -> Calibration:
    end = time_of_deepest_tip(run)
    start = time.process_time()
    fit = fit_until(run, end)
    spent = time.process_time() - start
    oblique = run.oblique_angle > 0.0
    alone = {name: fit_until(run, end, weights, ROUGHER).estimate for name, weights in ALONE.items()} if oblique else {}
    return Calibration(run=run, fit=fit, alone=alone, cpu_seconds=spent)
