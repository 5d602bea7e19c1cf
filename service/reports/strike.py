"""The paper's strike: finite element runs of it as histories, their fits, paths from the side."""

from dataclasses import replace
from functools import cache

import numpy as np

from service.reports.reference import FiniteElementRun, Mesh, finite_element_run, finite_element_runs
from service.reports.side_view import TipPath, tip_path
from solver import Impact, Resistance
from solver.arrays import FloatArray
from solver.calibration import (
    DepthFit,
    DepthTest,
    MotionFit,
    MotionHistory,
    fit_depth,
    fit_motion,
    predict_motion,
)
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
from solver.free_surface import FreeSurface

THREADS = 2
"""Cores that long computations are spread over."""


def paper_strike(oblique_angle: float) -> Impact:
    """The paper's strike at an oblique angle. [rad]"""
    return Impact(velocity=PAPER_VELOCITY, oblique_angle=oblique_angle)


def impact_of(run: FiniteElementRun) -> Impact:
    """The strike of a finite element run."""
    return Impact(velocity=run.velocity, oblique_angle=run.oblique_angle)


def history_of(run: FiniteElementRun) -> MotionHistory:
    """The motion of a finite element run; a normal one has depth only."""
    depth_only = MotionHistory(time=run.time, depth_displacement=run.depth_displacement)
    if run.oblique_angle == 0.0:
        return depth_only
    return replace(depth_only, lateral_displacement=run.lateral_displacement, rotation=run.rotation)


@cache
def finite_element_fit(name: str) -> MotionFit:
    """Strength factor that fits a finite element run best until its nose tip is deepest."""
    run = finite_element_run(name)
    return fit_motion(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=impact_of(run),
        history=history_of(run).until(time_of_deepest_tip(run)),
    )


@cache
def finite_element_depths(mesh: Mesh = "coarse") -> DepthFit:
    """Strength factor that fits the greatest depths of the normal finite element runs best."""
    normal = [run for run in finite_element_runs(mesh) if run.oblique_angle == 0.0]
    tests = [DepthTest(velocity=run.velocity, depth=float(run.depth_displacement.max())) for run in normal]
    return fit_depth(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, tests=tests)


def time_of_deepest_tip(run: FiniteElementRun) -> float:
    """When the nose tip of a finite element run is deepest; its tail may go on sinking for long. [s]"""
    return float(run.time[int(np.argmax(path_of_run(run).depth))])


def path_of_run(run: FiniteElementRun) -> TipPath:
    """Path of the nose tip of a finite element run."""
    return tip_path(
        PAPER_PROJECTILE,
        time=run.time,
        depth_displacement=run.depth_displacement,
        lateral_displacement=run.lateral_displacement,
        axis_angle=run.oblique_angle + run.rotation,
    )


def motion_of(
    impact: Impact, *, strength_factor: float, times: FloatArray, free_surface: FreeSurface | None = None
) -> MotionHistory:
    """Motion of the paper's projectile by the adaptive route, elastic-plastic unless given; times in seconds."""
    return predict_motion(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=impact,
        strength_factor=strength_factor,
        times=times,
        resistance=None if free_surface is None else Resistance(free_surface=free_surface),
    )


def path_of(history: MotionHistory, impact: Impact) -> TipPath:
    """Path of the nose tip in an oblique strike."""
    depth, lateral, rotation = history.depth_displacement, history.lateral_displacement, history.rotation
    if depth is None or lateral is None or rotation is None:
        raise ValueError("a path from the side needs depth, lateral displacement and rotation")
    return tip_path(
        PAPER_PROJECTILE,
        time=history.time,
        depth_displacement=depth,
        lateral_displacement=lateral,
        axis_angle=impact.axis_angle + rotation,
    )
