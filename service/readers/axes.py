"""Global axes of a finite element model: which of them is depth, and which way it points."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np

from service.readers.errors import FileError
from service.readers.readings import Readings
from solver.arrays import FloatArray

AXIS = re.compile(r"(?P<sign>[+-]?)(?P<letter>[xyz])")
TRANSLATIONS = ("depth_displacement", "lateral_displacement")


@dataclass(frozen=True, slots=True)
class Axis:
    """A global axis with a direction.

    Parameters
    ----------
    place
        0, 1, 2 for x, y, z.
    sign
        1 along it, -1 against it.
    """

    place: int
    sign: float

    @classmethod
    def named(cls, name: str) -> "Axis":
        """Return the axis of a name such as ``-z``.

        Raises
        ------
        ValueError
            If it is none.
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
        (n,)
    displacement
        (n, 3)
    rotation
        (n, 3); None if the file has none. [rad]
    lines
        Where each state was read; None for files without lines.
    """

    path: str | PathLike[str]
    time: FloatArray
    displacement: FloatArray
    rotation: FloatArray | None = None
    lines: Sequence[int] | None = None


def along(states: States, axes: Mapping[str, Axis]) -> Readings:
    """Return the motion along the axes asked for, in the units of the model.

    Raises
    ------
    FileError
        If no axis is given, depth and lateral are the same, or the file has no rotations.
    """
    if not axes:
        raise FileError(states.path, "LS-DYNA tells motions along x, y, z: say which is depth, lateral and rotation")
    given = [axes[name].place for name in TRANSLATIONS if name in axes]
    if len(set(given)) < len(given):
        raise FileError(states.path, "depth and lateral displacement cannot be along the same axis")
    if "rotation" in axes and states.rotation is None:
        raise FileError(states.path, "the file has no rotations: ask for displacements alone")
    values = {"time": states.time}
    for name, axis in axes.items():
        source = states.rotation if name == "rotation" else states.displacement
        if source is not None:
            values[name] = axis.sign * np.asarray(source)[:, axis.place] + 0.0
    return Readings(path=states.path, values=values, lines=states.lines)
