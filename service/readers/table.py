"""Reader of CSV files with columns of quantities in any known unit; its errors name the line."""

import csv
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from service.readers.files import FileError, Readings, lines_of, read_bytes
from service.readers.workbook import is_workbook, sheet_as_csv

LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
SPEED = {
    "m_s": 1.0,
    "km_s": 1e3,
    "km_h": 1.0 / 3.6,
    "mm_ms": 1.0,
    "mm_us": 1e3,
    "mm_s": 1e-3,
    "cm_us": 1e4,
    "ft_s": 0.3048,
}
MASS = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": 0.45359237}
ANGLE = {"rad": 1.0, "deg": math.pi / 180.0}
ANGULAR_VELOCITY = {"rad_s": 1.0, "deg_s": math.pi / 180.0}
PRESSURE = {
    "pa": 1.0,
    "kpa": 1e3,
    "mpa": 1e6,
    "gpa": 1e9,
    "n_mm2": 1e6,
    "bar": 1e5,
    "psi": 6894.757293168,
    "ksi": 6894757.293168,
}
DENSITY = {"kg_m3": 1.0, "g_cm3": 1e3, "t_m3": 1e3, "kg_dm3": 1e3}
INERTIA = {"kg_m2": 1.0, "kg_cm2": 1e-4, "kg_mm2": 1e-6, "g_cm2": 1e-7}
PURE = {"1": 1.0}
ALL_UNITS = (LENGTH, TIME, SPEED, MASS, ANGLE, ANGULAR_VELOCITY, PRESSURE, DENSITY, INERTIA)

SPELLINGS = str.maketrans(
    {"/": "_", "µ": "u", "μ": "u", "°": "deg", " ": None, "²": "2", "³": "3", "^": None, "·": "_"}
)
BRACKETED = re.compile(r"(?P<stem>.*?)\s*[\[(]\s*(?P<unit>[^\[\]()]*?)\s*[\])]$")


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that a column can hold.

    Parameters
    ----------
    name
        Name in flags and headers.
    units
        Factor that converts to SI, by unit, with the SI unit first; None for a column of text.
    also
        Other names in headers.
    required
        True if every file must have a column of the quantity.
    """

    name: str
    units: Mapping[str, float] | None
    also: tuple[str, ...] = ()
    required: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """All names under which a header may list the quantity."""
        return (self.name, *self.also)


class UnknownUnitError(ValueError):
    """A unit that is not known for a quantity."""

    def __init__(self, quantity: Quantity, unit: str) -> None:
        known = f", known are {', '.join(quantity.units)}" if quantity.units else ", which has none"
        super().__init__(f"unknown unit {unit!r} of {quantity.name}{known}")


def spelled(unit: str) -> str:
    """Return a unit as it is spelled in the mappings above: m/s becomes m_s, µs becomes us."""
    return unit.translate(SPELLINGS).lower()


def factor_to_si(quantity: Quantity, unit: str) -> float:
    """Return the factor that converts a unit to SI.

    Raises
    ------
    UnknownUnitError
        If the unit is not known for the quantity.
    """
    try:
        return (quantity.units or {})[spelled(unit)]
    except KeyError:
        raise UnknownUnitError(quantity, unit) from None


def unit_in_header(quantity: Quantity, cell: str, *, named: bool) -> str | None:
    """Return the unit in a header cell: "" if the cell has none, None if it belongs to another quantity.

    Parameters
    ----------
    cell
        A cell such as ``time_s``, ``time [ms]`` or ``Time``.
    named
        True if the caller has assigned the cell to the quantity, regardless of its name.

    Raises
    ------
    UnknownUnitError
        If the cell has a unit in brackets that is not known for the quantity.
    """
    bracketed = BRACKETED.fullmatch(cell.strip())
    stem = re.sub(r"\s+", "_", (bracketed["stem"] if bracketed else cell).strip()).lower()
    if named or stem in quantity.names:
        if bracketed and (not named or spelled(bracketed["unit"]) in (quantity.units or {})):
            factor_to_si(quantity, bracketed["unit"])
            return bracketed["unit"]
        return next((unit for unit in quantity.units or {} if named and stem.endswith(f"_{unit}")), "")
    matching = (unit for name in quantity.names for unit in quantity.units or {} if stem == f"{name}_{unit}")
    return next(matching, None)


SEPARATORS = ",;\t"
SEPARATOR_LINE = re.compile(r"\s*sep=(?P<separator>[,;\t|])\s*", re.IGNORECASE)
"""Line at the start of a file in which spreadsheets name the separator."""
COMMENTS = ("#", "%")
NUMBER_SIGN = re.compile(r"# *(?=[,;\t])")
"""Start of a header whose first column is named #, which is common for a column of running numbers."""
NUMBERED = re.compile(r"#[^\s,;\t]+(?=([,;\t]))")
"""Start of a row whose first cell is a running number such as #17."""
MAX_NAMES = 20
"""Largest number of column names listed in an error, which should stay readable (an arbitrary choice)."""
MAX_COLUMNS = 10_000
"""Largest number of columns, an arbitrary choice. Each column takes time: it is compared with the names of all
quantities in all units."""
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eEdD][+-]?\d+)?")
BLANKS = re.compile(r"(?<![ \t])[ \t]++(?![\[(])")
"""Blanks between two cells, unless a unit in brackets follows. The pattern matches a whole run possessively, since the
time would otherwise grow with the square of its length."""
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{,2}(,\d{3})+(\.\d*)?")
"""A number with commas between thousands. If it has a single comma, that may also be a decimal comma."""
MINUS = "\u2212"
"""Typographic minus sign, which spreadsheets and web pages put before numbers."""


@dataclass(frozen=True, slots=True)
class Table:
    """A CSV file as text.

    Parameters
    ----------
    header
        Names of the columns, in order.
    header_line
        Line of the header.
    rows
        Cells of each row, as many as the header has.
    lines
        Line at which each row begins; quoted cells may span several lines.
    """

    path: str | Path
    header: Sequence[str]
    header_line: int
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]


@dataclass(frozen=True, slots=True)
class Column:
    """The column of a table that holds a quantity.

    Parameters
    ----------
    index
        Position in the header, from 0.
    factor
        Factor that converts the unit of the file to SI; negative if the values change their sign.
    """

    quantity: Quantity
    index: int
    factor: float


def read_table(path: str | Path, content: bytes | None = None, *, gaps: bool = False) -> Table:
    """Read a CSV file, or the first sheet of an Excel workbook.

    Cells are separated by commas, semicolons or tabs, or by blanks if the header contains none of these. Lines that
    begin with ``#`` or ``%`` are comments. If the first row has only numbers, a comment in the line before it is the
    header. A first line ``sep=;`` names the separator, and a second row of units belongs to the header.

    Parameters
    ----------
    gaps
        True if lines may be empty, and rows may lack cells at their ends. A line that begins with a running number such
        as #17 is then a row if it has all cells, and a column without a name or a cell is ignored.

    Raises
    ------
    FileError
        If the file is not a table: no text, no rows, or rows whose length differs from the header.
    """
    if content is None:
        content = sheet_as_csv(path) if is_workbook(path) else read_bytes(path)
    lines = lines_of(path, content)
    while lines and not lines[-1].strip(" \t,;"):
        lines.pop()
    named = SEPARATOR_LINE.fullmatch(lines[0]) if lines else None
    if named:
        lines[0] = ""
    lines = _with_header(lines)
    lines = _with_numbers(lines) if gaps else lines
    head = next((line for line in lines if line.strip() and not line.startswith(COMMENTS)), None)
    if head is None:
        raise FileError(path, "the file holds comments only")
    separator = named["separator"] if named else max(SEPARATORS, key=head.count)
    if separator not in head and len(head.split()) > 1:
        lines, separator = _with_tabs(lines), "\t"
    cells = _cells(path, lines, separator)
    header_line, header = next(cells)
    while header and not header[-1]:
        header.pop()
    if len(header) > MAX_COLUMNS:
        raise FileError(path, f"the header has {len(header):,} columns, more than {MAX_COLUMNS:,}", header_line)
    rows: list[list[str]] = []
    starts: list[int] = []
    for number, (line, row) in enumerate(cells):
        if number == 0 and _are_units(row):
            units = itertools.chain((cell.strip("[]()-") for cell in row), itertools.repeat(""))
            header = [
                f"{name} ({unit})" if unit and not BRACKETED.fullmatch(name) else name
                for name, unit in zip(header, units, strict=False)
            ]
        elif any(row):
            rows.append(_fitted_row(path, line, row, len(header), gaps=gaps))
            starts.append(line)
        elif not gaps:
            raise FileError(path, "the line is empty", line)
    if not rows:
        raise FileError(path, "there are no rows below the header", header_line)
    used = [place for place, name in enumerate(header) if name or not gaps or any(row[place] for row in rows)]
    rows = [[row[place] for place in used] for row in rows]
    return Table(path, [header[place] for place in used], header_line, rows, starts)


def _with_numbers(lines: list[str]) -> list[str]:
    """Return the lines with quotes around a header # and numbers such as #17, which would otherwise be comments.

    A line that begins with such a number is a row if it has as many cells as the header.
    """
    lines = [NUMBER_SIGN.sub('"#"', line) if NUMBER_SIGN.match(line) else line for line in lines]
    head = next((line for line in lines if line.strip() and not line.startswith(COMMENTS)), "")

    def quoted(line: str) -> str:
        found = NUMBERED.match(line)
        is_row = found is not None and line.count(found[1]) >= head.count(found[1]) > 0
        return f'"{found[0]}"{line[found.end() :]}' if found and is_row else line

    return list(map(quoted, lines))


def _fitted_row(path: str | Path, line: int, row: Sequence[str], count: int, *, gaps: bool) -> list[str]:
    """Return a row with exactly as many cells as the header.

    Surplus empty cells at its end are dropped. If `gaps` is true, missing cells at its end are filled in as empty.

    Raises
    ------
    FileError
        If the row still has more or fewer cells than the header.
    """
    cells = list(row)
    while len(cells) > count and not cells[-1]:
        cells.pop()
    if gaps:
        cells += [""] * (count - len(cells))
    if len(cells) != count:
        raise FileError(path, f"the line has {len(cells)} cells, the header {count}", line)
    return cells


def read_columns(
    table: Table, quantities: Sequence[Quantity], columns: Mapping[str, str], units: Mapping[str, str]
) -> tuple[Readings, Mapping[str, Sequence[str]]]:
    """Return the columns of numbers of a table, in SI, and its columns of text, both by quantity.

    Parameters
    ----------
    columns
        Headers by quantity, for columns that are not named after their quantity. A leading minus sign changes the sign
        of the values; an empty header leaves the quantity out.
    units
        Units by quantity, for headers without a unit; the default is SI.

    Raises
    ------
    FileError
        If a column is missing or repeated, a unit is unknown, or a cell is not a number.
    """
    found = _find(table, quantities, columns, units)
    text = {c.quantity.name: _texts(table, c) for c in found if c.quantity.units is None}
    values = {c.quantity.name: np.array(_numbers(table, c)) for c in found if c.quantity.units is not None}
    return Readings(path=table.path, values=values, lines=table.lines), text


def _with_header(lines: list[str]) -> list[str]:
    """Return the lines with the comment before the first row as the header, if that row has only numbers.

    NumPy writes such files.
    """
    first = next((n for n, line in enumerate(lines) if line.strip() and not line.startswith(COMMENTS)), 0)
    comment = lines[first - 1] if first else ""
    if comment.startswith(COMMENTS) and not NUMBER_SIGN.match(comment) and _has_numbers_only(lines[first]):
        return [*lines[: first - 1], lines[first - 1].lstrip("#% \t"), *lines[first:]]
    return lines


def _has_numbers_only(line: str) -> bool:
    return all(
        NUMBER.fullmatch(cell) for cell in re.split(rf"[\s{SEPARATORS}]+", line.replace(MINUS, "-").strip(" ,;"))
    )


def _with_tabs(lines: list[str]) -> list[str]:
    """Replace the blanks between cells with tabs, except before a unit in brackets."""
    return [line if line.startswith(COMMENTS) else BLANKS.sub("\t", line.strip()) for line in lines]


def _are_units(row: Sequence[str]) -> bool:
    """Return True if a row below the header holds the units of the columns."""
    units = {unit for known in ALL_UNITS for unit in known}
    return any(spelled(cell.strip("[]()")) in units for cell in row) and not any(map(NUMBER.fullmatch, row))


def _cells(path: str | Path, lines: list[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    # A comment becomes an empty line rather than being left out, so that the line numbers in errors are right.
    reader = csv.reader(
        ("\n" if line.startswith(COMMENTS) else line + "\n" for line in lines), delimiter=separator, strict=True
    )
    begun = False
    while True:
        line = reader.line_num + 1
        try:
            row = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise FileError(path, f"not a CSV file: {error}", line) from None
        if lines[line - 1].startswith(COMMENTS) or (not begun and not lines[line - 1].strip()):
            continue
        begun = True
        yield line, [" ".join(cell.split()) for cell in row]


def _find(
    table: Table, quantities: Sequence[Quantity], columns: Mapping[str, str], units: Mapping[str, str]
) -> list[Column]:
    found = []
    try:
        for quantity in quantities:
            column = _find_one(table, quantity, columns.get(quantity.name), units.get(quantity.name))
            if column is not None:
                found.append(column)
    except UnknownUnitError as error:
        raise FileError(table.path, str(error), table.header_line) from None
    return found


def _find_one(table: Table, quantity: Quantity, name: str | None, unit: str | None) -> Column | None:
    if name is not None and not name.strip():
        return None
    sign, wanted = 1.0, None if name is None else " ".join(name.split())
    if wanted is not None and wanted not in table.header and wanted.startswith("-"):
        sign, wanted = -1.0, wanted[1:].strip()
    if wanted is None:
        units = [unit_in_header(quantity, cell, named=False) for cell in table.header]
        indices = [index for index, given in enumerate(units) if given is not None]
    else:
        indices = [index for index, cell in enumerate(table.header) if cell == wanted]
    if not indices:
        _check_absent(table, quantity, wanted)
        return None
    if len(indices) > 1:
        names = " and ".join(repr(table.header[index]) for index in indices[:MAX_NAMES])
        raise FileError(table.path, f"there are {len(indices)} columns of {quantity.name}: {names}", table.header_line)
    given = unit_in_header(quantity, table.header[indices[0]], named=wanted is not None) or ""
    if quantity.units is None:
        return Column(quantity, indices[0], 1.0)
    if unit and given and spelled(unit) != spelled(given):
        raise FileError(table.path, f"{quantity.name} is in {given} by the header, not in {unit}", table.header_line)
    return Column(quantity, indices[0], sign * factor_to_si(quantity, unit or given or next(iter(quantity.units))))


def _check_absent(table: Table, quantity: Quantity, wanted: str | None) -> None:
    """Raise an error if a missing quantity is required or its header was given, or an unread column has its name."""
    if wanted is None:
        for cell in table.header:
            for name in quantity.names:
                if cell.lower().startswith(f"{name}_") and quantity.units is not None:
                    raise UnknownUnitError(quantity, cell[len(name) + 1 :])
                if name in re.split(r"[^a-z]+", cell.lower()) and quantity.units is not None and not quantity.required:
                    reason = f"{cell!r} is not read as {quantity.name}; choose the column of {quantity.name}"
                    raise FileError(table.path, f"{reason}, or leave it out with an empty name", table.header_line)
        if not quantity.required:
            return
    known = ", ".join(table.header[:MAX_NAMES]) + (", ..." if len(table.header) > MAX_NAMES else "")
    missing = f"no column {wanted!r}" if wanted is not None else f"no column of {quantity.name}"
    second = (
        ""
        if any(map(NUMBER.fullmatch, table.rows[0]))
        else f"; line {table.lines[0]} holds no numbers: keep one header"
    )
    raise FileError(table.path, f"{missing}; there are: {known}{second}", table.header_line)


def _numbers(table: Table, column: Column) -> list[float]:
    return [
        column.factor * _number(table, column, line, row[column.index])
        for line, row in zip(table.lines, table.rows, strict=True)
    ]


def _number(table: Table, column: Column, line: int, cell: str) -> float:
    name, header = column.quantity.name, table.header[column.index]
    if unit_in_header(column.quantity, header, named=False) is None:
        name = f"{name} ({header!r})"
    if not cell:
        raise FileError(table.path, f"{name} is missing: the cell is empty", line)
    cell = cell.replace(MINUS, "-")
    if not NUMBER.fullmatch(cell):
        hint = _hint(cell, first=line == table.lines[0])
        raise FileError(table.path, f"{name} must be a finite number, got {cell[:40]!r}{hint}", line)
    value = float(cell.lower().replace("d", "e"))
    if not math.isfinite(value):
        raise FileError(table.path, f"{name} must be a finite number, got {cell[:40]!r}", line)
    return value


def _hint(cell: str, *, first: bool) -> str:
    """Return the end of the message for a cell that is not a number."""
    if found := decimal_hint(cell):
        return found
    return "; is this a second header? Units may stand below the names, other text may not" if first else ""


def decimal_hint(cell: str) -> str:
    """Return the end of the message for a number with commas; empty for any other cell."""
    if THOUSANDS.fullmatch(cell):
        plain = cell.replace(",", "")
        if cell.count(",") == 1 and "." not in cell:
            return f"; write {plain} or {cell.replace(',', '.')}, whichever it means"
        return f"; write {plain}, without commas between thousands"
    if DECIMAL_COMMA.fullmatch(cell):
        return "; write decimals with a point"
    return ""


def _texts(table: Table, column: Column) -> list[str]:
    for line, row in zip(table.lines, table.rows, strict=True):
        if not row[column.index]:
            raise FileError(table.path, f"{column.quantity.name} is missing: the cell is empty", line)
    return [row[column.index] for row in table.rows]
