"""Errors of the solver, and checks of inputs, which name the invalid field and its bound.

    RicochetError
    ├── ParameterError      an input is outside its range, or of the wrong type
    └── IntegrationError    the motion could not be integrated
        └── StepLimitError  more steps than a run may take

Outcomes of a run or a search (embedded, no ricochet, ...) are results, not errors. The bounds in `BOUNDS` apply in
Python and in the HTTP contract alike. They are wide enough for any strike, and narrow enough to detect most wrong
units. The error for a number outside its bounds suggests the unit that was probably meant.
"""

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from functools import wraps
from inspect import getfullargspec, isfunction
from typing import Any, NamedTuple, TypeVar, get_args

from solver.units import AMOUNT_DIGITS, WHOLE_DIGITS, Amount, whole_number

Row = TypeVar("Row")


class RicochetError(Exception):
    """Base class of the errors about the inputs and the integration of a case."""


class ParameterError(RicochetError, ValueError):
    """Raised if an input is outside its range, or its type is not accepted.

    Parameters
    ----------
    field
        Dotted name of the input, such as ``projectile.length``.
    requirement
        Condition that the input must satisfy, with the bound and the value found. If there are `amounts`, it has ``{}``
        in place of each.
    amounts
        Quantities in the condition. They are formatted when the message is read, in the units that
        `solver.units.written_in` has set by then.
    """

    def __init__(self, field: str, requirement: str, *amounts: Amount) -> None:
        self.field = field
        self.amounts = amounts
        self._condition = requirement
        super().__init__(field, self.requirement)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.field, self._condition, *self.amounts), self.__dict__

    @property
    def requirement(self) -> str:
        """Condition that the input must satisfy, with the bound and the value found."""
        # A text without amounts may contain braces, for instance in a value that it quotes.
        return self._condition.format(*self.amounts) if self.amounts else self._condition

    def __str__(self) -> str:
        return f"{self.field}: {self.requirement}"

    def at(self, field: str, *, before: str = "", unit: str | None = None) -> "ParameterError":
        """Return the same error under the name by which the caller knows the input.

        Parameters
        ----------
        before
            Words before the condition.
        unit
            SI unit in which texts show the input, for the amounts without a unit.
        """
        if self.amounts:
            before = before.replace("{", "{{").replace("}", "}}")
        amounts = (each._replace(unit=unit) if each.unit is None else each for each in self.amounts)
        return ParameterError(field, before + self._condition, *amounts)


class IntegrationError(RicochetError):
    """Raised if a motion cannot be integrated, for instance because its state is no longer finite."""


class StepLimitError(IntegrationError):
    """Raised if an integration takes more steps than a run may take.

    Parameters
    ----------
    limit
        Largest number of steps of a run.
    time
        Time of the motion that these steps reached. [s]
    """

    def __init__(self, limit: int, time: float) -> None:
        super().__init__(limit, time)
        self.limit, self.time = limit, time

    def __str__(self) -> str:
        return f"more than {whole_number(self.limit)} steps, stopped at {self.time:g} s"


def plain(value: Any) -> Any:
    """Convert arrays, Series and DataArrays to lists, and NumPy scalars to Python numbers; keep other values."""
    return value.__array__().tolist() if hasattr(value, "__array__") else value


def rows_of(field: str, rows: Any, kind: type[Row]) -> list[Row]:
    """Convert a sequence of dataclass objects, or a DataFrame with a row for each object, to a list of objects.

    Parameters
    ----------
    rows
        Sequence of objects, or a DataFrame whose columns have the names of the fields.

    Raises
    ------
    ParameterError
        If a required column is missing, a column is unknown, or an item is of another type.
    """
    if hasattr(rows, "columns"):
        needed = [each.name for each in fields(kind) if each.default is MISSING]  # type: ignore[arg-type]
        others = [each.name for each in fields(kind) if each.default is not MISSING]  # type: ignore[arg-type]
        names = list(rows.columns)
        text = f"must have the columns {', '.join(needed)}, and may have {', '.join(others)}; got "
        require(set(needed) <= set(names) <= {*needed, *others}, field, text + ", ".join(map(str, names)))
        cells = [dict(zip(names, row, strict=True)) for row in zip(*(plain(rows[name]) for name in names), strict=True)]
        # NaN and NA mark a missing optional value. Neither is equal to itself.
        rows = [
            kind(**{name: value for name, value in row.items() if name in needed or (value == value) is True})  # noqa: PLR0124
            for row in cells
        ]
    found: list[Row] = list(plain(rows))
    for index, row in enumerate(found):
        require(isinstance(row, kind), f"{field}.{index}", f"must be a {kind.__name__}, got {type(row).__name__}")
    return found


def require(condition: bool, field: str, requirement: str, *amounts: Amount) -> None:
    """Raise a `ParameterError` with the other arguments unless `condition` holds."""
    if not condition:
        raise ParameterError(field, requirement, *amounts)


def require_number(field: str, value: object) -> float:
    """Return a Python or NumPy number as a float.

    Raises
    ------
    ParameterError
        If the value is anything else, such as a bool, a string or an array with at least one dimension.
    """
    if isinstance(value, float | int) and not isinstance(value, bool):
        return float(value)
    if hasattr(value, "__float__") and getattr(value, "ndim", None) == 0:
        return float(value)
    if hasattr(value, "__len__") and not isinstance(value, str):
        found = f"{type(value).__name__} of {len(value)}"
        raise ParameterError(
            field, f"must be one number, got {found}: simulate_many and critical_angle_many take many cases"
        )
    raise ParameterError(field, f"must be a number, got {value!r}")


def require_kind(field: str, value: object, union: object) -> None:
    """Check that a value is an instance of a class in a union.

    Raises
    ------
    ParameterError
        If the value is of another class. The message names the classes, and suggests an instance if the value is a
        class or its name.
    """
    kinds = get_args(union)
    if isinstance(value, kinds):
        return
    *names, last = (f"{kind.__name__}(...)" for kind in kinds)
    found = (
        value.__name__ if isinstance(value, type) else repr(value) if isinstance(value, str) else type(value).__name__
    )
    meant = [f"; give {kind.__name__}(...)" for kind in kinds if value is kind or value == kind.name]
    raise ParameterError(field, f"must be {', '.join(names)} or {last}, got {found}{''.join(meant)}")


def require_finite(field: str, value: float) -> None:
    """Raise `ParameterError` unless a value is a finite number."""
    require_number(field, value)
    require(math.isfinite(value), field, f"must be a finite number, got {value}")


def require_positive(field: str, value: float, unit: str | None = "") -> None:
    """Raise `ParameterError` unless a value is a finite number above zero; `unit` is passed to `Amount`."""
    require_number(field, value)
    amounts = Amount(0.0, unit), Amount(value, unit)
    require(math.isfinite(value) and value > 0.0, field, "must be greater than {}, got {}", *amounts)


def require_between(field: str, value: float, lower: float, upper: float) -> None:
    """Raise `ParameterError` unless a value is a number from `lower` to `upper`, both included."""
    require_number(field, value)
    require(
        math.isfinite(value) and lower <= value <= upper,
        field,
        "must be between {} and {}, got {}",
        *(Amount(each, "", WHOLE_DIGITS if isinstance(each, int) else AMOUNT_DIGITS) for each in (lower, upper, value)),
    )


class Bound(NamedTuple):
    """Range of a number with its unit, and the units in which it is often given by mistake."""

    lower: float
    """Lower end of the range, in the coherent SI unit."""
    upper: float
    """Upper end of the range, in the coherent SI unit."""
    unit: str
    """SI unit in which messages and plots show the quantity, such as ``mm``; empty for a ratio."""
    name: str
    """Name of the coherent unit in error messages."""
    mistaken: tuple[tuple[str, float], ...] = ()
    """Symbols of the units in which the number is often given by mistake, each with its factor to the coherent unit."""
    above: bool = False
    """True if the lower end is excluded."""
    below: bool = False
    """True if the upper end is excluded."""

    def holds(self, value: float) -> bool:
        """Return whether the value is in the range."""
        low = self.lower < value if self.above else self.lower <= value
        return low and (value < self.upper if self.below else value <= self.upper)


MILLIMETRES = (("mm", 1e-3), ("cm", 1e-2))
"""Units in which lengths are often given instead of metres, with their factors to metres."""
PRESSURES = (("MPa", 1e6), ("kPa", 1e3), ("GPa", 1e9))
"""Units in which strengths are often given instead of pascals, with their factors to pascals."""
# Each range includes all real strikes with a margin, and excludes most values in a wrong unit. The values are
# arbitrary.
BOUNDS: Mapping[str, Bound] = {
    "projectile.diameter": Bound(1e-3, 5.0, "mm", "metres", MILLIMETRES),
    "projectile.length": Bound(1e-3, 20.0, "mm", "metres", MILLIMETRES),
    "projectile.mass": Bound(1e-6, 1e7, "kg", "kilograms"),
    "projectile.center_of_gravity": Bound(1e-6, 20.0, "mm", "metres", MILLIMETRES, below=True),
    "projectile.moment_of_inertia": Bound(1e-15, 1e9, "kg m²", "kg m²"),
    "projectile.boat_tail.length": Bound(1e-6, 20.0, "mm", "metres", MILLIMETRES),
    "projectile.boat_tail.base_diameter": Bound(0.0, 5.0, "mm", "metres", MILLIMETRES),
    "projectile.inner_diameter": Bound(0.0, 5.0, "mm", "metres", MILLIMETRES, above=True),
    "projectile.yield_strength": Bound(1e6, 1e11, "MPa", "pascals", PRESSURES),
    "projectile.nose.caliber_radius_head": Bound(0.5, 100.0, "", "a ratio"),
    "projectile.nose.length_to_diameter": Bound(0.0, 20.0, "", "a ratio", above=True),
    "target.compressive_strength": Bound(1e5, 1e9, "MPa", "pascals", PRESSURES),
    "target.characteristic_strength": Bound(1e5, 1e9, "MPa", "pascals", PRESSURES),
    "target.density": Bound(100.0, 2e4, "kg/m³", "kg/m³", (("g/cm³", 1e3),)),
    "target.youngs_modulus": Bound(1e6, 1e12, "GPa", "pascals", (("GPa", 1e9), ("MPa", 1e6))),
    "target.poissons_ratio": Bound(0.0, 0.5, "", "a ratio"),
    "target.thickness": Bound(0.0, 1e3, "mm", "metres", MILLIMETRES, above=True),
    # Slabs of power plants have up to about 2 % of steel in each direction at each face. A wall with more than 10 %
    # cannot be cast.
    "target.reinforcement_ratio_percent": Bound(0.0, 10.0, "percent", "percent"),
    "shot.depth": Bound(1e-6, 100.0, "mm", "metres", MILLIMETRES),
    "impact.velocity": Bound(0.1, 1e4, "m/s", "m/s"),
    "impact.angular_velocity": Bound(-1e5, 1e5, "rad/s", "rad/s"),
    "flight.speed": Bound(0.0, 1e4, "m/s", "m/s", above=True),
    "flight.projected_area": Bound(1e-8, 100.0, "m²", "m²", (("mm²", 1e-6), ("cm²", 1e-4))),
    "flight.drag_coefficient": Bound(0.0, 10.0, "", "a ratio"),
    "flight.height": Bound(0.0, 1e4, "m", "metres", MILLIMETRES),
}
"""Bounds of inputs, by dotted name."""


def require_bounds(field: str, value: object, like: str = "") -> None:
    """Check that a value is a number within the bounds of a field.

    Parameters
    ----------
    field
        Name of the field in the error.
    like
        Key in `BOUNDS`, if it differs from `field`.

    Raises
    ------
    ParameterError
        If the value is not a number, or outside the bounds. The message states the bounds, and suggests the unit that
        was probably meant.
    """
    bound, number = BOUNDS[like or field], require_number(field, value)
    if bound.holds(number):
        return
    text = f"must be {'more than ' * bound.above}{{}} to {'less than ' * bound.below}{{}}, got {{}}"
    for other, factor in bound.mistaken:
        if bound.holds(number * factor):
            meant = f"{number:g}e6" if factor == 1e6 else f"{number * factor:.6g}"
            text += f"; give {bound.name}, {meant} for {number:g} {other}"
            break
    lower, upper, found = (Amount(each, bound.unit) for each in (bound.lower, bound.upper, number))
    raise ParameterError(field, text, lower._replace(bare=True), upper, found)


def require_one(field: str, value: object, kind: type) -> None:
    """Check that a value is a single object of a class, not a sequence of them.

    Raises
    ------
    ParameterError
        If the value is a sequence or of another class.
    """
    if not isinstance(value, kind):
        many = ": simulate_many and critical_angle_many take many cases" if hasattr(value, "__len__") else ""
        raise ParameterError(field, f"must be one {kind.__name__}, got {type(value).__name__}{many}")


def require_angle(field: str, value: object, *, below: bool) -> None:
    """Check that an angle is at most 90° to either side, or less than 90° if `below` is true. [rad]

    Raises
    ------
    ParameterError
        If the value is not a number, or the angle is larger. The message suggests radians for a number that looks like
        degrees.
    """
    angle = require_number(field, value)
    if abs(angle) < math.pi / 2.0 or (not below and abs(angle) <= math.pi / 2.0):
        return
    text = f"must be {'less than' if below else 'at most'} 90° from the normal, {math.pi / 2.0:.4g} rad, "
    text += f"got {angle:g} rad"
    if abs(angle) <= 90.0:
        text += f"; give radians, math.radians({angle:g}) for {angle:g}°"
    raise ParameterError(field, text)


def name_keywords(package: dict[str, Any]) -> None:
    """Make keyword-only functions and classes of a package list their keywords if called with positional arguments."""
    for name in package["__all__"]:
        public = package[name]
        own = int(isinstance(public, type))
        function = public.__init__ if own else public
        if not isfunction(function):
            continue
        arguments = getfullargspec(function)
        if len(arguments.args) > own or arguments.varargs or not arguments.kwonlyargs:
            continue
        checked = _listing_keywords(function, own, f"{name}() takes keywords only: {', '.join(arguments.kwonlyargs)}")
        if own:
            public.__init__ = checked
        else:  # pickle looks for a function in its own module
            package[name] = checked
            setattr(sys.modules[function.__module__], name, checked)


def _listing_keywords(function: Callable[..., Any], own: int, words: str) -> Callable[..., Any]:
    """Wrap a function so that a call with more than `own` positional arguments raises `TypeError` with `words`."""

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if len(args) > own:
            raise TypeError(words)
        return function(*args, **kwargs)

    return call
