"""The server is killed at any instant of a batch, or a worker is: nothing is lost, nothing is done twice."""

import os
import random
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from benchmarks.stress.faults_cases import lines, pieces, searches
from benchmarks.stress.faults_folder import faults_of, keys_of, segments
from benchmarks.stress.faults_found import Found, rounds_until
from benchmarks.stress.faults_victim import UNDERWAY, Victim

CASES = 200
"""Of a batch: about a second of work."""
ORPHAN_SECONDS = 2.0
"""For workers to notice that their server has gone."""
KILL_PAUSE_SECONDS = 0.3
"""Between the deaths of two workers; a new one takes longer than that to come up."""
INSTANTS = {"mid-batch": (0.0, 0.1), "intake": (0.0, 0.12), "right after the 202": (0.0, 0.05)}
"""When the server is killed: since so many cases were done, since the first byte was sent, since the answer. [s]"""
PIECE_PAUSE_SECONDS = 0.01
"""Between two pieces of a body, so that it can be killed between them."""
RESTART_SECONDS = 1.5
"""Within which a starting server is killed once more."""


def kill_servers(folder: Path, rounds: int, deadline: float, seed: int = 0) -> Found:
    """Kill the server in each of these rounds; compare with one that nothing happens to.

    A client does what clients do: a batch is sent again, with the same idempotency key, when the server is back.
    """
    found, instants = Found(), random.Random(seed)  # noqa: S311 (nothing is to be kept secret)
    with Victim(folder / "undisturbed") as undisturbed, Victim(folder / "killed") as victim:
        undisturbed.start()
        victim.start()
        for number in rounds_until(rounds, deadline):
            kind = list(INSTANTS)[number % len(INSTANTS)]
            found.kinds[kind] += 1
            body = lines(searches(CASES, first=number * CASES))
            kill_once(victim, body, str(number), kind, instants)
            found.claim(not victim.orphans(ORPHAN_SECONDS), "a worker outlived its server")
            if number % 5 == 4:
                kill_while_it_starts(victim, instants.uniform(0.0, RESTART_SECONDS))
                found.note("restarts_killed", 1)
            see_it_finish(victim, undisturbed, body, number, found)
        found.faults += victim.complaints()
    return found


def kill_once(victim: Victim, body: bytes, token: str, kind: str, instants: random.Random) -> None:
    """Submit a batch and kill the server meanwhile; plant what a crash at its worst would leave."""
    delay = instants.uniform(*INSTANTS[kind])
    if kind == "intake":
        timer = threading.Timer(delay, victim.kill)
        timer.start()
        with suppress(httpx.HTTPError):
            victim.submit(slowly(body), token)
        timer.join()
    else:
        job = victim.submit(body, token)
        if kind == "mid-batch":
            victim.until_done(job, instants.randrange(1, CASES))
        time.sleep(delay)
        victim.kill()
    for name in ("results/.partial/1-1", "downloads/half"):
        planted = victim.data / name
        planted.parent.mkdir(parents=True, exist_ok=True)
        planted.write_bytes(b"half")


def kill_while_it_starts(victim: Victim, delay: float) -> None:
    """Start the server, and kill it before or just after it is ready."""
    victim.spawn()
    time.sleep(delay)
    victim.kill()


def see_it_finish(victim: Victim, undisturbed: Victim, body: bytes, number: int, found: Found) -> None:
    """Start the server again; look whether the batch ends as it should."""
    found.claim(not victim.orphans(ORPHAN_SECONDS), "a worker outlived its server")
    before = segments(victim.data)
    kept = keys_of(before).total() - CASES * number
    begin = time.monotonic()
    victim.start()
    found.note("start_s", time.monotonic() - begin)
    found.note("kept", kept)
    job = victim.finished(victim.submit(body, str(number)))
    expected = undisturbed.finished(undisturbed.submit(body))
    jobs = victim.jobs()
    found.claim(len(jobs) == number + 1 and jobs[0]["id"] == job["id"], "the batch became more than one job")
    found.claim(job["status"] == "successful", f"the job ended {job['status']}")
    counts = job["counts"]
    found.claim((counts["total"], counts["done"], counts["failed"]) == (CASES, CASES, 0), f"counted {counts}")
    found.claim(victim.results(job) == undisturbed.results(expected), "other results than without a crash")
    found.claim(before.items() <= segments(victim.data).items(), "a finished chunk was written again")
    computed = victim.computed()
    found.claim(computed == CASES - kept, f"{computed} computed though {kept} of {CASES} were there")
    for fault in faults_of(victim.data):
        found.claim(None, fault)


def slowly(body: bytes) -> Iterator[bytes]:
    """Yield a body as a slow connection would send it."""
    for piece in pieces(body):
        yield piece
        time.sleep(PIECE_PAUSE_SECONDS)


def kill_workers(folder: Path, kills: int, deadline: float, seed: int = 0) -> Found:
    """Kill that many workers while batches run, one at a time."""
    found, instants = Found(), random.Random(seed)  # noqa: S311 (likewise)
    with Victim(folder) as victim:
        victim.start()
        for number in rounds_until(kills, deadline):
            body = lines(searches(CASES, first=number * CASES))
            job = victim.submit(body)
            killed = kill_while_it_runs(victim, job, instants, kills - found.kinds["workers killed"])
            found.kinds["workers killed"] += killed
            job = victim.finished(job)
            counts = job["counts"]
            found.claim(job["status"] == "successful", f"the job ended {job['status']}")
            found.claim((counts["done"], counts["failed"], counts["cached"]) == (CASES, 0, 0), f"counted {counts}")
            results = victim.results(job)
            found.claim(len(results) == CASES and all(b'"result":' in line for line in results), "a case has no result")
            if found.kinds["workers killed"] >= kills:
                break
        for fault in faults_of(victim.data):
            found.claim(None, fault)
        found.claim(victim.stop() == 0, "the server did not end well")
        found.claim(not victim.orphans(ORPHAN_SECONDS), "a process outlived the service")
        found.faults += victim.complaints()
    return found


def kill_while_it_runs(victim: Victim, job: dict[str, Any], instants: random.Random, most: int) -> int:
    """Kill workers while the job runs, one at a time; return how many."""
    killed = 0
    while killed < most and victim.job(job)["status"] in UNDERWAY:
        if workers := victim.workers():
            with suppress(ProcessLookupError):
                os.kill(instants.choice(workers), signal.SIGKILL)
                killed += 1
        time.sleep(KILL_PAUSE_SECONDS + instants.uniform(0.0, KILL_PAUSE_SECONDS))
    return killed
