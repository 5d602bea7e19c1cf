"""Jobs are cancelled and deleted at any instant, also on cases that take seconds each."""

import random
import time
from pathlib import Path
from typing import Any

import orjson

from benchmarks.stress.faults_cases import lines, searches, strikes
from benchmarks.stress.faults_folder import faults_of
from benchmarks.stress.faults_found import Found, rounds_until
from benchmarks.stress.faults_victim import Victim

MOST_SECONDS = 1.0
"""For a cancellation to take effect."""
SLOW_CASES = 40
"""Each of them takes longer than a cancellation may."""
CHEAP_CASES = 200
LATEST_SECONDS = 1.5
KINDS = ("slow cancelled", "cheap deleted", "cheap cancelled", "slow deleted")


def cancel_jobs(folder: Path, rounds: int, deadline: float, seed: int = 0) -> Found:
    """Cancel or delete a job in each of these rounds, at a random instant."""
    found, instants = Found(), random.Random(seed)  # noqa: S311 (nothing is to be kept secret)
    with Victim(folder) as victim:
        victim.start()
        kept: list[tuple[dict[str, Any], list[bytes]]] = []
        for number in rounds_until(rounds, deadline):
            kind = KINDS[number % len(KINDS)]
            found.kinds[kind] += 1
            job = begin(victim, kind, number)
            time.sleep(instants.uniform(0.0, LATEST_SECONDS if "slow" in kind else LATEST_SECONDS / 4))
            before, workers = time.monotonic(), victim.workers()
            if "deleted" in kind:
                delete(victim, job, found)
            else:
                kept.append(cancel(victim, job, found))
            time.sleep(max(0.0, before + MOST_SECONDS - time.monotonic()))
            found.claim(not victim.busy(workers), "the workers went on with what was cancelled")
            answer_another(victim, number, found)
        see_the_end_of_others(victim, found)
        victim.kill()
        victim.start()
        for job, results in kept:
            found.claim(victim.job(job) == job, "a cancelled job changed with a restart")
            found.claim(victim.results(job) == results, "results of a cancelled job changed with a restart")
        for fault in faults_of(victim.data):
            found.claim(None, fault)
        found.faults += victim.complaints()
    return found


def begin(victim: Victim, kind: str, number: int) -> dict[str, Any]:
    """Submit the job of a round; before slow cases come a few that are not."""
    if "slow" in kind:
        first = SLOW_CASES * number
        cases = strikes(4, first, slow=False) + strikes(SLOW_CASES, first, slow=True)
        return victim.submit(lines(cases), path="/trajectory/batch")
    return victim.submit(lines(searches(CHEAP_CASES, first=CHEAP_CASES * number)))


def cancel(victim: Victim, job: dict[str, Any], found: Found) -> tuple[dict[str, Any], list[bytes]]:
    """Cancel a job, twice; return it with its results."""
    before = time.monotonic()
    answer = victim.client.post(job["links"]["cancel"])
    ended = answer.json()
    found.note("cancel_s", time.monotonic() - before)
    found.claim(time.monotonic() - before < MOST_SECONDS, f"cancelling took {time.monotonic() - before:.2f} s")
    found.claim(answer.status_code == 200, f"cancelling was answered {answer.status_code}")
    finished = ended["counts"]["done"] == ended["counts"]["total"]
    found.claim(ended["status"] == ("successful" if finished else "dismissed"), f"the job ended {ended['status']}")
    found.claim(victim.job(job) == ended, "the job is told otherwise than by its cancellation")
    again = victim.client.post(job["links"]["cancel"])
    found.claim((again.status_code, again.json()) == (200, ended), "cancelled again, the job changed")
    results = victim.results(job)
    indices = [orjson.loads(line)["index"] for line in results]
    found.note("done", len(results))
    found.claim(len(results) == ended["counts"]["done"], f"{len(results)} results of {ended['counts']['done']}")
    found.claim(indices == sorted(set(indices)), "results out of order")
    found.claim(all(b'"result":' in line for line in results), "a cancelled case is told as a problem")
    time.sleep(0.1)
    found.claim(victim.job(job) == ended, "the job went on after its cancellation")
    return ended, results


def delete(victim: Victim, job: dict[str, Any], found: Found) -> None:
    """Delete a job, twice."""
    before = time.monotonic()
    status = victim.client.delete(job["links"]["self"]).status_code
    found.note("delete_s", time.monotonic() - before)
    found.claim(time.monotonic() - before < MOST_SECONDS, f"deleting took {time.monotonic() - before:.2f} s")
    found.claim(status == 204, f"deleting was answered {status}")
    statuses = [victim.client.delete(job["links"]["self"]).status_code]
    statuses += [victim.client.get(job["links"][name]).status_code for name in ("self", "results", "events")]
    statuses += [victim.client.post(job["links"]["cancel"]).status_code]
    found.claim(set(statuses) == {404}, f"a deleted job was answered {statuses}")
    found.claim(all(other["id"] != job["id"] for other in victim.jobs()), "a deleted job is still listed")


def answer_another(victim: Victim, number: int, found: Found) -> None:
    """Ask for a case that was never asked for: there may be no worker yet, but there soon is."""
    before = time.monotonic()
    [case] = strikes(1, 1_000_000 + number, slow=False)
    found.claim(victim.client.post("/trajectory", json=case).is_success, "a query after the end failed")
    found.note("next_s", time.monotonic() - before)


def see_the_end_of_others(victim: Victim, found: Found) -> None:
    """Cancel and delete a job that has ended."""
    ended = victim.finished(victim.submit(lines(searches(20, first=1_000_000))))
    found.claim(ended["status"] == "successful", f"a job nobody cancelled ended {ended['status']}")
    answer = victim.client.post(ended["links"]["cancel"])
    found.claim((answer.status_code, answer.json()) == (200, ended), "cancelled after its end, a job changed")
    statuses = [victim.client.delete(ended["links"]["self"]).status_code for _ in range(2)]
    found.claim(statuses == [204, 404], f"deleting twice was answered {statuses}")
