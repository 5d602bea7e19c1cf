"""Numbers of LS-DYNA's text files, written with Fortran and C formats of fixed width."""

import re
from os import PathLike

from service.readers.errors import FileError

NUMBER = re.compile(r"[+-]?\d+\.\d*(?:[EeDd][+-]?\d+|[+-]\d{3})?")
BARE_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d{3})$")
"""Fortran leaves the E out where the exponent takes three digits."""


def numbers_of(path: str | PathLike[str], line: int, text: str, least: int, what: str) -> list[float]:
    """Return the numbers of a line, which may stand without a blank between them.

    Raises
    ------
    FileError
        If there is something else, or less.
    """
    rest = NUMBER.sub(" ", text).strip()
    if rest:
        raise FileError(path, f"{what} must be numbers, got {rest[:40]!r}", line)
    found = [_number(match) for match in NUMBER.findall(text)]
    if len(found) < least:
        raise FileError(path, f"{what}: {least} numbers are needed, the line has {len(found)}", line)
    return found


def _number(text: str) -> float:
    return float(BARE_EXPONENT.sub(r"E\1", text.upper().replace("D", "E")))


def chosen(path: str | PathLike[str], what: str, there: list[int], asked: int | None) -> int:
    """Return which of the bodies in a file to read.

    Raises
    ------
    FileError
        If it is not there, or there are several and none was asked for.
    """
    listed = ", ".join(str(one) for one in there[:20]) + (", ..." if len(there) > 20 else "")
    if asked is None:
        if len(there) == 1:
            return there[0]
        raise FileError(path, f"say which {what} to read, there are: {listed or 'none'}")
    if asked not in there:
        raise FileError(path, f"there is no {what} {asked}, there are: {listed or 'none'}")
    return asked
