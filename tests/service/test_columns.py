"""Columns of tables have the units and descriptions of the contract."""

from enum import Enum
from typing import Any, get_origin

import pytest

from service.cli.writers import heading
from service.columns import UNITS, Column, summarize
from service.operations import OPERATIONS, Operation
from service.schemas.answers import Exit, MotionState
from service.schemas.fields import columns_of, kind_of, part_of
from service.schemas.quantities import Part

SYMBOLS = {"deg": "°"}
"""Units that column names spell without special characters."""


def description_of(model: type[Part], column: str) -> str:
    """Return the description of the field for a column; the name of a nested field follows the name of its part."""
    properties: dict[str, dict[str, str]] = model.model_json_schema()["properties"]
    if column in properties:
        return properties[column]["description"]
    [(name, part)] = [
        (f"{name}_", part) for name in properties if column.startswith(f"{name}_") and (part := part_of(model, name))
    ]
    return description_of(part, column.removeprefix(name))


@pytest.mark.parametrize(
    ("column", "model"),
    [(column, model) for model in (MotionState, Exit) for column in columns_of(model)],
    ids=lambda value: value.name if isinstance(value, Column) else "",
)
def test_column_has_the_unit_of_the_field(column: Column, model: type[Part]) -> None:
    described = description_of(model, column.name)
    assert described.endswith(f"[{SYMBOLS.get(column.unit, column.unit)}]")


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=lambda each: each.name)
def test_columns_of_an_operation_have_descriptions_and_distinct_names(operation: Operation) -> None:
    names = [column.name for column in operation.columns]
    assert len(set(names)) == len(names)
    assert all(column.description for column in operation.columns)


def filled(model: type[Part]) -> dict[str, Any]:
    """Return an answer with a value in every field, optional ones and parts included."""
    found: dict[str, Any] = {}
    for name, info in model.model_fields.items():
        kind, part = kind_of(info.annotation), part_of(model, name)
        value: Any = filled(part) if part else "x" if isinstance(kind, type) and issubclass(kind, str) else 1.0
        found[name] = value if get_origin(kind) is not list else one_of_each(part, value) if part else [1.0, 2.0]
    return found


def one_of_each(model: type[Part], value: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the items of a list of parts: one for each name if the parts have names, such as outcomes, else one."""
    kinds = {name: kind_of(info.annotation) for name, info in model.model_fields.items()}
    names = {name: kind for name, kind in kinds.items() if isinstance(kind, type) and issubclass(kind, Enum)}
    return [value | {name: each.value} for name, kind in names.items() for each in kind] or [value]


@pytest.mark.parametrize("operation", [each for each in OPERATIONS.values() if each.many], ids=lambda each: each.name)
def test_every_column_of_a_batch_is_filled_from_an_answer(operation: Operation) -> None:
    assert {column.name for column in operation.columns} <= summarize(filled(operation.answer)).keys()


def test_headings_have_units_in_usual_notation() -> None:
    found = {end: heading(f"a_mean{end}") for end in UNITS}
    assert found["_kg_m2"] == "a mean kg m²"
    assert found["_g"] == "a mean g"
    assert found["_deg"] == "a mean °"
    assert not any(sign in text for text in found.values() for sign in "_^")
