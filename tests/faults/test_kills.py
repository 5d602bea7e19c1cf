"""The server or its workers are killed at random instants of a batch: no case is lost or computed twice."""

import random
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.schemas.strike import PAPER

from .cases import LONG, jsonl, searches, slowly
from .data_folder import keys_of, segments
from .processes import kill
from .server import UNFINISHED, RestartableServer

CASES = 200
"""Number of cases of a batch, about a second of work."""
ORPHAN_SECONDS = 10.0
"""Time limit for workers to end after their server was killed, long because they run at a low priority. [s]"""
WORKER_PAUSE_SECONDS = 0.3
"""Pause between two kills of a worker, shorter than its start. [s]"""
INSTANTS = {"while cases are computed": 0.1, "while the body is sent": 0.12, "right after the 202": 0.05}
"""Longest delay before the kill, by the event that precedes it. [s]"""
RESTART_SECONDS = 1.5
"""Latest time after its start at which a server is killed again. [s]"""
STUDY_SECONDS = 1.0
"""Latest time after its start at which a server that computes a study is killed. [s]"""
SPEED = {"type": "normal", "mean": 238.0, "standard_deviation": 4.8}
STUDY = PAPER | {
    "uncertain": [{"field": "impact.velocity_m_s", "distribution": SPEED}],
    "sampling": {"half_width": 1e-4, "method": "direct", "seed": 26},
    "sensitivity": False,
}
"""A study whose tolerance is so small that it ends at its largest number of samples."""


@pytest.mark.parametrize("rounds", [3, LONG])
def test_killed_server_answers_every_case_once_after_its_restart(rounds: int, tmp_path: Path) -> None:
    instants = random.Random(0)  # noqa: S311
    with RestartableServer(tmp_path / "undisturbed") as undisturbed, RestartableServer(tmp_path / "killed") as server:
        undisturbed.start()
        server.start()
        for number in range(rounds):
            body = jsonl(searches(CASES, first=number * CASES))
            kill_during_batch(server, body, number, instants)
            leave_partial_files(server.data)
            assert not server.orphans(ORPHAN_SECONDS)
            if number % 5 == 4:
                server.spawn()
                time.sleep(instants.uniform(0.0, RESTART_SECONDS))
                server.kill()
                assert not server.orphans(ORPHAN_SECONDS)
            before = segments(server.data)
            kept = keys_of(before).total() - number * CASES
            server.start()
            job = server.finished(server.submit(body, token=str(number)))
            expected = undisturbed.finished(undisturbed.submit(body))
            assert job["status"] == "successful"
            assert [job["counts"][name] for name in ("total", "done", "failed")] == [CASES, CASES, 0]
            jobs = server.jobs()
            assert jobs[0]["id"] == job["id"]
            assert len(jobs) == number + 1, "the batch became more than one job"
            assert server.results(job) == undisturbed.results(expected)
            assert before.items() <= segments(server.data).items(), "a finished chunk was written again"
            assert server.computed() == CASES - kept
            assert server.folder_faults() == []
        assert server.logged_errors() == []


def kill_during_batch(server: RestartableServer, body: bytes, number: int, instants: random.Random) -> None:
    """Submit a batch, with the number of the round as its idempotency key, and kill the server at a random instant."""
    kind = list(INSTANTS)[number % len(INSTANTS)]
    delay = instants.uniform(0.0, INSTANTS[kind])
    if kind == "while the body is sent":
        timer = threading.Timer(delay, server.kill)
        timer.start()
        with suppress(httpx.HTTPError):
            server.submit(slowly(body), token=str(number))
        timer.join()
        return
    job = server.submit(body, token=str(number))
    if kind == "while cases are computed":
        server.until_done(job, instants.randrange(1, CASES))
    time.sleep(delay)
    server.kill()


@pytest.mark.parametrize(
    ("kills", "samples"), [(2, 4096), pytest.param(10, 16_384, marks=[pytest.mark.slow, pytest.mark.timeout(1200)])]
)
def test_study_of_a_killed_server_ends_with_the_same_bytes(kills: int, samples: int, tmp_path: Path) -> None:
    instants = random.Random(0)  # noqa: S311
    with RestartableServer(tmp_path / "undisturbed") as undisturbed, RestartableServer(tmp_path / "killed") as server:
        undisturbed.start()
        expected = result_of(undisturbed, undisturbed.finished(begin_study(undisturbed, samples)))
        undisturbed.stop()
        server.start()
        job = begin_study(server, samples)
        while job.get("progress", {}).get("samples", 0) < 200:
            job = server.job(job)
            assert job["status"] in UNFINISHED
        for _ in range(kills):
            time.sleep(instants.uniform(0.0, STUDY_SECONDS))
            assert server.job(job)["status"] in UNFINISHED, "the study has ended before it could be disturbed"
            server.kill()
            assert not server.orphans(ORPHAN_SECONDS)
            server.environment["RICOCHET_WORKERS"] = str(instants.randint(1, 2))
            server.start()
        job = server.finished(job)
        assert job["status"] == "successful"
        assert result_of(server, job) == expected


def begin_study(server: RestartableServer, samples: int) -> dict[str, Any]:
    body = STUDY | {"sampling": STUDY["sampling"] | {"max_samples": samples}}
    answer = server.client.post("/cra/uncertainty", json=body, headers={"Prefer": "respond-async"})
    job: dict[str, Any] = answer.raise_for_status().json()
    return job


def result_of(server: RestartableServer, job: dict[str, Any]) -> bytes:
    """Return the stored result of a job with one case."""
    [item] = server.client.get(job["links"]["results"]).raise_for_status().json()["results"]
    return server.client.get(f"/results/{item['result']['key']}").raise_for_status().content


def leave_partial_files(data: Path) -> None:
    """Create the incomplete files that a crash during a write leaves."""
    for name in ("results/.partial/1-1", "downloads/half"):
        path = data / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"half")


@pytest.mark.parametrize("kills", [2, LONG])
def test_batches_survive_killed_workers(kills: int, tmp_path: Path) -> None:
    instants, killed, batches = random.Random(0), 0, 0  # noqa: S311
    with RestartableServer(tmp_path) as server:
        server.start()
        while killed < kills:
            job = server.submit(jsonl(searches(CASES, first=batches * CASES)))
            batches += 1
            while killed < kills and server.job(job)["status"] in UNFINISHED:
                if workers := server.workers():
                    killed += kill(instants.choice(workers))
                time.sleep(instants.uniform(WORKER_PAUSE_SECONDS, 2.0 * WORKER_PAUSE_SECONDS))
            job = server.finished(job)
            assert job["status"] == "successful"
            assert [job["counts"][name] for name in ("done", "failed", "cached")] == [CASES, 0, 0]
            results = server.results(job)
            assert len(results) == CASES
            assert all(b'"result":' in line for line in results)
        assert server.folder_faults() == []
        server.stop()
        assert not server.orphans(ORPHAN_SECONDS)
        assert server.logged_errors() == []
