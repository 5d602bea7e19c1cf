"""LSDA, the container of LS-DYNA's binary binout: variables in folders, found by a table of symbols.

A file begins with eight bytes: the length of this header, the widths of a length, an offset, a command and a type, and
the byte order, 1 for the little end first. All that follows are records: length, command and content. The first one
gives the offset of the first table of symbols; each table ends with the offset of the next, 0 at the last. A table
changes folders and lists variables by type, offset and length; the offset is that of the record with the numbers.
"""

import posixpath
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from service.readers.errors import FileError

CHANGE_FOLDER, DATA, VARIABLE, TABLE, TABLE_END, FIRST_TABLE = 2, 3, 4, 5, 6, 7
HEADER = 8
TYPES: Mapping[int, str] = {
    1: "i1", 2: "i2", 3: "i4", 4: "i8", 5: "u1", 6: "u2", 7: "u4", 8: "u8", 9: "f4", 10: "f8"
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Variable:
    """Where the numbers of a variable are."""

    dtype: np.dtype[Any]
    start: int
    count: int


class Lsda:
    """The variables of a file.

    Parameters
    ----------
    content
        Of the whole file.

    Raises
    ------
    FileError
        If it is damaged or cut short.
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
        """Return the numbers of a variable, None if there is no such one."""
        variable = self._variables.get(name)
        if variable is None:
            return None
        end = variable.start + variable.count * variable.dtype.itemsize
        if end > len(self._content):
            raise self._cut_short(variable.start)
        numbers = np.frombuffer(self._content, variable.dtype, variable.count, variable.start)
        return numbers.astype(np.float64)

    def _read_tables(self) -> None:
        place = self._content[0]
        command, place, _ = self._record(place)
        if command != FIRST_TABLE:
            raise FileError(self.path, "the binout has no table of symbols")
        seen = set()
        while table := self._integer(place, self._offset):
            if table in seen:
                raise FileError(self.path, "the binout is damaged: its tables of symbols lead in a circle")
            seen.add(table)
            place = self._read_table(table)

    def _read_table(self, place: int) -> int:
        """Read one table; return where the offset of the next one stands."""
        command, place, _ = self._record(place)
        if command != TABLE:
            raise FileError(self.path, f"the binout is damaged: no table of symbols at byte {place}")
        folder = "/"
        while True:
            command, start, end = self._record(place)
            if command == TABLE_END:
                return start
            if command == CHANGE_FOLDER:
                folder = posixpath.normpath(posixpath.join(folder, self._text(start, end)))
            elif command == VARIABLE:
                name_end = end - self._type - self._offset - self._length
                name = self._text(start, name_end)
                self._add(posixpath.join(folder, name), name, name_end)
            place = end

    def _add(self, path: str, name: str, place: int) -> None:
        kind = self._integer(place, self._type)
        if kind not in TYPES:
            return  # a link to another folder
        offset = self._integer(place + self._type, self._offset)
        count = self._integer(place + self._type + self._offset, self._length)
        command, start, end = self._record(offset)
        if command != DATA:
            raise FileError(self.path, f"the binout is damaged: {path} is not at byte {offset}")
        start += self._type + 1 + len(name.encode())
        dtype = np.dtype(TYPES[kind]).newbyteorder("<" if self._order == "little" else ">")
        if count * dtype.itemsize > end - start:
            raise FileError(self.path, f"the binout is damaged: {path} is longer than its record")
        self._variables[path] = Variable(dtype, start, count)

    def _record(self, place: int) -> tuple[int, int, int]:
        """Return the command of a record, and where its content begins and ends."""
        length = self._integer(place, self._length)
        start = place + self._length + self._command
        end = place + length
        command = self._integer(place + self._length, self._command)
        if command not in (TABLE, TABLE_END) and end < start:
            raise FileError(self.path, f"the binout is damaged at byte {place}")
        return command, start, end

    def _integer(self, place: int, width: int) -> int:
        if not 0 <= place <= len(self._content) - width:
            raise self._cut_short(place)
        return int.from_bytes(self._content[place : place + width], self._order)

    def _text(self, start: int, end: int) -> str:
        if end > len(self._content) or end < start:
            raise self._cut_short(start)
        return self._content[start:end].decode("latin-1")

    def _cut_short(self, place: int) -> FileError:
        return FileError(
            self.path, f"the binout is cut short: it ends at byte {len(self._content)}, but byte {place} is asked for"
        )


def is_lsda(content: bytes) -> bool:
    """Tell whether a file begins as such a file does."""
    return (
        len(content) > HEADER
        and content[0] >= HEADER
        and all(size in (1, 2, 4, 8) for size in content[1:5])
        and content[5] in (0, 1)
    )
