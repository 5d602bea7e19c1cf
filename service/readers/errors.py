"""What is wrong with a file, and where."""

from os import PathLike


class FileError(Exception):
    """A file cannot be read, or does not hold what it should.

    Parameters
    ----------
    path
        As the caller named it.
    reason
        What is wrong, for people.
    line
        From 1; None where the fault is of the whole file, or the file has no lines.
    """

    def __init__(self, path: str | PathLike[str], reason: str, line: int | None = None) -> None:
        super().__init__(path, reason, line)
        self.path = path
        self.reason = reason
        self.line = line

    def __str__(self) -> str:
        place = f"{self.path}" if self.line is None else f"{self.path}:{self.line}"
        return f"{place}: {self.reason}"
