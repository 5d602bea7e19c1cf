"""Units of quantities in texts: SI or US customary.

The solver computes in SI. Code that composes a text passes each value with the SI unit in which it should appear, such
as ``mm`` for a thickness. The functions of this module format the value in that unit or in its US counterpart,
depending on the system that `written_in` has set.

Where no system is set, the message of an error shows numbers in the coherent units in which the inputs were given, such
as m. An error therefore carries its quantities as `Amount`, and they are formatted when its message is read.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from enum import StrEnum
from typing import NamedTuple


class UnitSystem(StrEnum):
    """System of units in texts."""

    SI = "si"
    US = "us"


class Unit(NamedTuple):
    """Unit in which texts show a quantity."""

    symbol: str
    """Symbol that follows the number."""
    factor: float
    """Factor from a value in coherent SI units (m, kg, s, N, Pa) to a value in this unit. [1]"""
    decimals: int = 0
    """Decimals that resolve a quantity about as finely as whole SI units; -2 rounds to hundreds. [1]"""


INCH, FOOT, POUND, POUND_FORCE = 0.0254, 0.3048, 0.45359237, 4.4482216152605
"""US customary units in SI units. [m, m, kg, N]"""
PSI = POUND_FORCE / INCH**2
"""One pound-force per square inch. [Pa]"""
SI_UNITS: Mapping[str, Unit] = {
    "m": Unit("m", 1.0),
    "mm": Unit("mm", 1e3),
    "m/s": Unit("m/s", 1.0),
    "kg": Unit("kg", 1.0),
    "Pa": Unit("Pa", 1.0),
    "MPa": Unit("MPa", 1e-6),
    "GPa": Unit("GPa", 1e-9),
    "kg/m³": Unit("kg/m³", 1.0),
    "kg m²": Unit("kg m²", 1.0),
    "ms": Unit("ms", 1e3),
    "%": Unit("%", 100.0),
    "percent": Unit("%", 1.0),
}
"""SI units by symbol; any other symbol is shown as it is, with a factor of 1."""
US_UNITS: Mapping[str, Unit] = {
    "m": Unit("ft", 1.0 / FOOT),
    "mm": Unit("in", 1.0 / INCH, 1),
    "m/s": Unit("ft/s", 1.0 / FOOT),
    "kg": Unit("lb", 1.0 / POUND),
    "Pa": Unit("psi", 1.0 / PSI),
    "MPa": Unit("psi", 1.0 / PSI, -2),
    "GPa": Unit("ksi", 1e-3 / PSI, -2),
    "kg/m³": Unit("lb/ft³", FOOT**3 / POUND),
    "kg m²": Unit("lb ft²", 1.0 / (POUND * FOOT**2)),
}
"""US customary units by the SI unit that they replace; other units, such as degrees, are common to both systems."""
# Conversion turns round values into long fractions, and four digits exceed the precision of any result.
CONVERTED_DIGITS = 4
"""Largest number of significant digits of a converted number in a text. [1]"""

# Four digits are read at a glance, and a comma among them may be taken for a decimal comma, as in 1,170 mm.
GROUPED_FROM = 5
"""Least number of digits before the decimal point at which commas separate thousands. [1]"""
COHERENT: Mapping[str, str] = {"mm": "m", "MPa": "Pa", "GPa": "Pa", "ms": "s", "%": ""}
"""Coherent SI units, in which numbers are given, by the units in which texts show the quantities."""
AMOUNT_DIGITS, WHOLE_DIGITS = 6, 16
"""Significant digits of numbers in the message of an error: enough to see on which side of a bound a number is, and
enough for all digits of a whole number. [1]"""

_system: ContextVar[UnitSystem | None] = ContextVar("unit_system", default=None)


@contextmanager
def written_in(system: UnitSystem | str | None) -> Iterator[None]:
    """Use a system of units for the quantities in all texts that are composed within the block.

    Parameters
    ----------
    system
        None stands for no choice, as outside of any context: texts are in SI, and messages of errors have the coherent
        units of the inputs.

    Examples
    --------
    >>> with written_in("us"):
    ...     print(quantity(0.3, "mm"))
    11.81 in
    """
    token = _system.set(None if system is None else UnitSystem(system))
    try:
        yield
    finally:
        _system.reset(token)


def system_in_use() -> UnitSystem:
    """Return the system of units in which texts are written."""
    return _system.get() or UnitSystem.SI


def shown_unit(unit: str) -> Unit:
    """Return the unit in use for quantities with the SI unit `unit`."""
    found = US_UNITS.get(unit) if _system.get() is UnitSystem.US else None
    return found or SI_UNITS.get(unit) or Unit(unit, 1.0)


def symbol(unit: str) -> str:
    """Return the symbol of the unit in use for quantities with the SI unit `unit`."""
    return shown_unit(unit).symbol


def number(value: float, unit: str, digits: int = 4, *, converted_digits: int = CONVERTED_DIGITS) -> str:
    """Format a quantity without its unit, to significant digits; from 1e-4 up to ten million without an exponent.

    Parameters
    ----------
    value
        Value in coherent SI units, such as m or Pa.
    unit
        SI unit in which the value should appear, such as ``mm``.
    digits
        Number of significant digits in SI.
    converted_digits
        Largest number of significant digits in other units.
    """
    if unit in US_UNITS and _system.get() is UnitSystem.US:
        digits = min(digits, converted_digits)
    return _grouped(_without_exponent(f"{value * shown_unit(unit).factor:.{digits}g}"))


def whole_number(value: int) -> str:
    """Format a whole number, such as a number of cases, with all its digits."""
    return _grouped(f"{value}")


def fixed(value: float, unit: str, decimals: int = 0) -> str:
    """Format a quantity without its unit, with `decimals` decimals in SI and about the same resolution in US units."""
    unit_in_use = shown_unit(unit)
    return _with_decimals(value * unit_in_use.factor, decimals + unit_in_use.decimals)


def rounded(value: float, unit: str, direction: Callable[[float], int], times: float = 1.0) -> str:
    """Format a quantity without its unit, rounded up or down to a whole SI unit or to a similar step in US units.

    Parameters
    ----------
    direction
        `math.ceil` or `math.floor`. An excess of a millionth of a step counts as rounding error.
    times
        Factor on the quantity, such as a safety margin. [1]
    """
    factor, decimals = shown_unit(unit).factor, shown_unit(unit).decimals
    steps = value * factor * times * 10.0**decimals
    slack = -1e-6 if direction is math.ceil else 1e-6
    return _with_decimals(direction(steps + slack) / 10.0**decimals, decimals)


def quantity(value: float, unit: str, digits: int = 4) -> str:
    """Format a quantity with its unit; arguments are as for `number`."""
    return with_symbol(number(value, unit, digits), unit)


def interval(lower: float, upper: float, unit: str) -> str:
    """Format two quantities with their common unit, as in ``473 to 629 mm``."""
    return with_symbol(" to ".join(number(each, unit) for each in (lower, upper)), unit)


def with_symbol(text: str, unit: str) -> str:
    """Append the symbol of the unit in use for the SI unit `unit` to formatted numbers."""
    found = symbol(unit)
    return f"{text}{found}" if found in ("", "°") else f"{text} {found}"


class Amount(NamedTuple):
    """Quantity in the message of an error.

    Its text is in the coherent SI unit of the input, or in the unit of other texts where `written_in` has set a system.

    Examples
    --------
    >>> str(Amount(0.53, "mm"))
    '0.53 m'
    >>> with written_in("si"):
    ...     str(Amount(0.53, "mm"))
    '530 mm'
    """

    value: float
    """Value in coherent SI units."""
    unit: str | None
    """SI unit in which other texts show the quantity, such as ``mm``; None if it is that of an unknown input."""
    digits: int = AMOUNT_DIGITS
    """Significant digits. [1]"""
    bare: bool = False
    """True if the text has no unit, since another amount with the same unit follows."""

    def __str__(self) -> str:
        unit = self.unit or ""
        if _system.get() is None:
            unit = COHERENT.get(unit, unit)
        text = number(self.value, unit, self.digits, converted_digits=AMOUNT_DIGITS)
        return text if self.bare else with_symbol(text, unit)


def _with_decimals(shown: float, decimals: int) -> str:
    return _grouped(f"{round(shown, decimals) + 0.0:.{max(decimals, 0)}f}")


def _grouped(text: str) -> str:
    """Put commas between the thousands of a number with five digits or more before its decimal point."""
    integer, point, decimals = text.partition(".")
    digits = integer.removeprefix("-")
    if len(digits) < GROUPED_FROM or not digits.isdecimal():
        return text
    return f"{int(integer):,}{point}{decimals}"


def _without_exponent(text: str) -> str:
    """Write out numbers with exponents from 0 to 6; remove the padding of other exponents, and the sign of zero."""
    mantissa, exponent, power = text.partition("e")
    if exponent and 0 <= int(power) <= 6:
        text = f"{float(text):.0f}"
    elif exponent:
        text = f"{mantissa}e{int(power)}"
    return text.removeprefix("-") if not text.strip("-0.") else text
