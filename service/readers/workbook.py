"""Conversion of the first sheet of an Excel workbook to the text of a CSV file."""

import csv
import io
from datetime import datetime
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from service.readers.files import MAX_BYTES, FileError

ENDING = ".xlsx"
MAX_CELLS = 5_000_000
"""Largest number of cells that are read: 50 columns of the largest batch. A small compressed file can hold many more,
and would fill the memory."""


def is_workbook(path: str | Path) -> bool:
    """Return True if a file has the extension of an Excel workbook."""
    return Path(path).suffix.lower() == ENDING


def sheet_as_csv(path: str | Path) -> bytes:
    """Return the cells of the first sheet as CSV; a formula is replaced by the value that was saved with it.

    Each row of the sheet becomes one line, so that line numbers in error messages are row numbers.

    Raises
    ------
    FileError
        If the file cannot be read, has too many cells, or openpyxl is not installed.
    """
    try:
        from openpyxl import load_workbook  # noqa: PLC0415 (an extra that only workbooks need)
        from openpyxl.utils.exceptions import InvalidFileException  # noqa: PLC0415
    except ModuleNotFoundError:
        reason = 'an Excel workbook needs openpyxl: install the extra excel, pip install -e ".[excel]"'
        raise FileError(path, reason) from None
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise FileError(path, f"the file is larger than {MAX_BYTES:,} bytes")
        book = load_workbook(path, read_only=True, data_only=True)
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from None
    except (BadZipFile, InvalidFileException, KeyError, ValueError):
        raise FileError(path, "not an Excel workbook") from None
    text, count = io.StringIO(), 0
    writer = csv.writer(text, lineterminator="\n")
    try:
        for row in book.worksheets[0].iter_rows(values_only=True):
            cells = [_text(value) for value in row]
            count += len(cells)
            if count > MAX_CELLS:
                raise FileError(path, f"the sheet has more than {MAX_CELLS:,} cells")
            # An empty row becomes an empty line rather than a line of commas: the reader of tables expects this.
            if any(cells):
                writer.writerow(cells)
            else:
                text.write("\n")
    finally:
        book.close()
    return text.getvalue().encode()


def _text(value: Any) -> str:
    """Return a cell as text on one line. Numbers keep all digits, and whole numbers have no decimal point."""
    if value is None:
        return ""
    # Excel has no integers, only floats with 15 significant digits.
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    if isinstance(value, datetime):
        return value.isoformat(sep=" ")
    return " ".join(str(value).split())
