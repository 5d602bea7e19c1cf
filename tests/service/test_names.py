"""Every choice, input and formula of the contract has a display name, which is the same in every view."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.names import CHOICES, FORMULAS, JOB_STATUSES, OPERATIONS, OUTCOMES, QUANTITIES, STATUSES, UNITS
from service.reports.assessment_numbers import WORDS
from service.schemas.strike import PAPER_AT_45
from solver.formulas import formulas
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
from solver.uncertainty.strikes import PAIRED
from solver.uncertainty.verdict import ENDINGS
from tests.cli.commands import run

SCHEMAS = json.loads((Path(__file__).parents[2] / "openapi/openapi.json").read_text())["components"]["schemas"]
REQUESTS = ("TrajectoryRequest", "CriticalAngleRequest")
SETTINGS = re.compile(r"output\.|alternatives$|units$|numerics\.(panels|time_step_s)$")
"""Fields without a display name: they are not part of a case, or are settings of the panels."""
RAW = re.compile(r"\b[a-z]+_[a-z_0-9]+\b")


def fields(node: dict[str, Any], path: str = "") -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the path of every input in a schema, and its choices, if any."""
    if "$ref" in node:
        yield from fields(SCHEMAS[node["$ref"].rpartition("/")[2]], path)
    for name in node.get("discriminator", {}).get("mapping", ()):
        tag = node["discriminator"]["propertyName"]
        yield f"{path}.{tag}", (name,)
    for variant in node.get("oneOf", node.get("anyOf", ())):
        yield from fields(variant, path)
    for name, inner in node.get("properties", {}).items():
        yield from fields(inner, f"{path}.{name}".lstrip("."))
    if node.get("type") in ("number", "integer", "boolean", "array") or ("enum" in node and "properties" not in node):
        yield path, tuple(node.get("enum", ()))


FIELDS = sorted({each for name in REQUESTS for each in fields(SCHEMAS[name]) if not SETTINGS.match(each[0])})


def test_every_input_has_a_label() -> None:
    assert {path for path, _ in FIELDS} <= QUANTITIES.keys()


def test_every_choice_has_a_display_name_without_extra_ones() -> None:
    found: dict[str, set[str]] = {}
    for path, choices in FIELDS:
        if choices:
            found.setdefault(path, set()).update(choices)
    found["resistance.theory"] = set(PAIRED)  # This uncertain input is not a field of a case.
    assert found == {path: set(names) for path, names in CHOICES.items()}


def test_every_formula_has_a_display_name() -> None:
    answers = formulas(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=paper_impact(oblique_angle_degrees=0.0))
    assert {each.formula for each in answers} == FORMULAS.keys()


@pytest.mark.parametrize(
    ("names", "schemas"),
    [
        (OUTCOMES, ["Outcome"]),
        (STATUSES, ["SearchStatus", "PerforationStatus"]),
        (JOB_STATUSES, ["JobStatus"]),
        (OPERATIONS, ["JobOperation"]),
        (UNITS, ["UnitSystem"]),
    ],
)
def test_every_outcome_status_and_operation_has_a_display_name(names: dict[str, str], schemas: list[str]) -> None:
    assert {value for schema in schemas for value in SCHEMAS[schema]["enum"]} == names.keys()


def test_outcomes_have_the_names_used_in_verdicts() -> None:
    assert ENDINGS == OUTCOMES


def test_value_has_the_same_display_name_in_all_fields() -> None:
    for names in CHOICES.values():
        assert {value: WORDS[value] for value in names} == names


@pytest.mark.parametrize(
    "arguments",
    [
        "formulas",
        "thickness",
        "trajectory --set numerics.termination_time_s=1e-3 --alternatives",
        "cra --alternatives --set search.tolerance_deg=1",
        "cra -v --set search.lower_deg=40 --set search.upper_deg=60 --set target.thickness_m=0.3",
        "limit-speed -v --set target.thickness_m=0.1",
    ],
)
def test_commands_print_display_names_instead_of_identifiers(tmp_path: Path, arguments: str) -> None:
    (tmp_path / "strike.json").write_text(json.dumps(PAPER_AT_45))
    command, *flags = arguments.split()
    done = run(tmp_path, command, "strike.json", *flags)
    assert done.status == 0, done.err
    assert RAW.findall(done.out) == []
