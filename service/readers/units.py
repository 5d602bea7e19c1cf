"""Quantities of files and their units, converted to SI once: metres, seconds, kilograms and radians."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
SPEED = {"m_s": 1.0, "km_s": 1e3, "mm_ms": 1.0, "mm_us": 1e3, "mm_s": 1e-3, "cm_us": 1e4, "ft_s": 0.3048}
MASS = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": 0.45359237}
ANGLE = {"rad": 1.0, "deg": math.pi / 180.0}
PURE = {"1": 1.0}

SPELLINGS = str.maketrans({"/": "_", "µ": "u", "μ": "u", "°": "deg", " ": None})
BRACKETED = re.compile(r"(?P<stem>.*?)\s*[\[(]\s*(?P<unit>[^\[\]()]*?)\s*[\])]$")


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that a column can hold.

    Parameters
    ----------
    name
        Name in flags and headers.
    units
        Factor to SI by unit, the SI unit first; None for text.
    also
        Other names in headers.
    required
        Whether every file must have a column of it.
    """

    name: str
    units: Mapping[str, float] | None
    also: tuple[str, ...] = ()
    required: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """All names."""
        return (self.name, *self.also)


class UnknownUnitError(ValueError):
    """A unit that is not known for a quantity."""

    def __init__(self, quantity: Quantity, unit: str) -> None:
        super().__init__(f"unknown unit {unit!r} of {quantity.name}, known are {', '.join(quantity.units or ['none'])}")


def spelled(unit: str) -> str:
    """Return a unit in the spelling of the tables above: m/s is m_s, µs is us."""
    return unit.translate(SPELLINGS).lower()


def factor_to_si(quantity: Quantity, unit: str) -> float:
    """Return the factor from a unit to SI.

    Raises
    ------
    UnknownUnitError
        If the unit is not known for the quantity.
    """
    try:
        return (quantity.units or {})[spelled(unit)]
    except KeyError:
        raise UnknownUnitError(quantity, unit) from None


def unit_in_header(quantity: Quantity, cell: str, *, named: bool) -> str | None:
    """Return the unit of a quantity in a header cell: "" without a unit, None if the cell is for another quantity.

    Parameters
    ----------
    cell
        A cell such as ``time_s``, ``time [ms]`` or ``Time``.
    named
        Whether the caller has assigned the cell to the quantity, whatever its name.

    Raises
    ------
    UnknownUnitError
        If the cell has a unit in brackets that is not known for the quantity.
    """
    bracketed = BRACKETED.fullmatch(cell.strip())
    stem = re.sub(r"\s+", "_", (bracketed["stem"] if bracketed else cell).strip()).lower()
    if named or stem in quantity.names:
        if bracketed and (not named or spelled(bracketed["unit"]) in (quantity.units or {})):
            factor_to_si(quantity, bracketed["unit"])
            return bracketed["unit"]
        return next((unit for unit in quantity.units or {} if named and stem.endswith(f"_{unit}")), "")
    matching = (unit for name in quantity.names for unit in quantity.units or {} if stem == f"{name}_{unit}")
    return next(matching, None)
