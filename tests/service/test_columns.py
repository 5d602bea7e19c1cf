"""Columns of tables agree with the contract."""

import pytest

from service.cli.writers import heading
from service.columns import UNITS, Column
from service.operations import OPERATIONS, Operation
from service.schemas.answers import Exit, MotionState
from service.schemas.fields import columns_of, part_of
from service.schemas.quantities import Part

SYMBOLS = {"deg": "°"}
"""Units whose names in tables have no special character."""


def description_of(model: type[Part], column: str) -> str:
    """Return the description of the field of a column, which is in a part if the column begins with its name."""
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
def test_columns_of_an_operation_are_described_and_differ(operation: Operation) -> None:
    names = [column.name for column in operation.columns]
    assert len(set(names)) == len(names)
    assert all(column.description for column in operation.columns)


def test_headings_have_units_as_people_write_them() -> None:
    found = {end: heading(f"a_mean{end}") for end in UNITS}
    assert found["_kg_m2"] == "a mean kg m²"
    assert found["_g"] == "a mean g"
    assert found["_deg"] == "a mean °"
    assert not any(sign in text for text in found.values() for sign in "_^")
