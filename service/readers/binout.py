"""LS-DYNA's binary binout: the rigid bodies of rbdout and the nodes of nodout, a folder for each state."""

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.readers.axes import States
from service.readers.dyna_text import chosen
from service.readers.errors import FileError
from service.readers.lsda import Lsda
from service.readers.text import read_bytes

STATE = re.compile(r"/(?P<database>rbdout|nodout)/d(?P<state>\d+)/time")
DISPLACEMENTS = {
    "rbdout": ("global_dx", "global_dy", "global_dz"),
    "nodout": ("x_displacement", "y_displacement", "z_displacement"),
}
ROTATIONS = {
    "rbdout": ("global_rdx", "global_rdy", "global_rdz"),
    "nodout": ("rx_displacement", "ry_displacement", "rz_displacement"),
}
BODIES = {"rbdout": "rigid body", "nodout": "node"}


@dataclass(frozen=True, slots=True)
class Folder:
    """A state in one of the files of a run."""

    file: Lsda
    path: str

    def read(self, name: str) -> NDArray[np.float64] | None:
        """Return the numbers of a variable, None if there is no such one."""
        return self.file.read(f"{self.path}/{name}")


def read_binout(path: str | Path, content: bytes, part: int | None, node: int | None) -> States:
    """Read the motion of one rigid body, or of one node if that is asked for.

    Raises
    ------
    FileError
        If it is not there, or the file is damaged.
    """
    files = [Lsda(path, content), *_continuations(path)]
    states: dict[str, list[tuple[int, Folder]]] = {"rbdout": [], "nodout": []}
    for file in files:
        for name in file.names():
            if found := STATE.fullmatch(name):
                folder = Folder(file, name.removesuffix("/time"))
                states[found["database"]].append((int(found["state"]), folder))
    database = "nodout" if node is not None or (part is None and not states["rbdout"]) else "rbdout"
    folders = [folder for _, folder in sorted(states[database], key=lambda state: state[0])]
    if not folders:
        raise FileError(path, f"the binout has no {database}; LS-DYNA may have put it into another file of the run")
    ids = files[0].read(f"/{database}/metadata/ids")
    if ids is None:
        raise FileError(path, f"the binout does not tell what its {database} is of")
    there = [int(one) for one in ids]
    place = there.index(chosen(path, BODIES[database], there, node if database == "nodout" else part))
    rotated = folders[0].read(ROTATIONS[database][0]) is not None
    return States(
        path=path,
        time=_column(folders, "time", 0),
        displacement=np.column_stack([_column(folders, name, place) for name in DISPLACEMENTS[database]]),
        rotation=np.column_stack([_column(folders, name, place) for name in ROTATIONS[database]]) if rotated else None,
    )


def _continuations(path: str | Path) -> Iterator[Lsda]:
    """Yield the files that LS-DYNA goes on in once one is full: binout0000%001 and so on."""
    for number in itertools.count(1):
        further = Path(f"{path}%{number:03d}")
        if not further.exists():
            return
        yield Lsda(further, read_bytes(further))


def _column(folders: Sequence[Folder], name: str, place: int) -> NDArray[np.float64]:
    """Return one variable of one body over all states."""
    column = []
    for row, folder in enumerate(folders):
        numbers = folder.read(name)
        if numbers is None or len(numbers) <= place:
            raise FileError(folder.file.path, f"state {row + 1}: {name} is missing: is the file cut short?")
        column.append(numbers[place])
    return np.array(column)
