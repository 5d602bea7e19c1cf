"""Studies of uncertainty: the same bytes with every executor, and equal studies computed only once."""

import asyncio
import json
from collections import Counter
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import AbstractAsyncContextManager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from service.cache.record import CaseResult, Record
from service.errors import QuotaError
from service.jobs.manager import JobManager
from service.jobs.models import JobCase, JobState
from service.jobs.studies import run_study
from service.operations import OPERATIONS, KeyedRequest
from service.schemas.strike import PAPER
from service.workers.dask_executor import DaskExecutor
from service.workers.executor import Executor
from service.workers.in_thread import InThreadExecutor
from service.workers.process_pool import ProcessPool
from tests.service import squares
from tests.service.squares import ended

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(300)]
SPEED = {"field": "impact.velocity_m_s", "distribution": {"type": "normal", "mean": 238.0, "standard_deviation": 2.4}}
DECAY = {
    "field": "resistance.free_surface.model",
    "distribution": {"type": "discrete", "values": ["elastic_plastic", "mohr_coulomb"], "weights": [0.8, 0.2]},
}
SAMPLING = {"max_samples": 300, "half_width": 1e-4, "seed": 7}
ROUGH = {"lower_deg": 40.0, "upper_deg": 60.0, "tolerance_deg": 1.0}
STUDIES = {
    "trajectory_uncertainty": PAPER
    | {
        "impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 48.7},
        "uncertain": [SPEED, DECAY],
        "sampling": SAMPLING,
    },
    "direct": PAPER | {"uncertain": [SPEED], "search": ROUGH, "sampling": SAMPLING | {"method": "direct"}},
    "direct with indices": PAPER
    | {"uncertain": [SPEED], "search": ROUGH, "sampling": SAMPLING | {"method": "direct", "max_samples": 600}},
    "surrogate": PAPER | {"uncertain": [SPEED], "sampling": SAMPLING | {"half_width": 0.1}},
}
STRIKE = "trajectory_uncertainty"
PARTS: dict[type[Executor], int] = {InThreadExecutor: 256, ProcessPool: 16, DaskExecutor: 256}
"""Number of samples in a chunk, by executor."""


def operation_of(name: str) -> str:
    return name if name == STRIKE else "cra_uncertainty"


def request_of(name: str, seed: int = 7) -> tuple[KeyedRequest, Any]:
    """Return the request for a study with its key, and the validated model."""
    body, operation = STUDIES[name], operation_of(name)
    study: Any = OPERATIONS[operation].request.model_validate(body | {"sampling": body["sampling"] | {"seed": seed}})
    return KeyedRequest.of(operation, study), study


def running(
    folder: Path, executor: Executor, counts: Counter[str] | None = None
) -> AbstractAsyncContextManager[JobManager]:
    """Run a job manager with an empty cache, which counts computed samples by operation."""

    def count(operation: str, _: str, status: str, number: int) -> None:
        if counts is not None and status == "miss":
            counts[operation] += number

    return squares.running(folder, executor, OPERATIONS, count=count)


@cache
def computed_alone(name: str) -> bytes:
    """Return the answer to a study computed in this process, sample by sample."""
    request, _ = request_of(name)
    operation = operation_of(name)
    answer, _ = OPERATIONS[operation].compute(request.json)
    return Record(request.key, operation, request.json, answer).json


@pytest.fixture(params=["in-process", "pool", pytest.param("dask", marks=pytest.mark.system)])
async def executor(request: pytest.FixtureRequest) -> AsyncIterator[Executor]:
    found: Executor
    if request.param == "in-process":
        found = InThreadExecutor(task_seconds=60.0)
    elif request.param == "dask":
        found = DaskExecutor(address=request.getfixturevalue("cluster").address, workers=2, task_seconds=60.0)
    else:
        found = ProcessPool(workers=2, task_seconds=60.0)
    await found.start()
    yield found
    await found.stop(2.0)


@pytest.mark.parametrize("name", STUDIES)
async def test_equal_seeds_give_the_same_bytes_with_every_executor(
    executor: Executor, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    request, study = request_of(name)
    monkeypatch.setattr("service.jobs.studies.PART", PARTS[type(executor)])
    async with running(tmp_path, executor) as manager:
        record, status = await manager.answer_study(operation_of(name), request, study)
    assert status == "miss"
    assert record.json == computed_alone(name)


def test_studies_cover_both_methods_and_sensitivity_indices() -> None:
    answers = {name: json.loads(computed_alone(name)) for name in STUDIES if name != STRIKE}
    assert {name: each["method"] for name, each in answers.items()} == {
        "direct": "direct",
        "direct with indices": "direct",
        "surrogate": "surrogate",
    }
    indexed = {name for name, each in answers.items() if all("total" in part for part in each["sensitivity"])}
    assert indexed == {"direct with indices", "surrogate"}


async def test_curve_of_a_round_is_reported_before_the_next_round(thread: Executor, tmp_path: Path) -> None:
    operation = "cra_uncertainty"
    body = STUDIES["direct"] | {"sensitivity": False}
    body["sampling"] = body["sampling"] | {"max_samples": 512}
    study: Any = OPERATIONS[operation].request.model_validate(body)
    computed, reported = 0, []

    async def report(progress: dict[str, Any], partial: dict[str, Any] | None) -> None:
        if partial is not None:
            reported.append((computed, progress["samples"], partial["convergence"]["samples"][-1]))

    async with running(tmp_path, thread) as manager:

        async def run(name: str, cases: Sequence[JobCase], more: int) -> AsyncGenerator[CaseResult, None]:
            nonlocal computed
            async for result in manager.run_now(name, cases, more):
                computed += 1
                yield result

        answer = await run_study(operation, study, run, take=lambda _: None, report=report, limiter=None)
    assert reported == [(256, 256, 256)]
    assert answer["samples"] == computed == 512


async def test_equal_concurrent_studies_are_computed_once(thread: Executor, tmp_path: Path) -> None:
    request, study = request_of(STRIKE)
    counts: Counter[str] = Counter()
    async with running(tmp_path, thread, counts) as manager:
        found = await asyncio.gather(*(manager.answer_study(STRIKE, request, study) for _ in range(3)))
    assert sorted(status for _, status in found) == ["hit", "hit", "miss"]
    assert {record.json for record, _ in found} == {computed_alone(STRIKE)}
    assert counts == {"trajectory": found[0][0].answer["samples"]}


async def test_shared_study_continues_if_the_first_client_cannot(thread: Executor, tmp_path: Path) -> None:
    request, study = request_of(STRIKE)

    def refuse(count: int) -> None:
        raise QuotaError(10, count, 4, 60)

    async with running(tmp_path, thread) as manager:
        poor = asyncio.ensure_future(manager.answer_study(STRIKE, request, study, take=refuse))
        gone = asyncio.ensure_future(manager.answer_study(STRIKE, request, study))
        other = asyncio.ensure_future(manager.answer_study(STRIKE, request, study))
        with pytest.raises(QuotaError):
            await poor
        await asyncio.sleep(0.1)
        gone.cancel()
        record, status = await other
    assert status == "miss"
    assert record.json == computed_alone(STRIKE)


async def accepted(manager: JobManager, request: KeyedRequest, owner: str) -> JobState:
    async def block() -> AsyncIterator[Sequence[JobCase]]:
        yield [JobCase(request)]

    state, _ = await manager.accept(STRIKE, block(), owner=owner)
    return state


async def test_equal_concurrent_jobs_share_one_study_and_its_progress(thread: Executor, tmp_path: Path) -> None:
    request, _ = request_of(STRIKE)
    counts: Counter[str] = Counter()
    async with running(tmp_path, thread, counts) as manager:
        jobs = [await accepted(manager, request, owner) for owner in ("one", "two")]
        states = [await ended(manager, job) for job in jobs]
    assert [state.status for state in states] == ["successful"] * 2
    assert sorted(state.cached for state in states) == [0, 1]
    first, second = (state.progress for state in states)
    assert first == second
    assert first is not None
    assert counts["trajectory"] == first["samples"]


async def test_equal_job_takes_over_the_study_of_a_cancelled_one(
    thread: Executor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.jobs.studies.PART", 32)
    request, _ = request_of(STRIKE)
    async with running(tmp_path, thread) as manager:
        first, second = [await accepted(manager, request, owner) for owner in ("one", "two")]
        async for state in manager.changes(second.id):
            if state.progress is not None:
                break
        dismissed = await manager.cancel(first.id, "one")
        assert dismissed is not None
        assert dismissed.status == "dismissed"
        state = await ended(manager, second)
    assert (state.status, state.cached) == ("successful", 0)


async def test_study_that_a_client_waits_for_does_not_wait_for_a_job(thread: Executor, tmp_path: Path) -> None:
    request, study = request_of(STRIKE)
    async with running(tmp_path, thread) as manager:
        job = await accepted(manager, request, "one")
        async for state in manager.changes(job.id):
            if state.progress is not None:
                break
        record, _ = await manager.answer_study(STRIKE, request, study)
        assert record.json == computed_alone(STRIKE)
        assert (await ended(manager, job)).status == "successful"
