"""Units and axes of finite element files, and their conversion to SI and the axes of the solver."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np

from service.readers.files import FileError, Readings
from solver.arrays import FloatArray

LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
SPEED = {"m_s": 1.0, "km_s": 1e3, "mm_ms": 1.0, "mm_us": 1e3, "mm_s": 1e-3, "cm_us": 1e4, "ft_s": 0.3048}
MASS = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": 0.45359237}
ANGLE = {"rad": 1.0, "deg": math.pi / 180.0}
ANGULAR_VELOCITY = {"rad_s": 1.0, "deg_s": math.pi / 180.0}
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


AXIS = re.compile(r"(?P<sign>[+-]?)(?P<letter>[xyz])")
TRANSLATIONS = ("depth_displacement", "lateral_displacement")


@dataclass(frozen=True, slots=True)
class Axis:
    """A global axis with a direction.

    Parameters
    ----------
    index
        0, 1, 2 for x, y, z.
    sign
        1 along the axis, -1 against it.
    """

    index: int
    sign: float

    @classmethod
    def named(cls, name: str) -> "Axis":
        """Return the axis of a name such as ``-z``.

        Raises
        ------
        ValueError
            If the name is not an axis.
        """
        match = AXIS.fullmatch(name.strip().lower())
        if match is None:
            raise ValueError(f"must be x, y or z, with a minus sign for the other direction, got {name!r}")
        return cls("xyz".index(match["letter"]), -1.0 if match["sign"] == "-" else 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class States:
    """Motion of a body along the global axes, state by state, in the units of the model.

    Parameters
    ----------
    time
        (n,) Times.
    displacement
        (n, 3) Displacements.
    rotation
        (n, 3) Rotations; None if the file has none. [rad]
    lines
        Line of each state; None for binary files.
    """

    path: str | PathLike[str]
    time: FloatArray
    displacement: FloatArray
    rotation: FloatArray | None = None
    lines: Sequence[int] | None = None


def along(states: States, axes: Mapping[str, Axis]) -> Readings:
    """Return the motion along the given axes, in the units of the model.

    Raises
    ------
    FileError
        If no axis is given, depth and lateral are the same, or the file has no rotations.
    """
    if not axes:
        raise FileError(states.path, "the motion is along x, y, z: name the axes of depth, lateral and rotation")
    given = [axes[name].index for name in TRANSLATIONS if name in axes]
    if len(set(given)) < len(given):
        raise FileError(states.path, "depth and lateral displacement cannot be along the same axis")
    if "rotation" in axes and states.rotation is None:
        raise FileError(states.path, "the file has no rotations: leave out the axis of rotation")
    values = {"time": states.time}
    for name, axis in axes.items():
        source = states.rotation if name == "rotation" else states.displacement
        if source is not None:
            values[name] = axis.sign * np.asarray(source)[:, axis.index] + 0.0
    return Readings(path=states.path, values=values, lines=states.lines)


def select(path: str | PathLike[str], kind: str, ids: Sequence[int], wanted: int | None) -> int:
    """Return the id of the body to read: the wanted one, or the only one.

    Raises
    ------
    FileError
        If the wanted body is missing, or there are several and none is wanted.
    """
    listed = ", ".join(str(one) for one in ids[:20]) + (", ..." if len(ids) > 20 else "")
    if wanted is None:
        if len(ids) == 1:
            return ids[0]
        raise FileError(path, f"name the {kind} to read, there are: {listed or 'none'}")
    if wanted not in ids:
        raise FileError(path, f"there is no {kind} {wanted}, there are: {listed or 'none'}")
    return wanted
