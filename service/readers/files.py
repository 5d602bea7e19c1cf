"""Functions that read files as bytes and lines, columns of numbers, and an error that names the file and the line."""

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solver.arrays import FloatArray
from solver.units import number

UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
OTHER_FORMATS = (
    (re.compile(rb"\x1f\x8b|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd"), "a compressed file; decompress it first"),
    (
        re.compile(rb"PK\x03\x04|\xd0\xcf\x11\xe0"),
        "an Excel workbook or a ZIP archive; name it .xlsx or save a CSV",
    ),
    (re.compile(rb"\x89HDF"), "an HDF5 file; export its columns as CSV"),
    (re.compile(rb"PAR1"), "a Parquet file; export its columns as CSV"),
    (re.compile(rb"(\$.*\n\s*)*+\*[A-Za-z_]+ *\r?\n"), "an LS-DYNA keyword file, the input of a run; {motion}"),
    (
        re.compile(rb"(?s).{,4096}(dt of cycle|kinetic energy\.{4})"),
        "LS-DYNA's glstat, the energies of a model; {motion}",
    ),
    (re.compile(rb"(?s)\s*\*{20,}+.{,200}LEGAL NOTICES"), "LS-DYNA's d3hsp, the log of a run; {motion}"),
)
"""Formats of files that users pass by mistake instead of tests or a motion: pattern of the first bytes, and advice.

Quantifiers are possessive or bounded where backtracking could be slow.
"""
DYNA_TITLE = re.compile(rb"(?s).{,512}ls-dyna.{,80}date")
DYNA_MOTIONS = (b"r i g i d   b o d y", b"n o d a l   p r i n t")
OTHER_DYNA = "an LS-DYNA text file other than rbdout and nodout; {motion}"
HEAD_BYTES = 65_536
"""Length of the start of a file from which its format is recognized [bytes], an arbitrary choice with room for the
comments at the start of a keyword file. It is limited so that a crafted file cannot make the patterns slow."""
MAX_BYTES = 2**30
"""Largest file that is read [bytes]: LS-DYNA starts a new file at this size. Without a limit, a device such as
/dev/zero would be read forever."""
D3PLOT_TYPES, D3PLOT_DIMENSIONS = range(1, 7), range(2, 8)
MOTION_FILES = "the motion of a body is in rbdout, nodout or binout"


MAX_REASON = 500
"""Length to which the reason of an error is truncated, since it may quote a long cell. The value is arbitrary.
[characters]"""


class FileError(Exception):
    """A file cannot be read, or its content is invalid.

    Parameters
    ----------
    path
        The file, as the caller named it.
    reason
        Description of the problem.
    line
        Number of the line, from 1; None if the problem is in the whole file, or the file has no lines.
    """

    def __init__(self, path: str | PathLike[str], reason: str, line: int | None = None) -> None:
        super().__init__(path, reason, line)
        self.path = path
        self.reason = reason if len(reason) <= MAX_REASON else f"{reason[:MAX_REASON]}..."
        self.line = line

    def __str__(self) -> str:
        position = f"{self.path}" if self.line is None else f"{self.path}:{self.line}"
        return f"{position}: {self.reason}"


def read_bytes(path: str | Path) -> bytes:
    """Return the content of a file.

    Raises
    ------
    FileError
        If the file cannot be opened, is empty or too large, or has a format that cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            # One more byte than the limit shows that the file is too large; a device does not report its size.
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from None
    if len(content) > MAX_BYTES:
        raise FileError(path, f"the file is larger than {MAX_BYTES:,} bytes")
    # A byte order mark, blanks and the zeros of a file that was allocated but not written do not count as content.
    if not content.strip(b"\xef\xbb\xbf \t\r\n\x00"):
        raise FileError(path, "the file is empty")
    if other := _other_format(content):
        raise FileError(path, f"this is {other.format(motion=MOTION_FILES)}")
    return content


def _other_format(content: bytes) -> str | None:
    """Return the name of a format that cannot be read, with advice for the user; None for any other content."""
    if _is_d3plot(content):
        return "LS-DYNA's d3plot, the state of a whole model; {motion}"
    head = content[:HEAD_BYTES]
    if found := next((name for start, name in OTHER_FORMATS if start.match(head)), None):
        return found
    is_motion = any(mark in content for mark in DYNA_MOTIONS)
    return OTHER_DYNA if DYNA_TITLE.match(head) and not is_motion else None


def _is_d3plot(content: bytes) -> bool:
    """Return True if a file begins as LS-DYNA's d3plot does.

    Counted from 0, word 11 is the type of the file, word 15 encodes the dimensions of its geometry, and word 16 is the
    number of nodes. The width and the order of the bytes depend on the machine that wrote the file.
    """
    for width, order in itertools.product((4, 8), ("<", ">")):
        if len(content) >= 64 * width and content[:1].isascii() and content[:1] >= b" ":  # The title comes first.
            words = np.frombuffer(content, f"{order}i{width}", 64)
            if words[11] in D3PLOT_TYPES and words[15] in D3PLOT_DIMENSIONS and words[16] > 0:
                return True
    return False


def lines_of(path: str | Path, content: bytes, *, strict: bool = True) -> list[str]:
    """Return the lines of a text file without line ends and byte order mark.

    Parameters
    ----------
    strict
        True to raise an error if the text is not UTF-8. Otherwise invalid bytes, which occur in titles of older LS-DYNA
        files, are replaced.

    Raises
    ------
    FileError
        If the content is not text.
    """
    if content.startswith(UTF16_MARKS):
        raise FileError(path, "the file is UTF-16; save it as UTF-8")
    if b"\x00" in content:
        raise FileError(
            path, "not a text file: it holds zero bytes", content.count(b"\n", 0, content.index(b"\x00")) + 1
        )
    try:
        text = content.decode("utf-8-sig", "strict" if strict else "replace")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FileError(path, "not a UTF-8 text file", line) from None
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """Columns of numbers read from a file.

    Parameters
    ----------
    path
        The file.
    values
        Columns of equal length, by quantity. [SI; units of the model in the result of `dyna.along`]
    lines
        Line of each row; None for binary files, whose errors give the number of the state instead.
    """

    path: str | PathLike[str]
    values: Mapping[str, FloatArray]
    lines: Sequence[int] | None = None

    @property
    def rows(self) -> int:
        """Number of rows of each column."""
        return len(next(iter(self.values.values())))

    def each_row(self) -> Iterator[dict[str, float]]:
        """Yield each row as a mapping from quantity to value."""
        for row in range(self.rows):
            yield {name: float(values[row]) for name, values in self.values.items()}

    def error(self, row: int, reason: str) -> FileError:
        """Return an error about a row."""
        if self.lines is None:
            return FileError(self.path, f"state {row + 1}: {reason}")
        return FileError(self.path, reason, self.lines[row])

    def require(self, name: str, accepted: NDArray[np.bool_], requirement: str, unit: str) -> None:
        """Raise an error for the first row whose value is not accepted.

        Parameters
        ----------
        accepted
            True in each row whose value is accepted.
        requirement
            End of the message, such as "must be greater than 0".
        """
        rows = np.flatnonzero(~accepted)
        if rows.size:
            value = float(self.values[name][rows[0]])
            raise self.error(int(rows[0]), f"{name} {requirement}, got {number(value, '', 6)} {unit}".rstrip())

    def require_rows(self, least: int) -> None:
        """Raise an error if there are fewer than `least` rows."""
        if self.rows < least:
            line = self.lines[-1] if self.lines else None
            raise FileError(self.path, f"at least {least} rows are needed, the file has {self.rows}", line)
