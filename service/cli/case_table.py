"""Tables of cases: one row for each case, and one column for each field."""

import json
import re
from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

from service.cli.arguments import BODY, MODEL_NAMES, RESISTANCE, CommandError, Flag
from service.cli.request_body import MISSING, put_field, put_model
from service.columns import unit_end
from service.names import ALIASES
from service.readers.files import FileError
from service.readers.table import (
    ANGULAR_VELOCITY,
    BRACKETED,
    DENSITY,
    INERTIA,
    LENGTH,
    MASS,
    MINUS,
    NUMBER,
    PRESSURE,
    SPEED,
    TIME,
    Table,
    decimal_hint,
    read_table,
    spelled,
)

CUSTOM_ID = "custom_id"
UNITS: Mapping[str, Mapping[str, float]] = {
    "_m": LENGTH,
    "_s": TIME,
    "_m_s": SPEED,
    "_kg": MASS,
    "_deg": {"deg": 1.0, "rad": 57.29577951308232},
    "_rad_s": ANGULAR_VELOCITY,
    "_pa": PRESSURE,
    "_kg_m3": DENSITY,
    "_kg_m2": INERTIA,
}
"""Accepted units of a column, by the suffix of its field, each with the factor that converts it to the unit of the
field."""
GREEK = str.maketrans({"ρ": "rho", "ψ": "psi", "θ": "theta", "ω": "omega", "ν": "nu"})
APOSTROPHES = re.compile("['\N{PRIME}\N{RIGHT SINGLE QUOTATION MARK}]")
NO_WORD = re.compile(r"[^a-z0-9]+")
SOUGHT = ("impact.oblique_angle_deg", "impact.velocity_m_s", "target.thickness_m")
"""Fields that a search determines, and that its cases therefore lack."""
NEEDED = frozenset(
    (
        "projectile.diameter_m",
        "projectile.length_m",
        "projectile.mass_kg",
        "target.compressive_strength_pa",
        "target.density_kg_m3",
        "impact.velocity_m_s",
        "impact.oblique_angle_deg",
    )
)
"""Fields whose columns must not have empty cells: a gap is more likely a mistake than a request for the value in the
`--case` file."""
MAX_SHOWN = 40
"""Largest number of characters of a header or a cell that are quoted in an error, about half a line. An
unknown header is also cut to this length before a similar field is sought."""
MAX_COLUMNS = 10
"""Largest number of columns named in one error, an arbitrary choice: a longer list would not be read."""


class Column(NamedTuple):
    """A column of a table and its field.

    Parameters
    ----------
    header
        Header as typed; if a second line has the unit, it follows in brackets.
    steps
        Path of the field; empty if the column is only copied to the output.
    factor
        Factor that converts the unit of the column to the unit of the field.
    """

    header: str
    steps: tuple[str, ...]
    factor: float = 1.0

    @property
    def pointer(self) -> str:
        """JSON pointer of the field."""
        return "".join(f"/{step}" for step in self.steps)


def is_needed(column: Column) -> bool:
    """Return True if a column must not have empty cells."""
    return ".".join(column.steps) in NEEDED


class Row(NamedTuple):
    """A row of a table.

    Parameters
    ----------
    line
        Line in the file, or row of the sheet.
    cells
        Cells as typed.
    case
        Request; empty if there is an error.
    error
        Reason why there is no request; empty if there is one.
    """

    line: int
    cells: Sequence[str]
    case: Mapping[str, Any]
    error: str = ""


@dataclass(frozen=True, slots=True)
class CaseTable:
    """Cases of a table, in the order of its rows."""

    path: Path
    columns: Sequence[Column]
    rows: Sequence[Row]

    def gives(self, pointer: str) -> bool:
        """Return True if a column sets the field at a pointer or a part of it."""
        return any(f"{column.pointer}/".startswith(f"{pointer}/") for column in self.columns if column.steps)

    def described(self, row: Row, pointer: str, detail: str) -> str:
        """Return an error message that begins with the place of the cell; empty if no cell sets the field."""
        name, _, of_model = detail.removeprefix("`").partition("` ")
        if of_model:  # The error of an unknown model points to the whole part, but the cell at fault names the model.
            pointer, detail = f"{pointer}/{name}", of_model
        for column, cell in zip(self.columns, row.cells, strict=True):
            if column.steps and column.pointer == pointer:
                place = f"{self.path}:{row.line}: {column.header}"
                if cell:
                    typed = f"; the cell has {cell[:MAX_SHOWN]}" if column.factor != 1.0 else ""
                    return f"{place}: {detail}{typed}{decimal_hint(cell)}"
                if detail == MISSING:
                    return f"{place}: the cell is empty"
        if detail == MISSING:  # If all cells of an object are empty, the pointer names the object.
            for column, cell in zip(self.columns, row.cells, strict=True):
                if column.pointer.startswith(f"{pointer}/") and is_needed(column) and not cell:
                    return f"{self.path}:{row.line}: {column.header}: the cell is empty"
        return ""


class UnknownColumnsError(CommandError):
    """Columns of a table are not fields of a case.

    Parameters
    ----------
    text
        Message with the columns and suggestions.
    fields
        Names of all fields.
    """

    def __init__(self, text: str, fields: Sequence[str]) -> None:
        super().__init__(text)
        self.fields = fields


def read_cases(file: Path, operation: str, base: Mapping[str, Any], keep: Collection[str] = ()) -> CaseTable:
    """Read the cases of a table. Empty rows are skipped.

    Parameters
    ----------
    base
        Fields of every case. Cells that are not empty override them.
    keep
        Headers of columns that are not fields and are only copied to the output.

    Raises
    ------
    CommandError
        If the file is not a table, or columns are not fields of a case.
    """
    try:
        table = read_table(file, gaps=True)
    except FileError as error:
        raise CommandError(str(error)) from None
    columns = _columns(table, _fields(operation), keep)
    rows = (Row(line, cells, {}) for line, cells in zip(table.lines, table.rows, strict=True))
    return CaseTable(file, columns, [_with_case(row, columns, base) for row in rows])


def _fields(operation: str) -> list[str]:
    """Return the dotted paths of the fields of a case."""
    from service.operations import OPERATIONS
    from service.schemas.similar_names import field_names
    from service.schemas.sweeps import schema_of

    many = OPERATIONS[operation].many
    assert many is not None  # noqa: S101 (a choice of the command)
    names = sorted(set(field_names(schema_of(many.models.case), in_lists=False)))
    parts = {name.rpartition(".")[0] for name in names} | {name.partition(".")[0] for name in names if "." in name}
    return [name for name in names if name not in parts]


def _columns(table: Table, fields: Sequence[str], keep: Collection[str]) -> list[Column]:
    """Match the columns of a table to fields.

    Raises
    ------
    CommandError
        If some columns are not fields, or two of them set the same field.
    """
    columns, unknown = list[Column](), list[str]()
    by_field = dict[str, str]()
    for header in table.header:
        field, factor, problem = "", 1.0, ""
        stem = BRACKETED.fullmatch(header)
        if not header:
            problem = "without a name: has cells"
        elif header not in keep and (stem["stem"] if stem else header) not in keep:
            field, factor, problem = _field_of(header, fields)
        if problem:
            unknown.append(problem)
        elif field == CUSTOM_ID and field in by_field:
            field = ""  # A table may have columns for both an id and a name; the first becomes the name of the case.
        elif field in by_field:
            unknown.append(f"{header[:MAX_SHOWN]!r} gives {field} as {by_field[field]!r} does")
        if field:
            by_field[field] = header[:MAX_SHOWN]
        columns.append(Column(header, tuple(field.split(".")) if field else (), factor))
    if unknown:
        more = f" and {len(unknown) - MAX_COLUMNS} more" if len(unknown) > MAX_COLUMNS else ""
        text = f"{table.path}:{table.header_line}: column {'; column '.join(unknown[:MAX_COLUMNS])}{more}"
        raise UnknownColumnsError(f"{text}; --keep HEADER only copies a column to the output", fields)
    return columns


def _field_of(header: str, fields: Sequence[str]) -> tuple[str, float, str]:
    """Return the field of a column, the conversion factor of its unit, and the error of an invalid header."""
    from service.schemas.similar_names import meant_as

    shown = repr(header[:MAX_SHOWN])
    bracketed = BRACKETED.fullmatch(header)
    stem, unit = (bracketed["stem"].strip(), spelled(bracketed["unit"])) if bracketed else (header.strip(), "")
    found = {field: unit for field in fields if field == stem or field.endswith(f".{stem}")}
    name = "number" if stem == "#" else NO_WORD.sub("_", APOSTROPHES.sub("", stem.lower().translate(GREEK))).strip("_")
    if not found:
        found = {field: unit or given for field in fields if (given := _unit_in(name, field)) is not None}
    # The field with the shortest path takes precedence: the length of the projectile, not the length of its boat-tail.
    nearest = min((field.count(".") for field in found), default=0)
    found = {field: unit for field, unit in found.items() if field.count(".") == nearest}
    if len(found) > 1:
        return "", 1.0, f"{shown}: must be one of {', '.join(found)}"
    if not found:
        if any(_unit_in(name, field) is not None for field in SOUGHT if field not in fields):
            return "", 1.0, f"{shown}: is computed by the search"
        meant = meant_as(stem[:MAX_SHOWN], fields)
        return "", 1.0, f"{shown}: is no field of a case" + (f", did you mean {meant}?" if meant else "")
    [(field, unit)] = found.items()
    units = UNITS.get(unit_end(field), {})
    if unit in {"", "1"}:
        return field, 1.0, ""
    if unit not in units:
        known = f"unknown unit of {field}, known are {', '.join(units)}" if units else f"{field} has no unit"
        return "", 1.0, f"{shown}: {known}"
    return field, units[unit], ""


def _remove_field(body: dict[str, Any], steps: Sequence[str]) -> None:
    holder: Any = body
    for step in steps[:-1]:
        holder = holder.get(step) if isinstance(holder, dict) else None
    if isinstance(holder, dict):
        holder.pop(steps[-1], None)


def _unit_in(name: str, field: str) -> str | None:
    """Return the unit in a column name that matches a field, or an empty string; None if the name does not match."""
    last = field.rpartition(".")[2]
    names = {*ALIASES.get(field, ()), last.removesuffix(unit_end(last))}
    if name in names:
        return ""
    return next((unit for unit in UNITS.get(unit_end(last), {}) for each in names if name == f"{each}_{unit}"), None)


def _with_case(row: Row, columns: Sequence[Column], base: Mapping[str, Any]) -> Row:
    """Return a row with its request or its error. As with flags, a field of a nose or a law selects the model."""
    flags = {flag.steps: flag for flag in (*BODY, *RESISTANCE) if flag.steps[:-1] in MODEL_NAMES}
    case, chosen = deepcopy(dict(base)), list[tuple[Flag, Any]]()
    try:
        for column, cell in zip(columns, row.cells, strict=True):
            if is_needed(column) and not cell:
                _remove_field(case, column.steps)
            if not (column.steps and cell):
                continue
            value = cell if column.steps == (CUSTOM_ID,) else _value(cell, column.factor)
            if isinstance(value, str) and MODEL_NAMES.get(column.steps[:-1]) == column.steps[-1]:
                value = NO_WORD.sub("_", cell.lower())
            if column.steps in flags:
                chosen.append((flags[column.steps]._replace(name=column.header), value))
            else:
                put_field(case, column.steps, value, column.header)
        for part in MODEL_NAMES:
            put_model(case, part, [(flag, value) for flag, value in chosen if flag.steps[:-1] == part])
    except CommandError as error:
        return row._replace(error=str(error))
    return row._replace(case=case)


def _value(cell: str, factor: float) -> Any:
    """Convert a cell to a JSON value in the unit of its field. Words remain strings, which are validated later."""
    cell = cell.replace(MINUS, "-")
    is_number = NUMBER.fullmatch(cell) is not None
    if is_number and factor != 1.0:
        # Decimal arithmetic converts 80 mm to exactly 0.08 m, so that the case has the same key as one in metres.
        return float(Decimal(cell.lower().replace("d", "e")) * Decimal(repr(factor)))
    try:
        return json.loads(cell)
    except (ValueError, RecursionError):
        return float(cell.lower().replace("d", "e")) if is_number else cell
