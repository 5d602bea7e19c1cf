"""Output files of commands, which are checked before the computation and replaced as a whole after it."""

import argparse
import errno
import io
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, TextIO

from service.cli.arguments import FAILED, CommandError, InputFile

ONE_ANSWER = {".json": "json", ".csv": "csv"}
MANY_ANSWERS = {".jsonl": "json", ".ndjson": "json", ".csv": "csv", ".parquet": "parquet", ".xlsx": "xlsx"}
"""Format flags by file extension, for commands with many answers."""
PLOT = (".png", ".svg", ".pdf")
MEANINGFUL, ALL_DIGITS = 6, 17
"""Default and largest number of significant digits. Six are enough: a search ends within 0.01° and runs are accurate
to 1e-6 of their scale. A double has no more than 17."""
STANDARD = "-"
"""Name of standard input or standard output."""
DESCRIPTORS = ("/dev/fd/", "/dev/std", "/proc/")
"""Prefixes of paths that name an open file. Such a file is written in place, since a program that has opened it would
not see a new file with the same name."""


def sentence_number(value: float, digits: int = 16) -> str:
    """Format a number as `solver.units.number` does, but without its import, which would take a second."""
    text = f"{float(f'{value:.{digits}g}'):,}".removesuffix(".0")
    return text if abs(value) >= 10_000.0 else text.replace(",", "")


@dataclass(frozen=True)
class OutputFile:
    """An output file named by a flag or an argument.

    Parameters
    ----------
    flag
        Flag or argument that error messages name.
    endings
        Accepted file extensions. If they are mapped to format flags, any extension is accepted with one of these.
    text
        Path as typed.
    """

    flag: str
    endings: Collection[str]
    text: str

    def __str__(self) -> str:
        return self.text

    @property
    def path(self) -> Path:
        """`text` as a path, with links not resolved."""
        return Path(self.text)

    def ending(self) -> str:
        """Return the file extension.

        Raises
        ------
        CommandError
            If the extension is not accepted.
        """
        found = self.path.suffix.lower()
        if found not in self.endings:
            *others, last = self.endings
            raise CommandError(f"{self.flag} {self}: must end in {', '.join(others)}{' or ' if others else ''}{last}")
        return found

    def check(self, others: "Collection[InputFile | OutputFile]") -> None:
        """Check before the computation that the file can be written and differs from the other files.

        Raises
        ------
        CommandError
            If the path is a folder, its parent folder does not exist, or the same file is also read or written, even
            under another name.
        """
        with self._errors():
            if self.path.is_dir():
                raise CommandError(f"{self.flag} {self}: is a folder")
            if not _target(self.path).parent.is_dir():
                raise CommandError(f"{self.flag} {self}: the folder does not exist")
        for other in others:
            if _identity(self) == _identity(other) is not None:
                use = "read" if isinstance(other, InputFile) else f"written by {other.flag}"
                raise CommandError(f"{self.flag} {self}: is the file {other}, which is {use} too; name another file")

    def write(self, content: bytes) -> None:
        """Replace the content of the file.

        Raises
        ------
        CommandError
            If the file cannot be written; it is then left unchanged.
        """
        with self._errors(), self.open() as stream:
            stream.buffer.write(content)

    @contextmanager
    def open(self, *, keep: bool = False) -> Iterator[TextIO]:
        """Open a temporary file, which replaces this file at the end of the block.

        A reader never sees a partial file, and a failure leaves the existing file unchanged. Links are followed, and
        the mode is kept. Anything but a regular file, such as a pipe, is written in place.

        Parameters
        ----------
        keep
            Keep the temporary file, unless it is empty, if the block fails.

        Raises
        ------
        CommandError
            If the file cannot be written.
        """
        path = _target(self.path)
        with self._errors():
            before = path.stat() if path.exists() else None
            if self._is_special(before):
                stream: TextIO = self.path.open("w", encoding="utf-8", newline="")
            else:
                stream = _open_beside(path)
        if self._is_special(before):
            with stream:
                yield stream
            return
        try:
            with stream:
                yield stream
            with self._errors():
                _replace(path, stream.name, before)
        except BaseException:
            with suppress(OSError):
                if not (keep and Path(stream.name).stat().st_size):
                    Path(stream.name).unlink()
            raise

    def _is_special(self, before: os.stat_result | None) -> bool:
        return self.text.startswith(DESCRIPTORS) or (before is not None and not stat.S_ISREG(before.st_mode))

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise CommandError(f"{self.flag} {self}: {error.strerror or error}", FAILED) from None


def _target(path: Path) -> Path:
    """Return the file that links lead to, which need not exist; for a pipe in /proc, return the link itself."""
    resolved = Path(os.path.realpath(path)) if path.is_symlink() else path
    return path if path.exists() and not resolved.exists() else resolved


def _identity(file: InputFile | OutputFile) -> tuple[int | str, ...] | None:
    """Return a value that is the same for all names of a file; None for a pipe, a device or a missing input file."""
    try:
        if isinstance(file, InputFile):
            found = os.fstat(0) if file == STANDARD else Path(file).stat()
        else:
            found = file.path.stat()
    except OSError:  # An input file that is missing is reported when it is read; an output file may be new.
        return None if isinstance(file, InputFile) else (os.path.realpath(file.text),)
    return (found.st_dev, found.st_ino) if stat.S_ISREG(found.st_mode) else None


def _open_beside(path: Path) -> TextIO:
    """Open a new file in the same folder, or in the temporary folder if only the file itself is writable."""
    folder = path.parent
    if path.exists() and not os.access(folder, os.W_OK):
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        folder = Path(tempfile.gettempdir())
    for number in count(1):
        # An existing partial file holds the rows of an interrupted batch, and must not be overwritten.
        name = f"{path.stem}.partial{'' if number == 1 else f'-{number}'}{path.suffix}"
        with suppress(FileExistsError):
            return (folder / name).open("x", encoding="utf-8", newline="")
    raise AssertionError("numbers do not end")


def _replace(path: Path, partial_name: str, before: os.stat_result | None) -> None:
    """Replace a file with a new one, and keep its owner and mode."""
    if before is not None:
        with suppress(OSError):  # Only root may change the owner of a file.
            os.chown(partial_name, before.st_uid, before.st_gid)
        Path(partial_name).chmod(stat.S_IMODE(before.st_mode))
    try:
        Path(partial_name).replace(path)
    except OSError:
        if before is None:
            raise
        # Renaming cannot replace a mount point, and cannot move a file to another file system.
        shutil.copyfile(partial_name, path)
        Path(partial_name).unlink()


def add_output_file(
    parser: argparse.ArgumentParser, *names: str, endings: Collection[str], flag: str = "", **options: str
) -> None:
    """Add a flag or an argument for an output file, whose value is an `OutputFile`."""
    options = {"metavar": "FILE"} | options
    parser.add_argument(*names, type=partial(OutputFile, flag or names[-1], endings), **options)  # type: ignore[arg-type]


def add_formats(
    parser: argparse.ArgumentParser, *, json: str, csv: str, endings: Mapping[str, str] = ONE_ANSWER
) -> Any:
    """Add `--output`, `--json`, `--csv` and `--digits`; return the group of the formats, which exclude each other."""
    described = f"write to a file, in the format of its extension ({', '.join(endings)}) or of a flag"
    add_output_file(parser, "-o", "--output", endings=endings, help=described)
    formats = parser.add_mutually_exclusive_group()
    formats.add_argument("--json", action="store_true", help=json)
    formats.add_argument("--csv", action="store_true", help=csv)
    parser.add_argument(
        "--digits",
        type=_digits,
        default=MEANINGFUL,
        metavar="N",
        help="significant digits of the numbers in CSV (default: %(default)s), or all",
    )
    return formats


def _digits(text: str) -> int | None:
    """Parse a number of significant digits; None stands for all."""
    if text == "all":
        return None
    if not (text.isascii() and text.isdigit() and 0 < int(text) <= ALL_DIGITS):
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 to {ALL_DIGITS}, or all, got {text!r}")
    return int(text)


def add_output(parser: argparse.ArgumentParser) -> None:
    """Add `--output` and the format flags of the results of many cases."""
    formats = add_formats(parser, json="print JSON lines", csv="print the summaries as CSV", endings=MANY_ANSWERS)
    formats.add_argument(
        "--parquet", action="store_true", help="write the summaries as Parquet; needs the extra parquet at the service"
    )
    parser.set_defaults(xlsx=False)  # Only a file extension sets it, because a workbook cannot be printed.


def add_plot(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the flag `--plot` for a file; `what` is the part of its help text that describes the plot."""
    add_output_file(parser, "--plot", endings=PLOT, help=f"plot {what}, as .svg, .png or .pdf")


def check_outputs(args: argparse.Namespace) -> None:
    """Check the output files of a command, and set the format flag from the file extension of `--output`.

    Raises
    ------
    CommandError
        If a file extension has no format, or a file cannot be written or is also read.
    """
    given = vars(args).values()
    checked: list[InputFile | OutputFile] = [value for value in given if isinstance(value, InputFile)]
    for output in [value for value in given if isinstance(value, OutputFile)]:
        if output.text == STANDARD and output is getattr(args, "output", None) and ".html" in output.endings:
            args.output = None
            continue
        if isinstance(output.endings, Mapping):
            standard = _is_standard(output)
            chosen = any(getattr(args, name) for name in output.endings.values())
            if not chosen and (output.path.suffix or not standard):
                setattr(args, output.endings[output.ending()], True)
            if standard:
                args.output = None
                continue
        else:
            output.ending()
        output.check(checked)
        checked.append(output)


def _is_standard(output: OutputFile) -> bool:
    """Return True if a path names standard output: `-`, or the path of the file or pipe it goes to.

    Such a file must not be opened twice, since both outputs would mix.
    """
    if output.text == STANDARD:
        return True
    with suppress(OSError):
        return os.path.samestat(output.path.stat(), os.fstat(1)) and not output.path.is_char_device()
    return False


@contextmanager
def one_answer(args: argparse.Namespace) -> Iterator[None]:
    """Redirect the output of a command with one answer to the `--output` file, which is written at the end.

    Commands with many answers write their file as results become available.
    """
    output: OutputFile | None = getattr(args, "output", None)
    if output is None or output.endings is not ONE_ANSWER:
        yield
        return
    content = io.BytesIO()
    with io.TextIOWrapper(content, "utf-8", newline="") as printed, redirect_stdout(printed):
        yield
        printed.flush()
        output.write(content.getvalue())


@contextmanager
def open_output(args: argparse.Namespace) -> Iterator[TextIO]:
    """Open the `--output` file for many results, or standard output.

    Raises
    ------
    CommandError
        If the file cannot be written, or Parquet would go to a terminal.
    """
    output: OutputFile | None = args.output
    if output is not None:
        with output.open(keep=True) as stream:
            yield stream
        return
    if args.parquet and sys.stdout.isatty():
        raise CommandError("--parquet: cannot be written to a terminal; name a file with -o")
    yield sys.stdout
