"""How far the default settings are from converged ones, over random strikes.

    python benchmarks/accuracy.py [--cases 200] [--seed 1] [--processes 2]

Writes accuracy.json. Ends in 1 if a critical angle is off by more than 0.02°, if the two runs of a case disagree on
whether there is one, or if a run fails; those cases are printed with all their inputs.
"""

import argparse
import json
import math
import multiprocessing
import statistics
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.batches import answer_or_error
from benchmarks.converged import CONVERGED, CONVERGED_SEARCH, paper_critical_angle
from benchmarks.machine import machine, versions
from benchmarks.random_cases import Case, one_by_one, random_cases
from solver import CriticalAngle, RicochetError, critical_angle, warm_up

RESULTS = Path(__file__).with_name("accuracy.json")
TOLERATED_DEG = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One case, as usual and converged."""

    number: int
    inputs: dict[str, str]
    status: str
    """Of the search, or the error that ended it."""
    converged_status: str
    failed: bool
    angle_deg: float | None
    converged_angle_deg: float | None
    other_crossings: int
    converged_other_crossings: int
    trajectories: int
    cpu_s: float
    """With the default settings."""
    paper_cpu_s: float
    """Of the paper's strike right after, in the same process."""

    @property
    def difference_deg(self) -> float | None:
        """Between the two critical angles, if there are two. [°]"""
        if self.angle_deg is None or self.converged_angle_deg is None:
            return None
        return abs(self.angle_deg - self.converged_angle_deg)

    @property
    def bad(self) -> bool:
        """Whether it is to be looked at."""
        return self.failed or self.status != self.converged_status or (self.difference_deg or 0.0) > TOLERATED_DEG


def compare(numbered: tuple[int, Case]) -> Comparison:
    """Both answers to one case."""
    number, case = numbered
    begin = time.process_time()
    usual = answer_or_error(case)
    middle = time.process_time()
    paper_critical_angle()
    end = time.process_time()
    converged = _converged(case)
    return Comparison(
        number=number,
        inputs={name: repr(value) for name, value in case.items()},
        status=_status(usual),
        converged_status=_status(converged),
        failed=isinstance(usual, RicochetError) or isinstance(converged, RicochetError),
        angle_deg=_degrees(usual),
        converged_angle_deg=_degrees(converged),
        other_crossings=_crossings(usual),
        converged_other_crossings=_crossings(converged),
        trajectories=len(usual.iterations) if isinstance(usual, CriticalAngle) else 0,
        cpu_s=middle - begin,
        paper_cpu_s=end - middle,
    )


def _converged(case: Case) -> CriticalAngle | RicochetError:
    try:
        return critical_angle(**case, numerics=CONVERGED, search=CONVERGED_SEARCH)
    except RicochetError as error:
        return error


def _short(row: Comparison) -> list[float | None]:
    """Both angles, trajectories and CPU time; the inputs follow from the seed."""
    return [row.angle_deg, row.converged_angle_deg, row.trajectories, row.cpu_s]


def _status(answer: CriticalAngle | RicochetError) -> str:
    return answer.status.value if isinstance(answer, CriticalAngle) else repr(answer)


def _degrees(answer: CriticalAngle | RicochetError) -> float | None:
    if isinstance(answer, RicochetError) or answer.angle is None:
        return None
    return math.degrees(answer.angle)


def _crossings(answer: CriticalAngle | RicochetError) -> int:
    return len(answer.other_crossings) if isinstance(answer, CriticalAngle) else 0


def summarize(rows: list[Comparison]) -> dict[str, Any]:
    """What the cases say together."""
    differences = [row.difference_deg for row in rows if row.difference_deg is not None]
    return {
        "cases": len(rows),
        "with_critical_angle": len(differences),
        "worst_difference_deg": max(differences, default=None),
        "median_difference_deg": statistics.median(differences) if differences else None,
        "worse_than_tolerated": sum(difference > TOLERATED_DEG for difference in differences),
        "tolerated_deg": TOLERATED_DEG,
        "status_disagreements": sum(row.status != row.converged_status for row in rows if not row.failed),
        "other_crossings_disagreements": sum(row.other_crossings != row.converged_other_crossings for row in rows),
        "failures": sum(row.failed for row in rows),
        "median_cpu_s": statistics.median(row.cpu_s for row in rows),
        "slowest_cpu_s": max(row.cpu_s for row in rows),
        "median_cpu_over_paper": statistics.median(row.cpu_s / row.paper_cpu_s for row in rows),
        "slowest_cpu_over_paper": max(row.cpu_s / row.paper_cpu_s for row in rows),
    }


def run(count: int, seed: int, processes: int) -> list[Comparison]:
    """Compare cases in processes of their own, telling how far it is."""
    rows: list[Comparison] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context, initializer=warm_up) as pool:
        for row in pool.map(compare, enumerate(one_by_one(random_cases(count, seed)))):
            rows.append(row)
            if len(rows) % 20 == 0:
                print(f"{len(rows)} of {count}", file=sys.stderr)
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare default settings with converged ones over random strikes.")
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--output", type=Path, default=RESULTS, help="file to write")
    options = parser.parse_args()

    warm_up()
    rows = run(options.cases, options.seed, options.processes)
    summary, bad = summarize(rows), [row for row in rows if row.bad]
    for name, value in summary.items():
        print(f"{name:30} {value:.4g}" if isinstance(value, float) else f"{name:30} {value}")
    for row in bad:
        print(f"\ncase {row.number}: {row.status} {row.angle_deg}, converged {row.converged_status}", end=" ")
        print(row.converged_angle_deg, *(f"  {name}={value}" for name, value in row.inputs.items()), sep="\n")
    about = {"seed": options.seed, "machine": machine(), "versions": versions()}
    found = about | {"summary": summary, "bad": [asdict(row) for row in bad], "cases": [_short(row) for row in rows]}
    options.output.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
