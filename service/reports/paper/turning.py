"""Figure 15: the projectile from the side at the critical angle, just below it and just above."""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from service.reports import style
from service.reports.contents import Column, Figure, Section, Tell, paragraphs, stack
from service.reports.paper.searches import search
from service.reports.paper.strike import history_of, impact_of, motion_of, paper_strike, path_of
from service.reports.reference import finite_element_run
from service.reports.side_view import TipPath, draw_concrete, draw_path
from solver import Resistance, simulate, strength_factor
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET

INSTANTS = (0.0, 1e-3, 2e-3, 3.2e-3, 5e-3)
"""[s]"""
ASIDE = math.radians(0.5)
"""From the critical angle to the strikes beside it. [rad]"""
RUNS = ("oblique-48", "oblique-50", "oblique-52")
VIEW = {"lateral": (-0.52, 0.95), "depth": (-0.42, 0.2)}
"""[m]"""
WORDS = {"embedded": "embedded", "ricochet": "turned away", "in_motion": "tip still inside, sliding"}


@dataclass(frozen=True, slots=True)
class View:
    """One panel."""

    title: str
    path: TipPath


def section(tell: Tell) -> Section:
    """Return Figure 15."""
    tell("motion at the critical angle")
    critical = search("outcome").angle
    if critical is None:
        return Section(title="Figure 15: motion at the critical angle", text=["No critical angle was found."])
    modelled = [_modelled(critical + aside) for aside in (-ASIDE, 0.0, ASIDE)]
    computed = [_computed(name) for name in RUNS]
    return Section(
        title="Figure 15: motion at the critical angle",
        text=paragraphs(
            """
            Half a degree below the critical angle the nose stays inside; half a degree above, it comes out.
            The body turns with its nose toward the face, and skids along it half buried before its tail
            throws it out or its last energy is spent. At the critical angle itself it takes longer than the
            5 ms shown.

            The paper shows its program and LS-DYNA at 48.2° side by side, without numbers. In the right
            column are our finite element runs around their own change. With this mesh it lies between 48° and
            50°, by the velocities of the last row: the run at 50° ends with its nose inside, but on its way
            out. The mesh is not converged there: with cubes of 7.5 mm instead of 10 mm the run at 48° is
            turned away.
            """
        ),
        figures=[_figure(modelled, computed)],
    )


def _modelled(oblique_angle: float) -> View:
    impact = paper_strike(oblique_angle)
    outcome = simulate(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact, sample_interval=None).outcome
    strength = strength_factor(
        resistance=Resistance(), oblique_angle=oblique_angle, target=PAPER_TARGET, projectile=PAPER_PROJECTILE
    )
    history = motion_of(impact, strength_factor=strength, times=np.linspace(0.0, INSTANTS[-1], 501))
    return View(f"model, {math.degrees(oblique_angle):.2f}°: {WORDS[outcome.value]}", path_of(history, impact))


def _computed(name: str) -> View:
    run = finite_element_run(name)
    history = history_of(run)
    angle = math.degrees(run.oblique_angle)
    return View(f"finite elements, {angle:.0f}°: {WORDS[run.outcome]}", path_of(history, impact_of(run)))


def _figure(modelled: list[View], computed: list[View]) -> Figure:
    figure, panels = style.panels(6, height=6.2, rows=3, sharex=True, sharey=True)
    views = [view for row in zip(modelled, computed, strict=True) for view in row]
    for axes, view in zip(panels, views, strict=True):
        _draw(axes, view)
    for axes in panels[-2:]:
        axes.set_xlabel("along the face [m]")
    for axes in panels[::2]:
        axes.set_ylabel("depth [m]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return Figure(
        name="figure-15",
        caption="Figure 15. Outline of the projectile at instants, and the path of its nose tip. Left: the model at "
        "its critical angle (middle), half a degree below and half a degree above. Right: our finite element runs.",
        figure=figure,
        data=stack("view", {view.title: _columns(view.path) for view in views}),
    )


def _draw(axes: Axes, view: View) -> None:
    instants = np.minimum(INSTANTS, view.path.time[-1])
    draw_concrete(axes, **VIEW)
    draw_path(axes, PAPER_PROJECTILE, view.path, instants)
    axes.grid(visible=False)
    axes.set_title(view.title)


def _columns(path: TipPath) -> dict[str, Column]:
    return {
        "time_s": path.time,
        "nose_tip_lateral_m": path.lateral,
        "nose_tip_depth_m": path.depth,
        "axis_angle_deg": np.degrees(path.axis_angle),
    }
