"""Figures 17 and 18: what step and number of elements do to the motion at 45°."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from service.reports import style
from service.reports.contents import Comparison, Figure, Section, Table, Tell, paragraphs
from service.reports.paper.motion import LABELS, Curve, column, draw_histories, history_columns
from service.reports.paper.strike import THREADS, motion_of, paper_strike
from solver import Numerics, Resistance, strength_factor
from solver.calibration import MotionHistory, predict_motion
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET

OBLIQUE_ANGLE = math.radians(45.0)
STEPS = (1e-4, 5e-5, 2e-5, 1e-5, 5e-6)
"""[s]"""
ELEMENTS = (750, 1500, 3000, 6000, 12_000, 24_000)
PAPER_STEP, PAPER_ELEMENTS = 1e-5, 12_000
TIMES = np.linspace(0.0, 5e-3, 501)
"""[s]"""
STRIKE = paper_strike(OBLIQUE_ANGLE)
STRENGTH = strength_factor(
    resistance=Resistance(), oblique_angle=OBLIQUE_ANGLE, target=PAPER_TARGET, projectile=PAPER_PROJECTILE
)
TEXT = paragraphs(
    """
    The paper's fixed-step program at 45° from the normal with other steps and other numbers of
    surface elements, up to 5 ms, beside our adaptive route. The paper prints no numbers here; it
    says that the motion converges at 0.01 ms and depends little on the number of elements. Which
    steps and numbers it tried is in its figures only.

    Here the motion hardly depends on either; see the greatest differences in the table. That is so
    because our fixed-step route takes a late step that gains energy for rest. A program that goes
    on creeps after it has stopped, the faster the longer its step: the true motion only loses
    energy.
    """
)
CLOSE = {"lateral_displacement": 1e-3, "depth_displacement": 1e-3, "rotation": 0.1}
"""How near the paper's grid has to come to the adaptive route. [m, m, °]"""


@dataclass(frozen=True, slots=True)
class Grid:
    """A fixed-step run."""

    elements: int
    step: float
    """[s]"""
    history: MotionHistory


def section(tell: Tell) -> Section:
    """Return Figures 17 and 18."""
    tell("sensitivity to step and elements")
    settings = [(PAPER_ELEMENTS, step) for step in STEPS] + [(count, PAPER_STEP) for count in ELEMENTS]
    with ThreadPoolExecutor(THREADS) as pool:
        grids = list(pool.map(lambda setting: _run(*setting), settings))
    adaptive = motion_of(STRIKE, strength_factor=STRENGTH, times=TIMES)
    steps, elements = grids[: len(STEPS)], grids[len(STEPS) :]
    return Section(
        title="Figures 17 and 18: sensitivity at 45°",
        text=TEXT,
        comparisons=_comparisons(grids, adaptive),
        tables=[_table(grids, adaptive)],
        figures=[
            _figure(
                "figure-17",
                "Figure 17. Motion at 45° for several steps, with 12,000 elements.",
                steps,
                [f"{grid.step * 1e3:g} ms" for grid in steps],
                adaptive,
            ),
            _figure(
                "figure-18",
                "Figure 18. Motion at 45° for several numbers of elements, with steps of 0.01 ms.",
                elements,
                [f"{grid.elements:,} elements" for grid in elements],
                adaptive,
            ),
        ],
    )


def _run(elements: int, step: float) -> Grid:
    history = predict_motion(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=STRIKE,
        strength_factor=STRENGTH,
        times=TIMES,
        numerics=Numerics(method="panels", panels=elements, time_step=step),
    )
    return Grid(elements, step, history)


def _farthest(history: MotionHistory, other: MotionHistory, quantity: str) -> float:
    """Greatest difference of a quantity. [m, °]"""
    return float(np.max(np.abs(column(history, quantity) - column(other, quantity))))


def _comparisons(grids: Sequence[Grid], adaptive: MotionHistory) -> list[Comparison]:
    paper = next(grid for grid in grids if (grid.elements, grid.step) == (PAPER_ELEMENTS, PAPER_STEP))
    return [
        Comparison(
            what=f"greatest {label.partition(' [')[0]} at 45°, paper's grid",
            ours=float(np.max(column(paper.history, quantity))),
            reference=float(np.max(column(adaptive, quantity))),
            unit=label.partition("[")[2].rstrip("]"),
            tolerance=CLOSE[quantity],
            reference_source="our adaptive route",
            note="12,000 elements, 0.01 ms; the paper prints none",
        )
        for quantity, label in LABELS.items()
    ]


def _table(grids: Sequence[Grid], adaptive: MotionHistory) -> Table:
    return Table(
        name="sensitivity",
        caption="Greatest difference to the adaptive route at any time up to 5 ms.",
        columns=["step ms", "elements", "lateral, mm", "depth, mm", "rotation, °"],
        rows=[
            (
                grid.step * 1e3,
                grid.elements,
                _farthest(grid.history, adaptive, "lateral_displacement") * 1e3,
                _farthest(grid.history, adaptive, "depth_displacement") * 1e3,
                _farthest(grid.history, adaptive, "rotation"),
            )
            for grid in grids
        ],
    )


def _figure(name: str, caption: str, grids: Sequence[Grid], labels: Sequence[str], adaptive: MotionHistory) -> Figure:
    curves = [
        Curve(label, grid.history, {"color": color})
        for grid, label, color in zip(grids, labels, style.shades(len(grids)), strict=True)
    ]
    curves.append(Curve("adaptive", adaptive, {"color": "black", "linestyle": ":", "linewidth": 2.0}))
    return Figure(
        name=name,
        caption=f"{caption} Dotted: the adaptive route, and below the differences to it.",
        figure=draw_histories(curves, against=adaptive),
        data=history_columns(curves),
    )
