"""Columns of tables agree with the contract."""

import pytest

from service.columns import EXIT, MOTION, Column
from service.schemas.answers import Exit, MotionState
from service.schemas.quantities import Part

SYMBOLS = {"deg": "°"}
"""Units that a table writes without a special character."""


@pytest.mark.parametrize(
    ("column", "model", "prefix"),
    [*((column, MotionState, "") for column in MOTION), *((column, Exit, "exit_") for column in EXIT)],
    ids=lambda value: value.name if isinstance(value, Column) else "",
)
def test_column_has_the_unit_of_the_field(column: Column, model: type[Part], prefix: str) -> None:
    field = model.model_json_schema()["properties"][column.name.removeprefix(prefix)]
    assert column.description
    assert field["description"].endswith(f"[{SYMBOLS.get(column.unit, column.unit)}]")
