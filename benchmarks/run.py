"""Measure everything side by side; write results.json, results.md, work_precision.svg and throughput.svg.

    python benchmarks/run.py            # some minutes
    python benchmarks/run.py --quick    # under half a minute, to see that it runs; writes to a temporary folder
    python benchmarks/run.py --full     # also 10,000 and 100,000 strikes: three quarters of an hour

Nothing that is measured compiles: every process calls `solver.warm_up` first. Progress goes to stderr.

results.json
------------
A *spread* is ``{"median", "lowest", "highest", "count"}`` over repetitions. Times are in seconds.

``measured_at``, ``duration_s``, ``settings``
    When, for how long, and with which options.
``machine``, ``versions``
    Processor, cores, memory, system, load before; Python, numpy, numba, llvmlite, ricochet, engine.
``references``
    ``by_outcome_deg`` and ``by_tip_at_5_ms_deg``, the converged critical angles by the criterion of the solver and by
    the paper's, with the settings behind them.
``angles``
    ``numpy_script``, ``panels_secant``, ``adaptive_outcome``, each with ``label``; spreads ``cpu_s``, ``wall_s``,
    ``cpu_ratio``, ``wall_ratio`` (the script's over its own, in the same repetition); ``angle_deg``, ``trajectories``,
    ``error_deg`` (against ``by_outcome_deg``), ``error_of_own_criterion_deg``. The script also has ``system_s``, the
    operating system's part of its CPU time.
``trajectories``
    ``numpy_script``, ``panels``, ``adaptive``, ``adaptive_history``: the same times and ratios; ``times_s``,
    ``tip_depth_m``, ``error_m`` (lists, one entry a time), ``greatest_error_m``.
``throughput``
    A list; each has ``cases``, ``kind`` (``threads`` or ``processes``), ``workers``; spreads ``wall_s_per_case``,
    ``cpu_s_per_case``, ``cases_per_second``, ``times_one_worker`` (wall time of one worker over this); ``failures``.
``startup``
    Spreads ``import_s``, ``answer_s``, ``cpu_s``, ``process_s``, ``resident_mb`` of a fresh process with its compiled
    code on disk; ``compiling_s``, the same process when it must compile (not with ``--quick``).
``work_precision``
    ``bracket_deg``, ``reference`` and ``points``, each with ``series``, ``route``, settings, ``cpu_s`` (spread),
    ``trajectories``, ``angle_deg``, ``error_deg``.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.converged import compute_references
from benchmarks.machine import machine, versions
from benchmarks.routes import measure_routes
from benchmarks.startup import measure_startup
from benchmarks.tables import as_markdown
from benchmarks.throughput import Sizes, measure_throughput
from benchmarks.work_precision import measure_work_precision
from solver import warm_up

HERE = Path(__file__).parent
QUICK = Sizes(counts=(2,), mix=2, repetitions=1, longest=10.0, most_for_processes=2)
USUAL = Sizes(counts=(1, 10, 100, 1_000), mix=100, repetitions=3, longest=600.0, most_for_processes=1_000)
FULL = replace(USUAL, counts=(*USUAL.counts, 10_000, 100_000), longest=1_800.0)


def measure(*, quick: bool, full: bool, repetitions: int) -> dict[str, Any]:
    """All results, in the form the head of this file tells."""
    begin = time.perf_counter()
    about = {
        "measured_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "settings": {"quick": quick, "full": full, "repetitions": repetitions},
        "machine": machine(),
        "versions": versions(),
    }
    print("warming up", file=sys.stderr)
    warm_up()
    references = compute_references()
    routes = measure_routes(repetitions, references)
    print("fresh processes", file=sys.stderr)
    startup = measure_startup(repetitions, compiling=not quick)
    work_precision = measure_work_precision(1 if quick else 3, coarse=quick)
    throughput = measure_throughput(QUICK if quick else FULL if full else USUAL)
    return {
        **about,
        "duration_s": round(time.perf_counter() - begin, 1),
        "references": references.as_json(),
        **routes,
        "throughput": throughput,
        "startup": startup,
        "work_precision": work_precision,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the solver against a NumPy script.")
    parser.add_argument("--quick", action="store_true", help="a smoke run of under half a minute")
    parser.add_argument("--full", action="store_true", help="10,000 and 100,000 strikes as well")
    parser.add_argument("--repetitions", type=int, help="of the routes; 5 unless given")
    parser.add_argument("--output", type=Path, help="folder to write to; this one, or a temporary one with --quick")
    options = parser.parse_args()
    folder = options.output or (Path(tempfile.gettempdir()) / "ricochet-benchmarks" if options.quick else HERE)
    folder.mkdir(parents=True, exist_ok=True)

    results = measure(
        quick=options.quick, full=options.full, repetitions=options.repetitions or (1 if options.quick else 5)
    )
    (folder / "results.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    (folder / "results.md").write_text(as_markdown(results), encoding="utf-8")
    subprocess.run([sys.executable, str(HERE / "plots.py"), str(folder)], check=True)  # keeps matplotlib out of here
    print(f"wrote results.json and results.md to {folder}", file=sys.stderr)


if __name__ == "__main__":
    main()
