"""Jobs are cancelled and deleted at random instants, even while they compute cases that take seconds."""

import random
import time
from pathlib import Path
from typing import Any

import orjson
import pytest

from .cases import LONG, jsonl, searches, trajectories
from .processes import busy, processor_seconds
from .server import RestartableServer

MOST_SECONDS = 3.0
"""Largest processor time until a cancellation takes effect; a slow case takes three times as long. [s]"""
SLOW_CASES = 40
CHEAP_CASES = 200
LATEST_SECONDS = {"slow": 1.5, "cheap": 0.4}
KINDS = (("slow", "cancel"), ("cheap", "delete"), ("cheap", "cancel"), ("slow", "delete"))


@pytest.mark.parametrize("rounds", [len(KINDS), LONG])
def test_cancelled_jobs_end_promptly_during_any_computation(rounds: int, tmp_path: Path) -> None:
    instants = random.Random(0)  # noqa: S311
    kept: list[tuple[dict[str, Any], list[bytes]]] = []
    with RestartableServer(tmp_path) as server:
        server.start()
        for number in range(rounds):
            cases, action = KINDS[number % len(KINDS)]
            job = submit(server, cases, number)
            time.sleep(instants.uniform(0.0, LATEST_SECONDS[cases]))
            before = {worker: processor_seconds(worker) for worker in server.workers()}
            if action == "delete":
                delete(server, job)
            else:
                kept.append(cancel(server, job))
            while busy(list(before)):
                used = max(processor_seconds(worker) - seconds for worker, seconds in before.items())
                assert used < MOST_SECONDS, f"workers go on with {cases} cases after {action}"
            [case] = trajectories(1, 1_000_000 + number, slow=False)
            assert server.client.post("/trajectory", json=case).is_success
        server.kill()
        server.start()
        for job, results in kept:
            assert server.job(job) == job, "a cancelled job changed with a restart"
            assert server.results(job) == results
        assert server.folder_faults() == []
        assert server.logged_errors() == []


def submit(server: RestartableServer, cases: str, number: int) -> dict[str, Any]:
    """Submit the job of one round: cheap searches, or a few fast trajectories followed by slow ones."""
    if cases == "slow":
        first = SLOW_CASES * number
        body = trajectories(4, first, slow=False) + trajectories(SLOW_CASES, first, slow=True)
        return server.submit(jsonl(body), path="/trajectory/batch")
    return server.submit(jsonl(searches(CHEAP_CASES, first=CHEAP_CASES * number)))


def cancel(server: RestartableServer, job: dict[str, Any]) -> tuple[dict[str, Any], list[bytes]]:
    """Cancel a job twice and check the answers; return the ended job and its results."""
    answer = server.client.post(job["links"]["cancel"])
    assert answer.status_code == 200
    ended = answer.json()
    finished = ended["counts"]["done"] == ended["counts"]["total"]
    assert ended["status"] == ("successful" if finished else "dismissed")
    assert server.job(job) == ended
    again = server.client.post(job["links"]["cancel"])
    assert (again.status_code, again.json()) == (200, ended)
    results = server.results(job)
    indices = [orjson.loads(line)["index"] for line in results]
    assert len(results) == ended["counts"]["done"]
    assert indices == sorted(set(indices))
    assert all(b'"result":' in line for line in results)
    time.sleep(0.1)
    assert server.job(job) == ended, "the job went on after its cancellation"
    return ended, results


def delete(server: RestartableServer, job: dict[str, Any]) -> None:
    """Delete a job twice and check the answers."""
    client, links = server.client, job["links"]
    assert client.delete(links["self"]).status_code == 204
    statuses = [client.delete(links["self"]).status_code, client.post(links["cancel"]).status_code]
    statuses += [client.get(links[name]).status_code for name in ("self", "results", "events")]
    assert set(statuses) == {404}
    assert all(other["id"] != job["id"] for other in server.jobs())
