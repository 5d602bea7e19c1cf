"""LS-DYNA's binary binout: the rigid bodies of rbdout and the nodes of nodout, a folder for each state.

Its container is LSDA: variables in folders, listed in tables of symbols. A file begins with eight bytes: the length of
this header, the widths of a length, an offset, a command and a type, and the byte order, 1 for little-endian. Records
follow, each a length, a command and content. The first record gives the offset of the first table of symbols; each
table ends with the offset of the next, 0 in the last. A table changes folders and lists variables by type, offset and
length; the offset is that of the record with the numbers.
"""

import itertools
import posixpath
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from service.readers.files import FileError, read_bytes
from service.readers.units import States, select

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

CHANGE_FOLDER, DATA, VARIABLE, TABLE, TABLE_END, FIRST_TABLE = 2, 3, 4, 5, 6, 7
HEADER_BYTES = 8
TYPES: Mapping[int, str] = {
    1: "i1", 2: "i2", 3: "i4", 4: "i8", 5: "u1", 6: "u2", 7: "u4", 8: "u8", 9: "f4", 10: "f8"
}  # fmt: skip


def is_binout(content: bytes) -> bool:
    """Return whether a file begins with the header of a binout."""
    return (
        len(content) > HEADER_BYTES
        and content[0] >= HEADER_BYTES
        and all(size in (1, 2, 4, 8) for size in content[1:5])
        and content[5] in (0, 1)
    )


def read_binout(path: str | Path, content: bytes, part: int | None, node: int | None) -> States:
    """Read the motion of one rigid body, or of one node if its id is given.

    Raises
    ------
    FileError
        If the body is missing, or the file is damaged.
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
        raise FileError(path, f"the binout has no {database}; LS-DYNA may have written it to another file of the run")
    ids = files[0].read(f"/{database}/metadata/ids")
    if ids is None:
        raise FileError(path, f"the binout has no ids for its {database}")
    known = [int(each) for each in ids]
    column = known.index(select(path, BODIES[database], known, node if database == "nodout" else part))
    rotated = folders[0].file.read(f"{folders[0].path}/{ROTATIONS[database][0]}") is not None
    return States(
        path=path,
        time=_over_states(folders, "time", 0),
        displacement=np.column_stack([_over_states(folders, name, column) for name in DISPLACEMENTS[database]]),
        rotation=np.column_stack([_over_states(folders, name, column) for name in ROTATIONS[database]])
        if rotated
        else None,
    )


def _continuations(path: str | Path) -> Iterator["Lsda"]:
    """Yield the files in which LS-DYNA continues when one is full: binout0000%001 and so on."""
    for number in itertools.count(1):
        further = Path(f"{path}%{number:03d}")
        if not further.exists():
            return
        yield Lsda(further, read_bytes(further))


def _over_states(folders: Sequence["Folder"], name: str, column: int) -> NDArray[np.float64]:
    """Return one variable of one body over all states."""
    values = []
    for row, folder in enumerate(folders):
        numbers = folder.file.read(f"{folder.path}/{name}")
        if numbers is None or len(numbers) <= column:
            raise FileError(folder.file.path, f"state {row + 1}: {name} is missing: is the file cut short?")
        values.append(numbers[column])
    return np.array(values)


@dataclass(frozen=True, slots=True)
class Folder:
    """A state in one of the files of a run."""

    file: "Lsda"
    path: str


@dataclass(frozen=True, slots=True)
class Variable:
    """Type and position of the numbers of a variable."""

    dtype: np.dtype[Any]
    start: int
    count: int


class Lsda:
    """The variables of an LSDA file.

    Parameters
    ----------
    content
        The whole file.

    Raises
    ------
    FileError
        If the file is damaged or cut short.
    """

    def __init__(self, path: str | Path, content: bytes) -> None:
        self.path = path
        self._content = content
        self._length, self._offset, self._command, self._type = content[1:5]
        self._order: Literal["little", "big"] = "little" if content[5] else "big"
        self._variables: dict[str, Variable] = {}
        self._read_tables()

    def names(self) -> Iterator[str]:
        """Yield the paths of all variables."""
        yield from self._variables

    def read(self, name: str) -> NDArray[np.float64] | None:
        """Return the numbers of a variable; None if there is no such variable."""
        variable = self._variables.get(name)
        if variable is None:
            return None
        end = variable.start + variable.count * variable.dtype.itemsize
        if end > len(self._content):
            raise self._cut_short(variable.start)
        numbers = np.frombuffer(self._content, variable.dtype, variable.count, variable.start)
        return numbers.astype(np.float64)

    def _read_tables(self) -> None:
        command, position, _ = self._record(self._content[0])
        if command != FIRST_TABLE:
            raise FileError(self.path, "the binout has no table of symbols")
        seen = set()
        while table := self._integer(position, self._offset):
            if table in seen:
                raise FileError(self.path, "the binout is damaged: its tables of symbols form a cycle")
            seen.add(table)
            position = self._read_table(table)

    def _read_table(self, position: int) -> int:
        """Read one table; return the position of the next table's offset."""
        command, position, _ = self._record(position)
        if command != TABLE:
            raise FileError(self.path, f"the binout is damaged: no table of symbols at byte {position}")
        folder = "/"
        while True:
            command, start, end = self._record(position)
            if command == TABLE_END:
                return start
            if command == CHANGE_FOLDER:
                folder = posixpath.normpath(posixpath.join(folder, self._text(start, end)))
            elif command == VARIABLE:
                name_end = end - self._type - self._offset - self._length
                name = self._text(start, name_end)
                self._add(posixpath.join(folder, name), name, name_end)
            position = end

    def _add(self, path: str, name: str, position: int) -> None:
        kind = self._integer(position, self._type)
        if kind not in TYPES:
            return  # a link to another folder
        offset = self._integer(position + self._type, self._offset)
        count = self._integer(position + self._type + self._offset, self._length)
        command, start, end = self._record(offset)
        if command != DATA:
            raise FileError(self.path, f"the binout is damaged: {path} is not at byte {offset}")
        start += self._type + 1 + len(name.encode())
        dtype = np.dtype(TYPES[kind]).newbyteorder("<" if self._order == "little" else ">")
        if count * dtype.itemsize > end - start:
            raise FileError(self.path, f"the binout is damaged: {path} is longer than its record")
        self._variables[path] = Variable(dtype, start, count)

    def _record(self, position: int) -> tuple[int, int, int]:
        """Return the command of a record, and the start and end of its content."""
        length = self._integer(position, self._length)
        start = position + self._length + self._command
        end = position + length
        command = self._integer(position + self._length, self._command)
        if command not in (TABLE, TABLE_END) and end < start:
            raise FileError(self.path, f"the binout is damaged at byte {position}")
        return command, start, end

    def _integer(self, position: int, width: int) -> int:
        if not 0 <= position <= len(self._content) - width:
            raise self._cut_short(position)
        return int.from_bytes(self._content[position : position + width], self._order)

    def _text(self, start: int, end: int) -> str:
        if end > len(self._content) or end < start:
            raise self._cut_short(start)
        return self._content[start:end].decode("latin-1")

    def _cut_short(self, position: int) -> FileError:
        return FileError(
            self.path, f"the binout is cut short: it ends at byte {len(self._content)}, but byte {position} is needed"
        )
