"""The cases of a batch as a CSV table: a row for each case, and a column for each field that it gives."""

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

from service.cli.arguments import BODY, MODEL_NAMES, RESISTANCE, CommandError, Flag
from service.cli.request_body import put_field, put_model, read_text

ENDINGS = frozenset({".csv", ".tsv"})
SEPARATORS = ",;\t"
CUSTOM_ID = "custom_id"
MAX_SHOWN = 100
"""Characters of a name that an error quotes, and compares with those of the fields."""


def read_cases(file: Path, operation: str, base: Mapping[str, Any]) -> tuple[list[bytes], list[int]]:
    """Return the request of each row as JSON, and the line of the file where it ends.

    Parameters
    ----------
    base
        Fields of every case, in place of which go those of a row; an empty cell gives none.

    Raises
    ------
    CommandError
        If a column is not a field of a request or a row has more cells than the header; it names the line.
    """
    text = read_text(file)
    header = text.partition("\n")[0]
    rows = csv.reader(io.StringIO(text), delimiter=max(SEPARATORS, key=header.count))
    fields, columns = _fields(operation), list[tuple[str, ...]]()
    cases, lines = list[bytes](), list[int]()
    for cells in _rows(file, rows):
        if not columns:
            columns = [_steps(name.strip(), fields, f"{file}:1") for name in cells]
            continue
        place = f"{file}:{rows.line_num}"
        if len(cells) > len(columns):
            raise CommandError(f"{place}: {len(cells)} cells for {len(columns)} columns")
        given = [(steps, cell.strip()) for steps, cell in zip(columns, cells, strict=False) if cell.strip()]
        if given:
            cases.append(json.dumps(_case(base, given, place)).encode())
            lines.append(rows.line_num)
    return cases, lines


def _rows(file: Path, rows: Any) -> Iterator[list[str]]:
    try:
        yield from rows
    except csv.Error as error:  # A cell has more than 131,072 characters, or a quoted one goes on to the end.
        raise CommandError(f"{file}:{rows.line_num}: not a CSV file: {error}") from None


def _fields(operation: str) -> list[str]:
    """Return the fields of a case, their steps with dots between them."""
    from service.operations import OPERATIONS
    from service.schemas.explanations import field_names
    from service.schemas.sweeps import schema_of

    many = OPERATIONS[operation].many
    assert many is not None  # noqa: S101 (a choice of the command)
    return sorted(set(field_names(schema_of(many.models.case), in_lists=False)))


def _steps(name: str, fields: Sequence[str], place: str) -> tuple[str, ...]:
    """Return the path of the field that a column gives by its whole name or the end of it."""
    from service.schemas.explanations import suggestion

    found = [name] if name in fields else [field for field in fields if field.endswith(f".{name}")]
    # The length of a projectile comes before that of its boat-tail.
    found = [field for field in found if field.count(".") == min(each.count(".") for each in found)]
    shown = name[:MAX_SHOWN]
    if not name or len(found) > 1:
        raise CommandError(f"{place}: column {shown!r}: must be one of {', '.join(found) or 'the fields of a request'}")
    if not found:
        raise CommandError(f"{place}: column {shown!r}: is not a field of a request{suggestion(f'/{shown}')}")
    return tuple(found[0].split("."))


def _case(base: Mapping[str, Any], given: Sequence[tuple[tuple[str, ...], str]], place: str) -> dict[str, Any]:
    """Return the request of a row; a nose or a law that is not named is that of its numbers, as with flags."""
    flags = {flag.steps: flag for flag in (*BODY, *RESISTANCE) if flag.steps[:-1] in MODEL_NAMES}
    case, chosen = deepcopy(dict(base)), list[tuple[Flag, Any]]()
    try:
        for steps, cell in given:
            value = cell if steps == (CUSTOM_ID,) else _value(cell)
            if steps in flags:
                chosen.append((flags[steps], value))
            else:
                put_field(case, steps, value, cell)
        for part in MODEL_NAMES:
            put_model(case, part, [(flag, value) for flag, value in chosen if flag.steps[:-1] == part])
    except CommandError as error:
        raise CommandError(f"{place}: {error}") from None
    return case


def _value(cell: str) -> Any:
    try:
        return json.loads(cell)
    except (ValueError, RecursionError):
        return cell  # The cell is a word, such as the name of a model, or validation refuses it.
