"""Checks of answers against conservation of energy, which detect errors of the program.

They take no measurable time, and are made for every answer of the adaptive method. A failed check adds the warning
``implausible``.
"""

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
from solver.units import quantity
from solver.warnings import ModelWarning, implausible

# An exact solution gains no energy. With the default tolerances the error of the energy is smaller than this.
MOST_GAIN = 1e-3
"""Largest gain of kinetic energy relative to its initial value. [1]"""
# A motion has up to hundreds of steps, whose errors mostly cancel. Ten is arbitrary.
ERROR_OF_TOLERANCE = 10.0
"""Ratio of the largest error of the energy to the relative tolerance of a step. [1]"""
# On an oblique path both faces weaken the resistance, so the bound has to be far below 1. Its value is arbitrary.
LEAST_WORK = 0.05
"""Least energy lost in a wall, relative to (S f'c weakened by the rear face) × cross-section × thickness. [1]"""
# A thinner wall may lie wholly within the weakened zones of its two faces, and take hardly any energy.
LEAST_WALL = 0.5
"""Least thickness of a wall, relative to the diameter, for which the energy lost in it is checked. [1]"""
# The resistance is weaker between two faces, so walls thicker than the energy allows may be perforated. In 750 random
# strikes on usual concrete they were thicker by up to 2.2 diameters.
MARGIN = 4.0
"""Margin added to the greatest thickness that the energy suffices to perforate, relative to the diameter. [1]"""
# Below the ramp velocity only part of the static stress acts, so even a strike with hardly any energy penetrates a
# little.
RAMP = 0.01
"""Depth that may be reached beyond what the energy allows, relative to the diameter. [1]"""
# The exit speed has a large error near the perforation limit, where its derivative with respect to the thickness is
# infinite.
MOST_RISE = 0.01
"""Largest rise of the exit speed from one wall to a thicker one, relative to the striking speed. [1]"""


def check_energy(
    prepared: PreparedCase, impact: Impact, outcome: Outcome, left: Exit | None
) -> tuple[ModelWarning, ...]:
    """Check that a projectile has gained no energy, and has lost some in a wall that it perforates.

    The panel method is not checked: its fixed steps may gain energy, for which there is another warning.
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
    return (
        implausible(f"the projectile passes {quantity(thickness, 'm')} of concrete with hardly any loss of energy"),
    )


def check_depth(prepared: PreparedCase, impact: Impact, depth: float) -> tuple[ModelWarning, ...]:
    """Check that a head-on strike goes no deeper into a half-space than its energy allows if only S f'c resists."""
    if not _is_head_on(impact) or prepared.target.thickness is not None or prepared.numerics.method != "adaptive":
        return ()
    most = deepest_by_energy(prepared, impact)
    error = MOST_GAIN + ERROR_OF_TOLERANCE * prepared.numerics.relative_tolerance
    if depth <= (1.0 + error) * most + RAMP * prepared.projectile.diameter:
        return ()
    return (implausible(f"{quantity(depth, 'm')} is deeper than {quantity(most, 'm')}, where its energy is used up"),)


def deepest_by_energy(prepared: PreparedCase, impact: Impact) -> float:
    """Return the depth at which S f'c on the cross-section has used up the energy, plus nose and crater. [m]"""
    crater = prepared.resistance.crater
    front = 0.0 if crater is None else crater.depth_diameters * prepared.projectile.diameter
    energy = _energy(mass_properties(prepared.projectile), impact)
    return energy / _static_force(prepared, impact) + prepared.projectile.nose_length + front


def check_walls(
    prepared: PreparedCase, impact: Impact, passed: Iterable[tuple[float, Exit]]
) -> tuple[ModelWarning, ...]:
    """Check that the energy suffices for every perforated wall, and that projectiles leave thicker walls no faster.

    Only head-on strikes get the second check: an oblique or turning projectile takes another path in a thicker wall,
    and may leave it faster.

    Parameters
    ----------
    passed
        Thickness of each perforated wall [m], and the exit of the projectile.
    """
    half_space = replace(prepared.target, thickness=None)
    sheared = plug_height(resistance=prepared.resistance, target=half_space, projectile=prepared.projectile)
    # Each face weakens a zone as deep as the plastic zone around the body. Both zones count as if they had no
    # resistance.
    weakened = max(MARGIN, _plastic_ratio(prepared)) * prepared.projectile.diameter
    most = deepest_by_energy(prepared, impact) + weakened + sheared
    walls = sorted(passed, key=lambda each: each[0])
    if walls and walls[-1][0] > most:
        return (
            implausible(
                f"{quantity(walls[-1][0], 'm')} are perforated, although {quantity(most, 'm')} use up its energy"
            ),
        )
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
    """Return the least energy that a wall takes from a projectile that perforates it. [J]"""
    thickness, resistance = prepared.target.thickness, prepared.resistance
    crushed = resistance.crater is not None or resistance.rear_plug is not None
    if thickness is None or crushed or thickness < LEAST_WALL * prepared.projectile.diameter:
        return 0.0
    # The bound is only approximate, so 33 points give the mean of the decay over the thickness accurately enough.
    ratios = 1.0 + np.linspace(0.0, thickness / prepared.projectile.radius, 33)
    left = float(decay_factor(model=resistance.free_surface, target=prepared.target, radius_ratio=ratios).mean())
    return LEAST_WORK * left * _static_force(prepared, impact) * thickness


def _energy(properties: MassProperties, impact: Impact) -> float:
    spinning = properties.moment_of_inertia * impact.angular_velocity**2
    return 0.5 * (properties.mass * impact.velocity**2 + spinning)


def _static_force(prepared: PreparedCase, impact: Impact) -> float:
    """Return the force of S f'c on the cross-section, with S at the oblique angle of the strike. [N]"""
    strength = prepared.strength_factor_at(impact.oblique_angle) * prepared.target.compressive_strength
    return strength * math.pi * prepared.projectile.radius**2
