"""Strength factors from the finite element runs with each decay law, by motion and by depth in normal impact."""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.reports.contents import Tell
from service.reports.paper.strike import finite_element_depths, history_of, impact_of, time_of_deepest_tip
from service.reports.reference import MESHES, FiniteElementRun, Mesh, finite_element_runs
from solver import ElasticPlastic, MohrCoulomb, Numerics, Resistance
from solver.calibration import (
    DecayLawFits,
    DepthFit,
    Estimate,
    MotionFit,
    MotionRun,
    UndeterminedError,
    Weights,
    fit_decay_laws,
    fit_motion,
)
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET
from solver.free_surface import FreeSurface

ELASTIC_PLASTIC, MOHR_COULOMB = ElasticPlastic(), MohrCoulomb()
LAWS: Mapping[str, FreeSurface] = {law.name: law for law in (ELASTIC_PLASTIC, MOHR_COULOMB)}
"""Decay laws with which a critical angle is predicted."""
LAW_NAMES = {"elastic_plastic": "elastic-plastic", "mohr_coulomb": "Mohr-Coulomb", "none": "no decay"}
PAPER_ANGLES = (15.0, 30.0, 45.0)
"""Oblique angles at which the paper calibrates. [°]"""
ROUGHER = Numerics(relative_tolerance=1e-5)
"""For fits to one quantity, which leave S open anyway beyond the second decimal."""
ALONE = {
    "depth_displacement": Weights(lateral=0.0, rotation=0.0),
    "lateral_displacement": Weights(depth=0.0, rotation=0.0),
    "rotation": Weights(depth=0.0, lateral=0.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """Everything fitted to the runs with one mesh."""

    mesh: Mesh
    runs: Sequence[FiniteElementRun]
    """The oblique ones, by angle."""
    fits: DecayLawFits
    """Until the nose tip of each run is deepest."""
    later_fits: DecayLawFits
    """Until the centre of gravity of each run is deepest, which is later at steep angles."""
    by_depth: DepthFit
    """Greatest depths of normal impact, which no decay law changes."""
    alone: Mapping[str, Mapping[float, Mapping[str, Estimate | None]]]
    """By law and oblique angle: S from each quantity by itself; None where it leaves S open. [°]"""
    cpu_seconds: float
    """Processor time of `fits`. [s]"""

    def own(self, law: str, *, later: bool = False) -> dict[float, MotionFit]:
        """Fit of each run by itself with a law, by oblique angle; without those that leave S open. [°]"""
        found = (self.later_fits if later else self.fits).laws[law]
        alone = found.alone if found else ()
        return {run.degrees: fit for run, fit in zip(self.runs, alone, strict=False) if fit is not None}

    def factors(self, law: str, *, later: bool = False) -> dict[float, Estimate]:
        """S by oblique angle: from depths at 0°, from motion elsewhere. [°]"""
        return {0.0: self.by_depth.estimate} | {
            angle: fit.estimate for angle, fit in self.own(law, later=later).items()
        }

    def normalized_root_mean_square(self, law: str, *, later: bool = False) -> float:
        """Over all runs, each at its own S. [1]"""
        return overall(self.own(law, later=later).values())


def overall(fits: Iterable[MotionFit]) -> float:
    """Normalised root mean square of several fits, each counting alike. [1]"""
    return math.sqrt(float(np.mean([fit.normalized_root_mean_square**2 for fit in fits])))


def calibrations(tell: Tell) -> dict[Mesh, Calibration]:
    """Fit every run with every law, for each mesh."""
    return {mesh: _calibrate(mesh, tell) for mesh in MESHES}


def _calibrate(mesh: Mesh, tell: Tell) -> Calibration:
    runs = [run for run in finite_element_runs(mesh) if run.oblique_angle > 0.0]
    tell(f"finite elements, {mesh} mesh: fits to the motion")
    fit_laws([runs[0]], [time_of_deepest_tip(runs[0])])  # compiled before any time is taken
    ends = [time_of_deepest_tip(run) for run in runs]
    start = time.process_time()
    fits = fit_laws(runs, ends)
    spent = time.process_time() - start
    later = fit_laws(runs, [history_of(run).time_of_greatest_depth for run in runs])
    tell(f"finite elements, {mesh} mesh: fits to one quantity")
    alone = {
        name: {run.degrees: _alone(run, end, law) for run, end in zip(runs, ends, strict=True)}
        for name, law in LAWS.items()
    }
    return Calibration(
        mesh=mesh,
        runs=runs,
        fits=fits,
        later_fits=later,
        by_depth=finite_element_depths(mesh),
        alone=alone,
        cpu_seconds=spent,
    )


def fit_laws(runs: Sequence[FiniteElementRun], ends: Sequence[float]) -> DecayLawFits:
    """Fit runs with every decay law, each up to some instant. [s]"""
    return fit_decay_laws(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        runs=[
            MotionRun(impact=impact_of(run), history=history_of(run).until(end))
            for run, end in zip(runs, ends, strict=True)
        ],
    )


def _alone(run: FiniteElementRun, end: float, law: FreeSurface) -> dict[str, Estimate | None]:
    """S from each quantity by itself."""
    return {name: _fit_quantity(run, end, law, weights) for name, weights in ALONE.items()}


def _fit_quantity(run: FiniteElementRun, end: float, law: FreeSurface, weights: Weights) -> Estimate | None:
    try:
        fit = fit_motion(
            projectile=PAPER_PROJECTILE,
            target=PAPER_TARGET,
            impact=impact_of(run),
            history=history_of(run).until(end),
            weights=weights,
            resistance=Resistance(free_surface=law),
            numerics=ROUGHER,
        )
    except UndeterminedError:
        return None
    return fit.estimate
