"""The parts of the stress measurement that could be wrong without anyone noticing."""

import json
import math
from pathlib import Path

import pytest

from benchmarks.random_cases import one_by_one, random_cases
from benchmarks.stress.bodies import to_arguments, to_requests
from benchmarks.stress.lines import Line
from benchmarks.stress.mutations import ROUTES, mutants
from benchmarks.stress.report import as_table
from service.schemas.batches import CriticalAngleCase

CONTRACT = Path(__file__).parents[2] / "openapi" / "openapi.json"
COUNT = 20


def test_bodies_ask_for_the_random_cases() -> None:
    cases = random_cases(COUNT, seed=1)
    for request, case in zip(to_requests(cases), one_by_one(cases), strict=True):
        arguments = to_arguments(request)
        for name in ("projectile", "target", "velocity", "resistance"):
            assert arguments[name] == case[name]
        assert math.isclose(arguments["angle_of_attack"], case["angle_of_attack"], rel_tol=1e-14)
        CriticalAngleCase.model_validate(request)


def test_mutants_are_the_same_for_the_same_seed() -> None:
    assert list(mutants(200, seed=1)) == list(mutants(200, seed=1))
    assert list(mutants(200, seed=1)) != list(mutants(200, seed=2))


def test_mutants_go_to_every_route_that_takes_a_body() -> None:
    paths = json.loads(CONTRACT.read_text(encoding="utf-8"))["paths"]
    declared = {
        (path, media_type)
        for path, operations in paths.items()
        for media_type in operations.get("post", {}).get("requestBody", {}).get("content", {})
    }
    assert set(ROUTES) == declared
    assert {mutant.path for mutant in mutants(100, seed=1)} == {path for path, _ in declared}


def test_few_mutants_are_alike() -> None:
    assert len(set(mutants(1_000, seed=1))) > 800


@pytest.mark.parametrize(
    ("held", "told"), [(True, "| held |"), (False, "| **not held** |"), (None, "| not measured |")]
)
def test_table_tells_whether_a_line_held(held: bool | None, told: str) -> None:
    line = Line(number=3, what="this", required="that", measured="1 of 2", held=held)
    assert f"| 3 | this | that | 1 of 2 {told}" in as_table([line])
