"""Rules that every true answer keeps, looked at on every answer since they cost nothing: a fault of the code shows."""

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace

from solver.prepared import Exit, Outcome, PreparedCase
from solver.projectile import MassProperties, mass_properties
from solver.resistance import plug_height
from solver.strike import Impact
from solver.warnings import ModelWarning, implausible

MOST_GAIN = 1e-3
"""Gain of kinetic energy over its initial value: a true motion has none, and error control leaves less. [1]"""
LEAST_WORK = 0.01
"""Energy lost in a wall over S f'c times the cross section times the thickness. The decay at both faces leaves at least
eight times as much in a wall of `LEAST_WALL`. [1]"""
LEAST_WALL = 0.5
"""Thickness over the diameter from which a wall takes energy from whatever passes. [1]"""
MARGIN = 4.0
"""Thickness that holds beyond the depth that the energy allows, in diameters: what the weaker resistance between two
faces can add, up to 2.2 in 750 random strikes. [1]"""
MOST_RISE = 0.01
"""Rise of the exit speed from one wall to a thicker one, over the striking speed. [1]"""


def check_energy(
    prepared: PreparedCase, impact: Impact, outcome: Outcome, left: Exit | None
) -> tuple[ModelWarning, ...]:
    """Warn of a projectile that leaves with more energy than it had, or goes through a wall without losing any."""
    if left is None:
        return ()
    initial = _energy(mass_properties(prepared.projectile), impact)
    if left.kinetic_energy > (1.0 + MOST_GAIN) * initial and prepared.numerics.method == "adaptive":
        return (implausible(f"the projectile leaves with {left.kinetic_energy / initial:.3g} times its energy"),)
    thickness, resistance = prepared.target.thickness, prepared.resistance
    weakened = resistance.crater is not None or resistance.rear_plug is not None
    if outcome is not Outcome.PERFORATED or thickness is None or weakened:
        return ()
    if thickness < LEAST_WALL * prepared.projectile.diameter:
        return ()
    if initial - left.kinetic_energy >= LEAST_WORK * _static_force(prepared, impact) * thickness:
        return ()
    return (implausible(f"the projectile passes {thickness:.4g} m of concrete with hardly any loss of energy"),)


def check_depth(prepared: PreparedCase, impact: Impact, depth: float) -> tuple[ModelWarning, ...]:
    """Warn of a head-on strike that goes deeper into a half-space than its energy takes it against S f'c alone."""
    head_on = impact.oblique_angle == impact.angle_of_attack == impact.angular_velocity == 0.0
    if not head_on or prepared.target.thickness is not None:
        return ()
    most = deepest_by_energy(prepared, impact)
    if depth <= (1.0 + MOST_GAIN) * most:
        return ()
    return (implausible(f"{depth:.4g} m is deeper than {most:.4g} m, where its energy is used up"),)


def deepest_by_energy(prepared: PreparedCase, impact: Impact) -> float:
    """Depth at which S f'c on the cross section has used up the energy, behind nose and crater. [m]"""
    crater = prepared.resistance.crater
    front = 0.0 if crater is None else crater.depth_diameters * prepared.projectile.diameter
    energy = _energy(mass_properties(prepared.projectile), impact)
    return energy / _static_force(prepared, impact) + prepared.projectile.nose_length + front


def check_walls(
    prepared: PreparedCase, impact: Impact, thickness: float | None, passed: Iterable[tuple[float, Exit]]
) -> tuple[ModelWarning, ...]:
    """Warn of a least thickness that no energy explains, None if no wall holds, and of exits faster from thicker walls.

    Parameters
    ----------
    passed
        Thickness of each perforated wall and how the projectile left it.
    """
    half_space = replace(prepared.target, thickness=None)
    sheared = plug_height(resistance=prepared.resistance, target=half_space, projectile=prepared.projectile)
    most = deepest_by_energy(prepared, impact) + MARGIN * prepared.projectile.diameter + sheared
    if thickness is None:
        return (implausible("no wall holds the projectile, however thick"),)
    if thickness > most:
        return (implausible(f"{thickness:.4g} m is more than the {most:.4g} m in which its energy is used up"),)
    speeds = [left.speed for _, left in sorted(passed, key=lambda each: each[0])]
    if any(after > before + MOST_RISE * impact.velocity for before, after in itertools.pairwise(speeds)):
        return (implausible("the projectile leaves a thicker wall faster than a thinner one"),)
    return ()


def _energy(properties: MassProperties, impact: Impact) -> float:
    spinning = properties.moment_of_inertia * impact.angular_velocity**2
    return 0.5 * (properties.mass * impact.velocity**2 + spinning)


def _static_force(prepared: PreparedCase, impact: Impact) -> float:
    """S f'c on the cross section. [N]"""
    strength = prepared.strength_factor_at(impact.oblique_angle) * prepared.target.compressive_strength
    return strength * math.pi * prepared.projectile.radius**2
