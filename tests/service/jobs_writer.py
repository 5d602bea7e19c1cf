"""Script: create jobs and mark their cases in a folder, in processes that are killed at random instants."""

import os
import random
import signal
import sys
import time
from pathlib import Path

from service.jobs.models import BLOCK_SIZE, CaseBlock, CaseState, JobCase
from service.jobs.store import JobStore
from service.operations import KeyedRequest
from tests.service.questions import PROBLEM, Question

CASES = 450
KILLS = 8
JOBS_BEFORE = 2
"""Smallest number of jobs that a process has accepted before it is killed, however slow the machine is."""


def write_for_ever(folder: Path, accepted: int) -> None:
    """Write jobs until killed, and for each accepted job a byte to the pipe `accepted`."""
    store = JobStore(folder, job_days=7.0, operations={"square"})
    while True:
        job = store.create("square", "local")
        for number, first in enumerate(range(0, CASES, BLOCK_SIZE)):
            cases = [
                JobCase(KeyedRequest.of("square", Question(i))) for i in range(first, min(CASES, first + BLOCK_SIZE))
            ]
            store.append(job, number, CaseBlock.of(cases))
        store.accept(job, CASES, None)
        os.write(accepted, b".")
        for first in range(0, CASES, 50):
            failed = {first: CaseState.FAILED}
            store.mark(job, dict.fromkeys(range(first, first + 50), CaseState.DONE) | failed, {first: PROBLEM})


if __name__ == "__main__":
    instants = random.Random(0)  # noqa: S311
    for _ in range(KILLS):
        reading, writing = os.pipe()
        child = os.fork()
        if not child:
            write_for_ever(Path(sys.argv[1]), writing)
        os.close(writing)
        for _ in range(JOBS_BEFORE):
            os.read(reading, 1)
        time.sleep(instants.uniform(0.0, 0.15))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(reading)
