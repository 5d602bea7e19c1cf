"""States of a body in a finite element model, along its global axes, and the choice of axes for depth and lateral."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np

from service.readers.files import FileError, Readings
from solver.arrays import FloatArray

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
