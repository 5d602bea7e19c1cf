"""Bounds of the inputs, the same in Python and in the HTTP contract: wider than any strike, narrower than a wrong unit.

A number outside its bounds is refused with the unit it may have been meant in.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from solver.errors import ParameterError
from solver.validation import require_number


class Bound(NamedTuple):
    """Range of a number, both ends included unless said otherwise, and other units it is often given in."""

    lower: float
    upper: float
    unit: str
    name: str
    """Name of the unit in a sentence."""
    mistaken: tuple[tuple[str, float], ...] = ()
    """Other units with their factors."""
    above: bool = False
    """Whether the lower end itself is excluded."""
    below: bool = False
    """Whether the upper end itself is excluded."""

    def holds(self, value: float) -> bool:
        """Return whether the value is in the range."""
        low = self.lower < value if self.above else self.lower <= value
        return low and (value < self.upper if self.below else value <= self.upper)


MILLIMETRES = (("mm", 1e-3), ("cm", 1e-2))
PRESSURES = (("MPa", 1e6), ("kPa", 1e3), ("GPa", 1e9))
BOUNDS: Mapping[str, Bound] = {
    "projectile.diameter": Bound(1e-3, 5.0, "m", "metres", MILLIMETRES),
    "projectile.length": Bound(1e-3, 20.0, "m", "metres", MILLIMETRES),
    "projectile.mass": Bound(1e-6, 1e7, "kg", "kilograms"),
    "projectile.center_of_gravity": Bound(1e-6, 20.0, "m", "metres", MILLIMETRES, below=True),
    "projectile.moment_of_inertia": Bound(1e-15, 1e9, "kg m²", "kg m²"),
    "projectile.nose.caliber_radius_head": Bound(0.5, 100.0, "", "a ratio"),
    "projectile.nose.length_to_diameter": Bound(0.0, 20.0, "", "a ratio", above=True),
    "target.compressive_strength": Bound(1e5, 1e9, "Pa", "pascals", PRESSURES),
    "target.density": Bound(100.0, 2e4, "kg/m³", "kg/m³", (("g/cm³", 1e3),)),
    "target.youngs_modulus": Bound(1e6, 1e12, "Pa", "pascals", (("GPa", 1e9), ("MPa", 1e6))),
    "target.poissons_ratio": Bound(0.0, 0.5, "", "a ratio"),
    "target.thickness": Bound(0.0, 1e3, "m", "metres", MILLIMETRES, above=True),
    "impact.velocity": Bound(0.1, 1e4, "m/s", "m/s"),
    "impact.angular_velocity": Bound(-1e5, 1e5, "rad/s", "rad/s"),
}
"""By the dotted names of the solver."""


def require_bounds(field: str, value: object) -> None:
    """Refuse anything but a number within the bounds of a field.

    Raises
    ------
    ParameterError
        If it is not; it names the bounds, and the unit that the number may have been meant in.
    """
    bound, number = BOUNDS[field], require_number(field, value)
    if bound.holds(number):
        return
    unit = bound.unit and f" {bound.unit}"
    least = "more than " if bound.above else ""
    text = f"must be {least}{bound.lower:g} to {'less than ' * bound.below}{bound.upper:g}{unit}, got {number:g}{unit}"
    for other, factor in bound.mistaken:
        if bound.holds(number * factor):
            meant = f"{number:g}e6" if factor == 1e6 else f"{number * factor:.6g}"
            text += f"; give {bound.name}, {meant} for {number:g} {other}"
            break
    raise ParameterError(field, text)


def require_one(field: str, value: object, kind: type) -> None:
    """Refuse anything but one object of a class.

    Raises
    ------
    ParameterError
        If it is not.
    """
    if not isinstance(value, kind):
        many = ": simulate_many and critical_angle_many take many cases" if hasattr(value, "__len__") else ""
        raise ParameterError(field, f"must be one {kind.__name__}, got {type(value).__name__}{many}")


def require_angle(field: str, value: object, *, below: bool) -> None:
    """Refuse anything but an angle of less than 90° to either side, or of 90° at most.

    Raises
    ------
    ParameterError
        If it is not; it suggests radians for what looks like degrees.
    """
    angle = require_number(field, value)
    if abs(angle) < math.pi / 2.0 or (not below and abs(angle) <= math.pi / 2.0):
        return
    text = f"must be {'less than' if below else 'at most'} 90° from the normal, {math.pi / 2.0:.4g} rad, "
    text += f"got {angle:g} rad"
    if abs(angle) <= 90.0:
        text += f"; give radians, math.radians({angle:g}) for {angle:g}°"
    raise ParameterError(field, text)
