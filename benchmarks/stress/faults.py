"""Faults: the server or a worker killed, the disk full, jobs cancelled, files lost.

python -m benchmarks.stress.faults            # five minutes
python -m benchmarks.stress.faults --full     # 50 rounds of each
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.stress.faults_cancel import cancel_jobs
from benchmarks.stress.faults_crashes import kill_servers, kill_workers
from benchmarks.stress.faults_disk import fill_disks
from benchmarks.stress.faults_found import Found
from benchmarks.stress.faults_losses import lose_files
from benchmarks.stress.lines import Line

SECONDS = 300.0
FULL_ROUNDS = 50


@dataclass(frozen=True, slots=True)
class Fault:
    """A requirement, and what tries it.

    Parameters
    ----------
    hurt
        Given a folder, the most rounds and when to stop.
    share
        Of the time there is.
    measured
        Figures to tell, of what was seen.
    """

    number: int
    what: str
    required: str
    hurt: Callable[[Path, int, float], Found]
    share: float
    measured: Callable[[dict[str, list[float]]], str] = lambda _: ""

    def line(self, rounds: int, deadline: float) -> Line:
        """Try it."""
        with tempfile.TemporaryDirectory() as folder:
            found = self.hurt(Path(folder), rounds, deadline)
        return found.line(self.number, self.what, self.required, self.measured(found.seen))


FAULTS = (
    Fault(
        4,
        "server killed at any instant of a batch, and started again",
        "every case answered once and as without the crash, no finished chunk computed again, nothing left behind",
        kill_servers,
        0.4,
        lambda seen: f"started again in {max(seen['start_s']):.1f} s at most",
    ),
    Fault(5, "workers killed during batches", "every case finishes, none fails", kill_workers, 0.15),
    Fault(
        6,
        "disk full during a batch",
        "every result deliverable or a clear problem; clean once there is room",
        fill_disks,
        0.15,
        lambda seen: f"{sum(seen['failed']):.0f} jobs failed for it, their results deliverable",
    ),
    Fault(
        7,
        "job cancelled or deleted",
        "within 1 s, partial results readable, the same when repeated",
        cancel_jobs,
        0.15,
        lambda seen: f"longest {1000 * max([*seen['cancel_s'], *seen.get('delete_s', [])]):.0f} ms",
    ),
    Fault(9, "files lost or damaged", "exactly what is lost is computed again", lose_files, 0.15),
)


def measure_faults(*, full: bool = False, seconds: float = SECONDS) -> Iterator[Line]:
    """Try all of them; the time left over by one goes to the others."""
    end, left = time.monotonic() + seconds, sum(fault.share for fault in FAULTS)
    for fault in FAULTS:
        now = time.monotonic()
        deadline = float("inf") if full else now + (end - now) * fault.share / left
        left -= fault.share
        yield fault.line(FULL_ROUNDS, deadline)


def main() -> None:
    parser = argparse.ArgumentParser(description="Hurt the service, and see what comes of it.")
    parser.add_argument("--full", action="store_true", help=f"{FULL_ROUNDS} rounds of each, however long they take")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="for all of them; 300 unless given")
    options = parser.parse_args()
    held = []
    for line in measure_faults(full=options.full, seconds=options.seconds):
        held.append(line.held)
        print(f"{line.number} {line.what}: {'held' if line.held else 'NOT HELD'}. {line.measured}", flush=True)
        for fault in line.details["faults"]:
            print(f"    {fault}", flush=True)
    sys.exit(not all(held))


if __name__ == "__main__":
    main()
