"""Chunks on a Dask cluster of real processes over TCP, beside the pool: `make cluster`.

Writes cluster.json and cluster.md. All processes share the cores of this machine, so what is measured of the solver is
the machine's, and what is measured with calls that do nothing, or sleep, is the cluster's.
"""

import argparse
import asyncio
import json
import operator
import pickle
import statistics
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.machine import machine, versions
from benchmarks.random_cases import one_by_one, study_cases
from benchmarks.tables import table
from service.dask.executor import DaskExecutor
from service.workers.base import Call, CallResult, Executor
from service.workers.process_pool import ProcessPool
from solver import CriticalAngle, critical_angle
from tests.service.dask_cluster import dask_cluster
from tests.service.squares import accepted, cases, ended, running

HERE = Path(__file__).parent
SEED = 3
CHUNK = 25
"""Cases of a study in a chunk: a quarter of a second."""
JOB_CASES = 5_000
NOTHING: Call = (operator.add, (1, 2))
NAP_SECONDS = 0.05
IN_FLIGHT = 2
"""Chunks for each worker."""


async def run_all(executor: Executor, chunks: Sequence[Sequence[Call]]) -> tuple[list[CallResult], float]:
    """What became of all calls, in order, and the seconds it took, with a few chunks in flight as in the service."""
    places = asyncio.Semaphore(executor.capacity * IN_FLIGHT)

    async def one(chunk: Sequence[Call]) -> list[CallResult]:
        async with places:
            return await executor.run(chunk)

    began = time.perf_counter()
    finished = await asyncio.gather(*map(one, chunks))
    return [outcome for chunk in finished for outcome in chunk], time.perf_counter() - began


@asynccontextmanager
async def pool_of(workers: int) -> AsyncIterator[Executor]:
    """A pool."""
    pool = ProcessPool(workers=workers, task_seconds=60.0)
    await pool.start()
    yield pool
    await pool.stop(2.0)


@asynccontextmanager
async def cluster_of(workers: int) -> AsyncIterator[Executor]:
    """A cluster whose workers are all there."""
    with tempfile.TemporaryDirectory() as folder, dask_cluster(Path(folder), workers) as cluster:
        executor = DaskExecutor(address=cluster.address, workers=1, task_seconds=60.0)
        await executor.start()
        while executor.cluster.capacity < workers:  # noqa: ASYNC110 (other processes set no event)
            await asyncio.sleep(0.1)
        yield executor
        await executor.stop(2.0)


def in_chunks(calls: Sequence[Call], size: int) -> list[Sequence[Call]]:
    return [calls[i : i + size] for i in range(0, len(calls), size)]


def tell(what: str) -> None:
    print(f"cluster: {what}", file=sys.stderr, flush=True)


async def no_ops(executor: Executor, size: int, chunks: int, repetitions: int) -> dict[str, float]:
    """Cost of a call that does nothing, in chunks of one size."""
    walls, cpus = [], []
    for _ in range(repetitions):
        cpu = time.process_time()
        _, wall = await run_all(executor, [[NOTHING] * size] * chunks)
        walls.append(wall)
        cpus.append(time.process_time() - cpu)
    count = size * chunks
    return {
        "calls_in_chunk": size,
        "wall_ms_per_call": statistics.median(walls) / count * 1e3,
        "service_cpu_ms_per_call": statistics.median(cpus) / count * 1e3,
        "chunks_per_second": chunks / statistics.median(walls),
    }


async def job(executor: Executor, count: int, seconds: float = 0.0) -> dict[str, float]:
    """Cost of a case of a job, each asleep for so long, with all that the service does about it."""
    with tempfile.TemporaryDirectory() as folder:
        async with running(Path(folder), executor, max_queued_cases=count) as runner:
            cpu, wall = time.process_time(), time.perf_counter()
            state = await ended(runner, await accepted(runner, cases(range(count), seconds=seconds)))
            cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return {
        "cases": count,
        "failed": state.failed,
        "wall_ms_per_case": wall / count * 1e3,
        "service_cpu_ms_per_case": cpu / count * 1e3,
    }


def found_angle(case: dict[str, Any]) -> CriticalAngle:
    """Find one critical angle, in a worker."""
    return critical_angle(**case)


async def measure(count: int, naps: int, repetitions: int) -> dict[str, Any]:
    calls: list[Call] = [(found_angle, (dict(case),)) for case in one_by_one(study_cases(count, SEED))]
    found: dict[str, Any] = {"study": {"cases": count}, "no_ops": {}, "jobs": {}, "naps": {"cases": naps}}
    answers = {}
    for name, start in (("pool", pool_of), ("dask", cluster_of)):
        async with start(2) as executor:
            tell(f"{name}: calls that do nothing")
            await run_all(executor, [[NOTHING]] * 20)
            sizes = ((1, 400), (10, 200), (100, 100))
            found["no_ops"][name] = [await no_ops(executor, size, chunks, repetitions) for size, chunks in sizes]
            tell(f"{name}: a job of {JOB_CASES} cases")
            found["jobs"][name] = await job(executor, JOB_CASES)
            tell(f"{name}: {count} cases of a study")
            finished, wall = await run_all(executor, in_chunks(calls, CHUNK))
            answers[name] = [pickle.dumps(outcome.value) for outcome in finished]
            failures = sum(outcome.error is not None for outcome in finished)
            found["study"][name] = {"wall_s": wall, "failures": failures}
    pairs = zip(answers["pool"], answers["dask"], strict=True)
    found["study"]["equal"] = sum(one == other for one, other in pairs)
    for workers in (1, 4):
        async with cluster_of(workers) as executor:
            tell(f"{naps} cases of {NAP_SECONDS:g} s on {workers} workers")
            await job(executor, 20)
            found["naps"][str(workers)] = (await job(executor, naps, NAP_SECONDS))["wall_ms_per_case"] * naps / 1e3
    found["naps"]["ratio"] = found["naps"]["1"] / found["naps"]["4"]
    return found


def as_markdown(results: dict[str, Any]) -> str:
    """The whole page."""
    about = results["machine"]
    lines = [
        "# Chunks on a Dask cluster\n",
        f"{about['processor']}, {about['cores']} cores, {about['memory_gb']} GB; {about['os']}.",
        ", ".join(f"{name} {number}" for name, number in results["versions"].items()) + ".",
        f"Measured on {results['measured']} by `make cluster`; load average before: {about['load_average_before']}.",
        "Scheduler, workers and client on the same cores, over TCP on the loopback interface.\n",
        table(["what", "required", "measured"], requirements(results)),
        "Calls that do nothing, two workers; medians:\n",
        table(
            ["", "calls in a chunk", "wall time a call", "CPU time a call of the service", "chunks a second"],
            [no_ops_row(name, row) for name, rows in results["no_ops"].items() for row in rows],
        ),
        "Jobs of cases that take no time: reading, keeping and marking are all there is:\n",
        table(
            ["", "cases", "wall time a case", "CPU time a case of the service"],
            [
                [
                    name,
                    f"{row['cases']:,}",
                    f"{row['wall_ms_per_case']:.3f} ms",
                    f"{row['service_cpu_ms_per_case']:.3f} ms",
                ]
                for name, row in results["jobs"].items()
            ],
        ),
    ]
    return "\n".join(lines)


def requirements(results: dict[str, Any]) -> list[list[str]]:
    """What is required, and what was measured."""
    study, naps, calls = results["study"], results["naps"], results["no_ops"]["dask"][-1]
    times = f"{study['dask']['wall_s']:.1f} s, pool {study['pool']['wall_s']:.1f} s"
    return [
        [
            f"{study['cases']:,} critical angles of a study on two workers, against a pool of two",
            "the same to the last bit",
            f"{study['equal']:,} the same, {study['dask']['failures']} failed; {times}",
        ],
        [
            f"a call that does nothing, in chunks of {calls['calls_in_chunk']}",
            "less than 1 ms",
            f"{calls['wall_ms_per_call']:.3f} ms",
        ],
        [
            f"{naps['cases']} cases of {NAP_SECONDS * 1e3:g} ms asleep as a job: four workers against one",
            "at least 3.8 times",
            f"{naps['ratio']:.2f} times ({naps['1']:.2f} s, {naps['4']:.2f} s)",
        ],
    ]


def no_ops_row(name: str, row: dict[str, float]) -> list[str]:
    return [
        name,
        str(row["calls_in_chunk"]),
        f"{row['wall_ms_per_call']:.3f} ms",
        f"{row['service_cpu_ms_per_call']:.3f} ms",
        f"{row['chunks_per_second']:.0f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000, help="critical angles compared with the pool's")
    parser.add_argument("--naps", type=int, default=1000, help="cases of 50 ms asleep")
    parser.add_argument("--repetitions", type=int, default=5)
    asked = parser.parse_args()
    results = {
        "measured": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": machine(),
        "versions": versions() | {"distributed": version("distributed")},
    } | asyncio.run(measure(asked.cases, asked.naps, asked.repetitions))
    (HERE / "cluster.json").write_text(json.dumps(results, indent=2) + "\n")
    (HERE / "cluster.md").write_text(as_markdown(results))
    print(as_markdown(results))


if __name__ == "__main__":
    main()
