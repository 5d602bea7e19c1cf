"""Errors of critical angles with default settings, compared with converged ones and with scans, over random strikes.

    python benchmarks/accuracy.py [--only usual|odd|walls|routes] [--cases N] [--seed 1] [--processes 2] [--output FILE]

`usual`: 200 strikes against searches with converged settings; angles must agree within 0.02°. `odd`: 300 strikes far
outside the range of those, against scans with a fine trajectory every 0.5°; the status must agree, and each change of
outcome must lie between the two angles where the scan has it. `walls`: 200 usual strikes on walls of 0.5 to 5 diameters
against such scans; the outcome at each angle must match the interval in the answer. `routes`: 3,000 strikes of every
kind by both numerical methods, see `validation/routes.py`. Disagreements are printed with inputs and warnings.

Exits with 1 if a case fails, if status or angle of a usual strike disagree, if more than 1 % of the others disagree or
one does so without a warning, if the methods differ for no known reason or, with 1,440 strikes or more, if a
combination did not occur. Other crossings that disagree are only printed.
"""

import argparse
import json
import math
import multiprocessing
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.converged import CONVERGED, CONVERGED_SEARCH, SCANNED, paper_critical_angle
from benchmarks.machine import machine, versions
from benchmarks.random_cases import Case, answer_or_error, odd_cases, one_by_one, random_cases, wall_cases
from solver import CriticalAngle, Impact, Outcome, OutcomeInterval, RicochetError, critical_angle, simulate, warm_up
from validation import routes
from validation.routes import random_strikes

TOLERATED_DEG = 0.02
SCAN_DEG = [5.0 + 0.5 * index for index in range(161)]
"""Angles of a scan over the default range of a search. [°]"""
DOUBTS = {"retention_decides", "retention_decides_perforation", "tumbling", "undecided"}
"""Codes of warnings that say that an angle is uncertain."""
DISAGREEMENTS = ("error", "status", "first angle", "other crossings", "intervals")
NEEDS_WARNING = ("status", "first angle", "intervals")
"""Kinds of disagreement that a warning in `DOUBTS` should announce."""
ROUTES = 3000
"""Number of strikes that are computed by both methods."""
TOLERATED_SHARE = 0.01
"""Fraction of the odd strikes, and of the strikes on walls, that may disagree if each has a warning in `DOUBTS`. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """The answer to a case with default settings, and the reference for it."""

    number: int
    inputs: dict[str, str]
    status: str
    """Status of the search, or the error that ended it."""
    reference_status: str
    angle_deg: float | None
    reference_deg: tuple[float, float] | None
    """Angles between which the reference places the first change to a ricochet. [°]"""
    others_deg: list[float]
    reference_others_deg: list[tuple[float, float]]
    doubts: list[str]
    """Codes of the warnings of the answer that are in `DOUBTS`."""
    wrong_deg: list[float] | None = None
    """Angles of the scan of a wall whose outcome differs from the one that the answer gives for them. [°]"""
    confirmed: bool | None = None
    """Whether a converged run is a ricochet 0.02° above the angle and none 0.04° below it; None if not tested."""
    cpu_s: float
    paper_cpu_s: float
    """CPU time of the search for the paper's strike, measured right afterwards in the same process. [s]"""

    @property
    def difference_deg(self) -> float | None:
        """Distance of the critical angle from the interval of the reference; None if either is missing. [°]"""
        if self.angle_deg is None or self.reference_deg is None:
            return None
        return max(self.reference_deg[0] - self.angle_deg, self.angle_deg - self.reference_deg[1], 0.0)

    @property
    def disagreement(self) -> str:
        """Kind of disagreement; empty if there is none."""
        if "Error" in self.status + self.reference_status:
            return "error"
        if self.status != self.reference_status:
            return "status"
        if self.wrong_deg is not None:
            return "intervals" if self.wrong_deg else ""
        if (self.difference_deg or 0.0) > TOLERATED_DEG:
            return "first angle"
        pairs = zip(self.others_deg, self.reference_others_deg, strict=False)
        same = all(low - TOLERATED_DEG <= angle <= high + TOLERATED_DEG for angle, (low, high) in pairs)
        return "" if same and len(self.others_deg) == len(self.reference_others_deg) else "other crossings"


def compare_usual(numbered: tuple[int, Case]) -> Comparison:
    """Compare the answer with a search that uses converged settings."""
    number, case = numbered
    found, _ = _timed(number, case)
    try:
        converged: CriticalAngle | RicochetError = critical_angle(**case, numerics=CONVERGED, search=CONVERGED_SEARCH)
    except RicochetError as error:
        converged = error
    angle, others = _angles(converged)
    reference: dict[str, Any] = {"reference_others_deg": [(other, other) for other in others]}
    reference["reference_deg"] = None if angle is None else (angle, angle)
    return Comparison(**found, **reference, reference_status=_status(converged))


def compare_odd(numbered: tuple[int, Case]) -> Comparison:
    """Compare the answer with a scan by trajectories with converged settings."""
    number, case = numbered
    found, _ = _timed(number, case)
    reference: dict[str, Any] = {"reference_deg": None, "reference_others_deg": []}
    try:
        turned = [_turned_away(case, angle) for angle in SCAN_DEG]
        if found["angle_deg"] is not None:
            above, below = found["angle_deg"] + TOLERATED_DEG, found["angle_deg"] - 2.0 * TOLERATED_DEG
            found["confirmed"] = _turned_away(case, above) and not _turned_away(case, below)
    except RicochetError as error:
        return Comparison(**found, **reference, reference_status=repr(error))
    changes = [i for i in range(len(turned) - 1) if turned[i] != turned[i + 1]]
    first = next((i for i in changes if turned[i + 1]), None)
    status = "always_ricochet" if turned[0] else "no_ricochet"
    if first is not None:
        status, reference["reference_deg"] = "converged", (SCAN_DEG[first], SCAN_DEG[first + 1])
    reference["reference_others_deg"] = [(SCAN_DEG[i], SCAN_DEG[i + 1]) for i in changes if i != first]
    return Comparison(**found, **reference, reference_status=status)


def compare_walls(numbered: tuple[int, Case]) -> Comparison:
    """Compare the intervals of the outcome with a scan by trajectories with converged settings."""
    number, case = numbered
    found, answer = _timed(number, case)
    reference: dict[str, Any] = {"reference_deg": None, "reference_others_deg": []}
    if isinstance(answer, RicochetError):
        return Comparison(**found, **reference, reference_status="")
    wrong = []
    try:
        for angle in SCAN_DEG:
            ends = [interval for interval in answer.outcomes if _holds(interval, angle)]
            if not ends or (len(ends) == 1 and ends[0].outcome is not _outcome(case, angle)):
                wrong.append(angle)
    except RicochetError as error:
        return Comparison(**found, **reference, reference_status=repr(error))
    return Comparison(**found, **reference, reference_status=found["status"], wrong_deg=wrong)


def _holds(interval: OutcomeInterval, angle_deg: float) -> bool:
    """Return whether an angle is in an interval, or within the tolerance of it."""
    lower, upper = math.degrees(interval.lower), math.degrees(interval.upper)
    return lower - TOLERATED_DEG <= angle_deg <= upper + TOLERATED_DEG


def _outcome(case: Case, angle_deg: float) -> Outcome:
    """Return the outcome of a fine trajectory; `in_motion` counts as embedded."""
    strike: dict[str, Any] = dict(case)
    attack = strike.pop("angle_of_attack")
    impact = Impact(velocity=strike.pop("velocity"), oblique_angle=math.radians(angle_deg), angle_of_attack=attack)
    outcome = simulate(**strike, impact=impact, numerics=SCANNED, sample_interval=None).outcome
    return Outcome.EMBEDDED if outcome is Outcome.IN_MOTION else outcome


def _turned_away(case: Case, angle_deg: float) -> bool:
    return _outcome(case, angle_deg) is Outcome.RICOCHET


def _timed(number: int, case: Case) -> tuple[dict[str, Any], CriticalAngle | RicochetError]:
    """Compute a case with default settings; return the fields of its `Comparison`, and the answer."""
    begin = time.process_time()
    answer = answer_or_error(case)
    middle = time.process_time()
    paper_critical_angle()
    paper_s = time.process_time() - middle
    angle, others = _angles(answer)
    warnings = answer.warnings if isinstance(answer, CriticalAngle) else ()
    fields = {
        "number": number,
        "inputs": {name: repr(value) for name, value in case.items()},
        "status": _status(answer),
        "angle_deg": angle,
        "others_deg": others,
        "doubts": sorted(DOUBTS & {warning.code for warning in warnings}),
        "cpu_s": middle - begin,
        "paper_cpu_s": paper_s,
    }
    return fields, answer


def _status(answer: CriticalAngle | RicochetError) -> str:
    return answer.status.value if isinstance(answer, CriticalAngle) else repr(answer)


def _angles(answer: CriticalAngle | RicochetError) -> tuple[float | None, list[float]]:
    """Return the critical angle, and the other angles at which the outcome changes. [°]"""
    if isinstance(answer, RicochetError):
        return None, []
    return None if answer.angle is None else math.degrees(answer.angle), [*map(math.degrees, answer.other_crossings)]


def summarize(rows: list[Comparison]) -> dict[str, Any]:
    """Return the rows of the summary, by name: counts, differences and times."""
    differences = [row.difference_deg for row in rows if row.difference_deg is not None]
    counts = Counter(row.disagreement for row in rows)
    paper_s = statistics.median(row.paper_cpu_s for row in rows)
    unwarned = [row for row in rows if row.disagreement in NEEDS_WARNING and not row.doubts]
    return {
        "cases": len(rows),
        **{f"status {name}": number for name, number in sorted(Counter(row.status for row in rows).items())},
        "median difference [°]": statistics.median(differences) if differences else None,
        "worst difference [°]": max(differences, default=None),
        **{f"disagree by {kind}": counts[kind] for kind in DISAGREEMENTS},
        "of them unwarned": len(unwarned),
        "unwarned by more than 1°": sum((row.difference_deg or 90.0) > 1.0 for row in unwarned),
        "with a warning, of all": sum(bool(row.doubts) for row in rows),
        "mean CPU time [ms]": 1e3 * statistics.fmean(row.cpu_s for row in rows),
        "slowest CPU time [ms]": 1e3 * max(row.cpu_s for row in rows),
        "the paper's angle, median [ms]": 1e3 * paper_s,
        "mean over the paper's": statistics.fmean(row.cpu_s for row in rows) / paper_s,
        "slowest over the paper's": max(row.cpu_s for row in rows) / paper_s,
    }


def passes(kind: str, rows: list[Comparison]) -> bool:
    """Return whether the comparisons of a set have no more disagreements than allowed."""
    wrong = [row for row in rows if row.disagreement not in ("", "other crossings")]
    warned = all(row.doubts and row.disagreement != "error" for row in wrong)
    return not wrong or (kind != "usual" and warned and len(wrong) <= TOLERATED_SHARE * len(rows))


def compare_routes(count: int, seed: int, processes: int) -> bool:
    """Print the numbers of combinations and the unexplained differences between the methods.

    Return True if there are no such differences and, with at least `routes.FULL_TABLE` strikes, every combination
    occurred.
    """
    strikes = list(random_strikes(count, seed))
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), initializer=warm_up) as pool:
        rows = list(pool.map(routes.compare, range(count), strikes, chunksize=20))
    table = routes.table_of_combinations(strikes)
    print(f"# routes, seed {seed}\n{count} strikes, {len(table)} combinations, {sum(table.values())} compared")
    for extras in ("crater", "plug", "attack", "spin"):
        chosen = sum(number for each, number in table.items() if getattr(each, extras))
        print(f"with {extras:33} {chosen}")
    print(f"\n{'strikes by body, target and decay':38} " + " ".join(f"{name:>24}" for name in routes.DECAYS))
    for body in routes.BODIES:
        for wall in (False, True):
            cells = [
                [number for each, number in table.items() if each[:3] == (body, wall, decay)] for decay in routes.DECAYS
            ]
            texts = [f"{sum(cell)} ({min(cell)} to {max(cell)} each)" for cell in cells]
            name = f"{body}, {'wall' if wall else 'half-space'}"
            print(f"{name:38} " + " ".join(f"{text:>24}" for text in texts))
    print()
    for name, number in sorted(Counter(row.explained for row in rows).items()):
        print(f"{'equal, with ' + name if name else 'equal as they are, or different':38} {number}")
    differing = [row for row in rows if row.difference]
    print(f"{'different for no known reason':38} {len(differing)}")
    for row in differing:
        print(f"\nstrike {row.number}, {row.difference}: {row.adaptive} {row.panels}\n  {row.strike}")
    missing = sum(number == 0 for number in table.values())
    print(f"{'combinations that did not occur':38} {missing}\n", flush=True)
    return not differing and (missing == 0 or count < routes.FULL_TABLE)


SETS = {
    "usual": (compare_usual, random_cases, 200),
    "odd": (compare_odd, odd_cases, 300),
    "walls": (compare_walls, wall_cases, 200),
}


def run(compare: Callable[[tuple[int, Case]], Comparison], cases: list[Case], processes: int) -> list[Comparison]:
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), initializer=warm_up) as pool:
        return list(pool.map(compare, enumerate(cases)))


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare critical angles with references over random strikes.")
    parser.add_argument("--only", choices=(*SETS, "routes"), help="compute only this set")
    parser.add_argument(
        "--cases",
        type=int,
        help="number of cases in each set; default: 300 odd, 3,000 by both routes, 200 of the others",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--output", type=Path, help="JSON file for all comparisons")
    options = parser.parse_args()
    warm_up()
    found: dict[str, Any] = {"seed": options.seed, "machine": machine(), "versions": versions()}
    passed = True
    for kind, (compare, make_cases, count) in SETS.items():
        if options.only in (None, kind):
            cases = make_cases(options.cases or count, options.seed)
            rows = run(compare, list(one_by_one(cases)), options.processes)
            report(f"{kind}, seed {options.seed}", rows)
            found[kind] = {"summary": summarize(rows), "cases": [asdict(row) for row in rows]}
            passed = passed and passes(kind, rows)
    if options.only in (None, "routes"):
        passed = compare_routes(options.cases or ROUTES, options.seed, options.processes) and passed
    if options.output:
        options.output.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0 if passed else 1


def report(title: str, rows: list[Comparison]) -> None:
    """Print the summary of a set, and every disagreement."""
    print(f"# {title}")
    for name, value in summarize(rows).items():
        print(f"{name:38} {value:.4g}" if isinstance(value, float) else f"{name:38} {value}")
    for row in (row for row in rows if row.disagreement):
        print(f"\ncase {row.number}, {row.disagreement}: {row.status} {row.angle_deg} {row.others_deg}")
        print(f"  reference: {row.reference_status} {row.reference_deg} {row.reference_others_deg}")
        if row.wrong_deg:
            print(f"  another outcome at: {row.wrong_deg}")
        print(f"  warnings: {', '.join(row.doubts) or 'none'}; confirmed by fine trajectories: {row.confirmed}")
        print(*(f"  {name}={value}" for name, value in row.inputs.items()), sep="\n")
    print(flush=True)


if __name__ == "__main__":
    sys.exit(main())
