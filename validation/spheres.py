"""Steel spheres on concrete slabs: depth, scabbing and perforation by the model and by the formulas."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

from scipy.optimize import brentq

from solver import (
    Crater,
    Impact,
    Projectile,
    PublishedTests,
    Resistance,
    ShearPlug,
    Sphere,
    Target,
    formulas,
    limit_velocity,
    simulate,
)
from solver.formulas import Limit

SPHERE: Final = Projectile(nose=Sphere(), diameter=0.0206, length=0.0206, mass=0.0359)
DEPTHS: Final[Mapping[float, tuple[float, ...]]] = {29.7e6: (0.052, 0.054), 55.8e6: (0.067, 0.069)}
"""Printed depths of four shots, by strength of the concrete. Only the range of their speeds is known. [Pa, m]"""
VELOCITIES: Final = (350.0, 1283.0)
"""Lowest and highest speed in the series. [m/s]"""
SCABBED: Final = (859.0, 925.0)
"""Highest speed at which a slab of 140 mm and 29.7 MPa did not scab, and lowest at which it did. [m/s]"""
SCABBED_SLAB: Final = 0.14
THIN_SLAB: Final = 0.07
"""Thickness of the thin slab. [m]"""
WEAK: Final = 29.7e6
LAW: Final = Resistance(strength_factor=PublishedTests())
CRATERED: Final = replace(LAW, crater=Crater())
WALLS: Final[Mapping[str, Resistance]] = {
    "alone": LAW,
    "with a plug": replace(LAW, rear_plug=ShearPlug()),
    "with a plug and a crater": replace(CRATERED, rear_plug=ShearPlug()),
}
FASTEST: Final = 5000.0
"""Upper end of the search for a speed. [m/s]"""


def concrete(strength: float, thickness: float | None = None) -> Target:
    """Return concrete of this strength [Pa] with an assumed density; without a thickness [m] it is a half-space."""
    return Target(compressive_strength=strength, density=2300.0, thickness=thickness)


def model_depth(strength: float, velocity: float, resistance: Resistance) -> float:
    """Return the depth of the sphere in a half-space, by the model. [m]"""
    impact = Impact(velocity=velocity, oblique_angle=0.0)
    run = simulate(
        projectile=SPHERE, target=concrete(strength), impact=impact, resistance=resistance, sample_interval=None
    )
    return run.maximum_depth or 0.0  # It is not None, because a half-space is not perforated.


def formula_values(strength: float, velocity: float, limit: Limit) -> Mapping[str, float]:
    """Return the value of each formula within its range, by name. [m]"""
    impact = Impact(velocity=velocity, oblique_angle=0.0)
    found = formulas(projectile=SPHERE, target=concrete(strength), impact=impact)
    return {each.formula: value for each in found if each.in_range and (value := getattr(each, limit)) is not None}


def speed_at(value: Callable[[float], float], wanted: float) -> float:
    """Return the speed at which an increasing depth or thickness has the wanted value. [m/s]"""
    return float(brentq(lambda velocity: value(velocity) - wanted, 50.0, FASTEST, xtol=0.1))


def needed_speeds(strength: float, resistance: Resistance) -> Sequence[float]:
    """Return the speeds at which the model gives the measured depth of each shot. [m/s]"""
    return [speed_at(lambda v: model_depth(strength, v, resistance), depth) for depth in DEPTHS[strength]]


def formula_speeds(strength: float, thickness: float, limit: Limit) -> Mapping[str, float]:
    """Return the speed above which a formula requires a thicker slab, for each formula in range. [m/s]"""
    names = formula_values(strength, sum(SCABBED) / 2.0, limit)
    return {
        name: speed_at(lambda v, name=name: _value(name, strength, v, limit), thickness)  # type: ignore[misc]
        for name in names
    }


def _value(name: str, strength: float, velocity: float, limit: Limit) -> float:
    """Return the value of one formula, inside or outside its range. [m]"""
    impact = Impact(velocity=velocity, oblique_angle=0.0)
    found = {each.formula: each for each in formulas(projectile=SPHERE, target=concrete(strength), impact=impact)}
    return float(getattr(found[name], limit))


def wall_speeds(strength: float) -> Mapping[str, float | None]:
    """Return the limit speed of the thin slab by each model of the wall; None if there is none. [m/s]"""
    target = concrete(strength, THIN_SLAB)
    return {
        name: limit_velocity(projectile=SPHERE, target=target, oblique_angle=0.0, resistance=resistance).value
        for name, resistance in WALLS.items()
    }


def spread(values: Sequence[float], factor: float = 1.0) -> str:
    """Return the range of some values, times a factor, as text."""
    return f"{factor * min(values):.0f} to {factor * max(values):.0f}"


def results() -> str:
    """Return the results of tests, model and formulas as text."""
    parts = []
    for strength, depths in DEPTHS.items():
        slow, fast = ([*formula_values(strength, v, "penetration_depth").values()] for v in VELOCITIES)
        ends = [1e3 * model_depth(strength, v, LAW) for v in VELOCITIES]
        needed, cratered = (spread(needed_speeds(strength, each)) for each in (LAW, CRATERED))
        parts.append(
            f"{strength / 1e6:g} MPa: {1e3 * min(depths):.0f} and {1e3 * max(depths):.0f} mm; the model has "
            f"{ends[0]:.0f} mm at {VELOCITIES[0]:g} m/s and {ends[1]:.0f} mm at {VELOCITIES[1]:g} m/s, formulas "
            f"{spread(slow, 1e3)} and {spread(fast, 1e3)} mm; such depths take the model {needed} m/s, "
            f"with a crater {cratered} m/s"
        )
    scabbing = ", ".join(f"{n} {v:.0f}" for n, v in formula_speeds(WEAK, SCABBED_SLAB, "scabbing_thickness").items())
    through = [*formula_speeds(WEAK, THIN_SLAB, "perforation_thickness").values()]
    walls = ", ".join("none" if v is None else f"{v:.0f} {name}" for name, v in wall_speeds(WEAK).items())
    parts.append(
        f"140 mm of 29.7 MPa scab between {SCABBED[0]:g} and {SCABBED[1]:g} m/s, by formulas from {scabbing} m/s; "
        f"70 mm are perforated from {spread(through)} m/s by formulas, by the model from {walls} m/s"
    )
    return "; ".join(parts)
