"""How the finite element runs end, read from their last row, and between which angles their outcome changes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from service.reports.contents import Table
from service.reports.paper.strike import impact_of, path_of_run
from service.reports.reference import FiniteElementRun
from solver import ConstantStrengthFactor, Outcome, Resistance, mass_properties, simulate
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET
from solver.free_surface import FreeSurface

RETAINED = 0.01
"""Share of the initial kinetic energy with which a projectile that leaves counts as turned away. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """The last row of an oblique run."""

    run: FiniteElementRun
    tip_depth: float
    """[m]"""
    tip_velocity: float
    """Of the nose tip along the inward normal. [m/s]"""
    center_velocity: float
    """Of the centre of gravity along the inward normal. [m/s]"""
    energy_share: float
    """Kinetic energy over the initial one. [1]"""

    @property
    def turned_away(self) -> bool:
        """Whether nose tip and centre of gravity both move out, with at least 1 % of the energy."""
        return max(self.tip_velocity, self.center_velocity) < 0.0 and self.energy_share >= RETAINED

    @property
    def outcome(self) -> Outcome:
        """Turned away, embedded if the energy is spent, otherwise not decided yet."""
        if self.turned_away:
            return Outcome.RICOCHET
        return Outcome.EMBEDDED if self.energy_share < RETAINED else Outcome.IN_MOTION


def ending(run: FiniteElementRun) -> Ending:
    """Return the last row of a run."""
    properties = mass_properties(PAPER_PROJECTILE)
    axis, rate = run.oblique_angle + run.rotation[-1], float(run.angular_velocity[-1])
    return Ending(
        run=run,
        tip_depth=float(path_of_run(run).depth[-1]),
        tip_velocity=float(run.depth_velocity[-1] - properties.center_of_gravity * math.sin(axis) * rate),
        center_velocity=float(run.depth_velocity[-1]),
        energy_share=_energy(run, -1) / _energy(run, 0),
    )


def _energy(run: FiniteElementRun, row: int) -> float:
    """Kinetic energy of a row for unit mass. [J/kg]"""
    properties = mass_properties(PAPER_PROJECTILE)
    gyration = properties.moment_of_inertia / properties.mass
    speeds = run.depth_velocity[row] ** 2 + run.lateral_velocity[row] ** 2
    return 0.5 * float(speeds + gyration * run.angular_velocity[row] ** 2)


def modelled_outcome(run: FiniteElementRun, *, strength_factor: float, free_surface: FreeSurface) -> Outcome:
    """Outcome of the model in the strike of a run."""
    law = ConstantStrengthFactor(value=strength_factor)
    return simulate(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=impact_of(run),
        resistance=Resistance(strength_factor=law, free_surface=free_surface),
        sample_interval=None,
    ).outcome


def bracket(runs: Sequence[FiniteElementRun]) -> tuple[float, float]:
    """Largest angle at which no run is turned away, and the smallest at which one is. [rad]"""
    turned = {run.oblique_angle: ending(run).turned_away for run in runs if run.oblique_angle > 0.0}
    return max(angle for angle, away in turned.items() if not away), min(a for a, away in turned.items() if away)


def table(runs: Sequence[FiniteElementRun]) -> Table:
    """Last rows of the oblique runs."""
    endings = [ending(run) for run in runs if run.oblique_angle > 0.0]
    words = {
        Outcome.RICOCHET: "turned away",
        Outcome.EMBEDDED: "embedded",
        Outcome.IN_MOTION: "retained so far, still in motion",
    }
    rows = [
        (
            each.run.degrees,
            each.run.mesh,
            float(each.run.time[-1]) * 1e3,
            round(each.tip_depth * 1e3, 1),
            round(each.tip_velocity, 1),
            round(each.center_velocity, 1),
            round(100.0 * each.energy_share, 2),
            words[each.outcome],
        )
        for each in sorted(endings, key=lambda each: each.run.oblique_angle)
    ]
    columns: tuple[str, ...] = ("oblique angle [°]", "mesh", "end [ms]", "tip depth [mm]", "tip velocity [m/s]")
    columns += ("velocity of the centre of gravity [m/s]", "energy left [%]", "outcome")
    caption = (
        "Last row of each oblique finite element run; velocities along the inward normal, negative outwards. Turned "
        f"away: nose tip and centre of gravity move out with at least {100.0 * RETAINED:g} % of the energy."
    )
    return Table(name="finite-elements-endings", caption=caption, columns=columns, rows=rows)
