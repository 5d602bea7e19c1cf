"""Rules that every true answer keeps, looked at on every answer since they cost nothing: a fault of the code shows."""

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from solver.free_surface import NoFreeSurface, decay_factor
from solver.prepared import Exit, Outcome, PreparedCase
from solver.projectile import MassProperties, mass_properties
from solver.resistance import plug_height
from solver.strike import Impact
from solver.warnings import ModelWarning, implausible

MOST_GAIN = 1e-3
"""Gain of kinetic energy over its initial value: a true motion has none, and error control leaves less. [1]"""
ERROR_OF_TOLERANCE = 10.0
"""Error of an energy over the relative tolerance of a step: a motion has hundreds, whose errors mostly cancel. [1]"""
LEAST_WORK = 0.05
"""Energy lost in a wall over S f'c, weakened by the rear face, times cross section and thickness; on an oblique way the
other face weakens it too. [1]"""
LEAST_WALL = 0.5
"""Thickness over the diameter from which a wall takes energy from whatever passes. [1]"""
MARGIN = 4.0
"""Thickness that holds beyond the depth that the energy allows, in diameters: what the weaker resistance between two
faces can add, up to 2.2 in 750 random strikes on usual concrete. [1]"""
RAMP = 0.01
"""Depth over the diameter that a strike reaches while the static stress builds up, however little its energy. [1]"""
MOST_RISE = 0.01
"""Rise of the exit speed from one wall to a thicker one, over the striking speed. [1]"""


def check_energy(
    prepared: PreparedCase, impact: Impact, outcome: Outcome, left: Exit | None
) -> tuple[ModelWarning, ...]:
    """Warn of a projectile that leaves with more energy than it had, or goes through a wall without losing any.

    Steps of a fixed length may gain energy, of which another warning tells.
    """
    if left is None or prepared.numerics.method != "adaptive":
        return ()
    initial = _energy(mass_properties(prepared.projectile), impact)
    most = initial * (1.0 + MOST_GAIN + ERROR_OF_TOLERANCE * prepared.numerics.relative_tolerance)
    if left.kinetic_energy > most:
        return (implausible(f"the projectile leaves with {left.kinetic_energy / initial:.3g} times its energy"),)
    thickness = prepared.target.thickness
    if (
        outcome is not Outcome.PERFORATED
        or thickness is None
        or left.kinetic_energy + _least_work(prepared, impact) <= most
    ):
        return ()
    return (implausible(f"the projectile passes {thickness:.4g} m of concrete with hardly any loss of energy"),)


def check_depth(prepared: PreparedCase, impact: Impact, depth: float) -> tuple[ModelWarning, ...]:
    """Warn of a head-on strike that goes deeper into a half-space than its energy takes it against S f'c alone."""
    if not _is_head_on(impact) or prepared.target.thickness is not None or prepared.numerics.method != "adaptive":
        return ()
    most = deepest_by_energy(prepared, impact)
    error = MOST_GAIN + ERROR_OF_TOLERANCE * prepared.numerics.relative_tolerance
    if depth <= (1.0 + error) * most + RAMP * prepared.projectile.diameter:
        return ()
    return (implausible(f"{depth:.4g} m is deeper than {most:.4g} m, where its energy is used up"),)


def deepest_by_energy(prepared: PreparedCase, impact: Impact) -> float:
    """Depth at which S f'c on the cross section has used up the energy, behind nose and crater. [m]"""
    crater = prepared.resistance.crater
    front = 0.0 if crater is None else crater.depth_diameters * prepared.projectile.diameter
    energy = _energy(mass_properties(prepared.projectile), impact)
    return energy / _static_force(prepared, impact) + prepared.projectile.nose_length + front


def check_walls(
    prepared: PreparedCase, impact: Impact, passed: Iterable[tuple[float, Exit]]
) -> tuple[ModelWarning, ...]:
    """Warn of walls perforated with more energy than there is, and of head-on exits faster from thicker walls.

    An oblique or turning projectile may leave a thicker wall faster, as it takes another way there.

    Parameters
    ----------
    passed
        Thickness of each perforated wall and how the projectile left it.
    """
    half_space = replace(prepared.target, thickness=None)
    sheared = plug_height(resistance=prepared.resistance, target=half_space, projectile=prepared.projectile)
    # The zone that each face weakens reaches as many radii deep as that which yields, here as if it did not resist.
    weakened = max(MARGIN, _plastic_ratio(prepared)) * prepared.projectile.diameter
    most = deepest_by_energy(prepared, impact) + weakened + sheared
    walls = sorted(passed, key=lambda each: each[0])
    if walls and walls[-1][0] > most:
        return (implausible(f"{walls[-1][0]:.4g} m are perforated, and {most:.4g} m use up its energy"),)
    rises = (after.speed - before.speed for (_, before), (_, after) in itertools.pairwise(walls))
    if _is_head_on(impact) and max(rises, default=0.0) > MOST_RISE * impact.velocity:
        return (implausible("the projectile leaves a thicker wall faster than a thinner one"),)
    return ()


def _is_head_on(impact: Impact) -> bool:
    return impact.oblique_angle == impact.angle_of_attack == impact.angular_velocity == 0.0


def _plastic_ratio(prepared: PreparedCase) -> float:
    law = prepared.resistance.free_surface
    return 0.0 if isinstance(law, NoFreeSurface) else law.plastic_ratio(prepared.target)


def _least_work(prepared: PreparedCase, impact: Impact) -> float:
    """Energy that a wall takes at least from what perforates it. [J]"""
    thickness, resistance = prepared.target.thickness, prepared.resistance
    crushed = resistance.crater is not None or resistance.rear_plug is not None
    if thickness is None or crushed or thickness < LEAST_WALL * prepared.projectile.diameter:
        return 0.0
    ratios = 1.0 + np.linspace(0.0, thickness / prepared.projectile.radius, 33)
    left = float(decay_factor(model=resistance.free_surface, target=prepared.target, radius_ratio=ratios).mean())
    return LEAST_WORK * left * _static_force(prepared, impact) * thickness


def _energy(properties: MassProperties, impact: Impact) -> float:
    spinning = properties.moment_of_inertia * impact.angular_velocity**2
    return 0.5 * (properties.mass * impact.velocity**2 + spinning)


def _static_force(prepared: PreparedCase, impact: Impact) -> float:
    """S f'c on the cross section. [N]"""
    strength = prepared.strength_factor_at(impact.oblique_angle) * prepared.target.compressive_strength
    return strength * math.pi * prepared.projectile.radius**2
