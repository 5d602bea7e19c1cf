"""Columns of numbers in SI with the places they were read at."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from service.readers.errors import FileError
from solver.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """What a file holds.

    Parameters
    ----------
    path
        Of the file.
    values
        By quantity, all of one length. [SI]
    lines
        Where each row was read; None for files without lines, whose rows are told by their number.
    """

    path: str | PathLike[str]
    values: Mapping[str, FloatArray]
    lines: Sequence[int] | None = None

    @property
    def rows(self) -> int:
        """How many there are."""
        return len(next(iter(self.values.values())))

    def each_row(self) -> Iterator[dict[str, float]]:
        """Yield the values of each row by quantity. [SI]"""
        for row in range(self.rows):
            yield {name: float(values[row]) for name, values in self.values.items()}

    def error(self, row: int, reason: str) -> FileError:
        """Return the error of a row."""
        if self.lines is None:
            return FileError(self.path, f"state {row + 1}: {reason}")
        return FileError(self.path, reason, self.lines[row])

    def require(self, name: str, accepted: NDArray[np.bool_], requirement: str, unit: str) -> None:
        """Refuse the first row whose value of a quantity is not accepted."""
        rows = np.flatnonzero(~accepted)
        if rows.size:
            value = float(self.values[name][rows[0]])
            raise self.error(int(rows[0]), f"{name} {requirement}, got {value:g} {unit}".rstrip())

    def require_rows(self, least: int) -> None:
        """Refuse too few rows."""
        if self.rows < least:
            line = self.lines[-1] if self.lines else None
            raise FileError(self.path, f"at least {least} rows are needed, the file has {self.rows}", line)
