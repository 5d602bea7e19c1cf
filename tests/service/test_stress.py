"""The parts of the stress measurement that could be wrong without anyone noticing."""

import json
import math
from collections.abc import Callable
from contextlib import closing
from itertools import islice, product
from pathlib import Path

import pytest

from benchmarks.random_cases import one_by_one, random_cases
from benchmarks.stress.bodies import to_arguments, to_requests
from benchmarks.stress.faults_found import Found
from benchmarks.stress.lines import Line
from benchmarks.stress.mutations import ROUTES, mutants
from benchmarks.stress.report import as_json, as_table, write_part
from benchmarks.stress.servers import empty_service
from benchmarks.stress.soak import Sizes, measure_soak
from benchmarks.stress.soak_answers import Answers, is_right
from benchmarks.stress.soak_footprint import Footprint
from benchmarks.stress.soak_lines import as_lines
from benchmarks.stress.soak_work import Mix, Work, asked, invalid_bodies
from service.schemas.batches import CriticalAngleCase
from service.schemas.quantities import degrees
from solver import critical_angle

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


def line(number: int, measured: str) -> Line:
    return Line(number=number, what="this", required="that", measured=measured, held=True)


def test_parts_that_are_not_measured_stay_in_the_report(tmp_path: Path) -> None:
    machine = {"processor": "A", "cores": 2, "memory_gb": 4, "os": "B"}
    for part, measured_at, lines in (
        ("load", "Monday", [line(1, "fast")]),
        ("soak", "Tuesday", [line(11, "held for long")]),
        ("load", "Wednesday", [line(1, "faster")]),
    ):
        about = {"machine": machine, "measured_at": measured_at, "command": part, "duration_s": 1.0, "versions": {}}
        write_part(tmp_path, part, as_json(about, lines))
    parts = json.loads((tmp_path / "stress.json").read_text(encoding="utf-8"))["parts"]
    assert {name: part["measured_at"] for name, part in parts.items()} == {"load": "Wednesday", "soak": "Tuesday"}
    page = (tmp_path / "stress.md").read_text(encoding="utf-8")
    assert all(told in page for told in ("faster", "held for long", "Tuesday", "Wednesday"))
    assert "Monday" not in page


def test_jobs_of_the_soak_ask_for_what_their_names_say() -> None:
    mix = Mix(60)
    first, sweep, second = mix.batch(), mix.sweep(), mix.batch()
    for work in (first, second):
        for index, text in enumerate(work.body.splitlines()):
            case = json.loads(text)
            assert case.pop("custom_id") == work.custom_id(index)
            assert case == asked(work.names[index])
    assert len(set(second.names) - set(first.names)) == round(0.4 * 60)
    laid = json.loads(sweep.body)
    values = [axis["values"] for axis in laid["axes"]]
    points = [dict(zip(("velocity_m_s", "oblique_angle_deg"), point, strict=True)) for point in product(*values)]
    assert [asked(name)["impact"] for name in sweep.names] == points
    assert all(asked(name)["target"] == laid["base"]["target"] for name in sweep.names)


def test_soak_notices_an_answer_that_the_solver_does_not_give() -> None:
    angle = critical_angle(**to_arguments(asked("search 1"))).angle
    assert angle is not None
    assert is_right("search 1", json.dumps({"critical_angle_deg": degrees(angle)}).encode())
    assert not is_right("search 1", json.dumps({"critical_angle_deg": degrees(angle) + 1e-9}).encode())


def test_invalid_bodies_differ() -> None:
    assert len(set(islice(invalid_bodies(seed=1), 50))) > 40


def results_of(work: Work) -> list[bytes]:
    """Results as the service sends them, each with an answer of its own."""
    return [
        json.dumps({"index": index, "custom_id": work.custom_id(index)}, separators=(",", ":")).encode()[:-1]
        + b',"result":{"key":"%b"}}' % name.encode()
        for index, name in enumerate(work.names)
    ]


@pytest.mark.parametrize(
    ("change", "noticed"),
    [
        (lambda lines: lines, False),
        (lambda lines: lines[:3] + lines[4:], True),
        (lambda lines: [*lines[:3], lines[2], *lines[3:]], True),
        (lambda lines: [lines[1], lines[0], *lines[2:]], True),
        (lambda lines: [*lines[:-1], lines[-1].replace(b"search", b"other")], True),
        (lambda lines: [*lines[:-1], lines[-1].replace(b'"result"', b'"problem"')], True),
    ],
    ids=["as they are", "one lost", "one twice", "out of order", "another answer", "no result"],
)
def test_soak_notices_results_that_are_lost_doubled_or_wrong(
    change: Callable[[list[bytes]], list[bytes]], noticed: bool
) -> None:
    found, work = Found(), Mix(10).batch()
    answers = Answers(found)
    assert answers.hold_results(work, results_of(work)) == 10
    assert not found.faults
    answers.hold_results(work, change(results_of(work)))
    assert bool(found.faults) == noticed


@pytest.mark.parametrize(
    ("megabytes", "handles", "held"),
    [
        ([50, 100, 109, 91, 100], [9, 9, 9, 9, 9], (True, True)),
        ([50, 100, 111, 100, 100], [9, 9, 12, 9, 9], (False, True)),
        ([50, 100, 100, 100, 100], [8, 9, 9, 9, 10], (True, False)),
    ],
)
def test_memory_and_open_files_are_held_to_those_after_the_warm_up(
    megabytes: list[int], handles: list[int], held: tuple[bool, bool]
) -> None:
    calm = [
        Footprint(
            round=number // 2,
            server_bytes=10**6 * megabytes[number // 2],
            all_bytes=10**9,
            server_handles=handles[number // 2],
            all_handles=20,
            processes=5,
        )
        for number in range(10)
    ]
    asked = {"cases of jobs": 1}
    details = {"asked": asked, "calm_cases": 1, "different_cases": 1, "computed_anew": 1, "seconds": 1.0}
    _, memory, files = as_lines(Found(), details, calm[1:])
    assert (memory.held, files.held) == held


def test_the_route_that_does_nothing_is_served_with_the_options_of_the_service() -> None:
    """What a hot answer is measured against; it needs whatever the service's connections need."""
    with empty_service() as server, closing(server.connect()) as connection:
        connection.request("GET", "/empty")
        response = connection.getresponse()
        assert (response.status, response.read()) == (200, b"null")


@pytest.mark.skipif(not Path("/proc/self/smaps_rollup").exists(), reason="looks at processes in /proc")
def test_mixed_load_is_answered_once_and_right() -> None:
    results, *_ = measure_soak(Sizes(rough=0, calm=2, cases=30, hurts=0, idle=0.0, sample=10))
    assert not results.details["faults"]
    assert results.held
    asked = results.details["asked"]
    assert asked["cases of jobs"] == asked["results read at the end"] == 2 * 4 * 30
    kinds = ("single queries", "downloads of jobs", "invalid bodies", "jobs cancelled", "jobs read by cursor")
    assert all(asked[kind] for kind in kinds)
