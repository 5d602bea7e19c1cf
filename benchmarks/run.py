"""Measure everything side by side; write results.json, results.md, work_precision.svg and throughput.svg.

    python benchmarks/run.py            # some minutes
    python benchmarks/run.py --quick    # under half a minute, to see that it runs; writes to a temporary folder
    python benchmarks/run.py --full     # also 10,000 and 100,000 strikes: three quarters of an hour
    python benchmarks/run.py --only scaling    # one part anew, beside the others as they were

Nothing that is measured compiles: every process calls `solver.warm_up` first. Progress goes to stderr. results.json is
written after each part: a run that is stopped keeps what it has measured.

results.json
------------
A *spread* is ``{"median", "lowest", "highest", "count"}`` over repetitions. Times are in seconds.

``parts``
    For each part that was measured: ``measured_at``, ``duration_s``, ``settings``, ``machine`` (processor, cores,
    memory, system, load before) and ``versions`` (Python, numpy, numba, llvmlite, ricochet, engine).
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
``scaling``
    ``strikes``; for ``threads``, ``processes`` and two loops that share nothing, ``multiply_adds`` and ``registers``,
    spreads ``times_one`` (wall time of one worker over that of two), ``cpu_ratio`` (CPU time of two over that of one)
    and ``busy`` (CPU time of two over their wall time).
``throughput``, ``long_batches``
    Lists, the second of 10,000 and 100,000 strikes, with ``--full``; each has ``cases``, ``kind`` (``threads`` or
    ``processes``), ``workers``; spreads ``wall_s_per_case``, ``cpu_s_per_case``, ``cases_per_second``,
    ``times_one_worker`` (wall time of one worker over this); ``failures``.
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
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.converged import compute_references
from benchmarks.machine import machine, versions
from benchmarks.routes import measure_routes
from benchmarks.scaling import measure_scaling
from benchmarks.startup import measure_startup
from benchmarks.tables import as_markdown
from benchmarks.throughput import Sizes, measure_throughput
from benchmarks.work_precision import measure_work_precision
from solver import warm_up

HERE = Path(__file__).parent
QUICK = Sizes(counts=(2,), mix=2, repetitions=1, longest=10.0, most_for_processes=2)
USUAL = Sizes(counts=(1, 10, 100, 1_000), mix=100, repetitions=3, longest=600.0, most_for_processes=1_000)
LONG = replace(USUAL, counts=(10_000, 100_000), longest=2_400.0)


def routes(options: argparse.Namespace) -> dict[str, Any]:
    """The routes side by side, for an angle and for a trajectory."""
    references = compute_references()
    return {"references": references.as_json(), **measure_routes(options.repetitions, references)}


def startup(options: argparse.Namespace) -> dict[str, Any]:
    """Fresh processes."""
    return {"startup": measure_startup(options.repetitions, compiling=not options.quick)}


def work_precision(options: argparse.Namespace) -> dict[str, Any]:
    """Cost against error."""
    return {"work_precision": measure_work_precision(1 if options.quick else 3, coarse=options.quick)}


def scaling(options: argparse.Namespace) -> dict[str, Any]:
    """Two threads over one."""
    return {"scaling": measure_scaling(strikes=10 if options.quick else 1_000, turns=1 if options.quick else 9)}


def throughput(options: argparse.Namespace) -> dict[str, Any]:
    """Many strikes at once."""
    return {"throughput": measure_throughput(QUICK if options.quick else USUAL)}


def long_batches(options: argparse.Namespace) -> dict[str, Any]:
    """Very many strikes at once."""
    return {"long_batches": measure_throughput(QUICK if options.quick else LONG)}


PARTS: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
    part.__name__: part for part in (routes, startup, work_precision, scaling, throughput, long_batches)
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the solver against a NumPy script.")
    parser.add_argument("--quick", action="store_true", help="a smoke run of under half a minute")
    parser.add_argument("--full", action="store_true", help="10,000 and 100,000 strikes as well")
    parser.add_argument("--only", choices=PARTS, nargs="+", help="measure these parts anew, and keep the others")
    parser.add_argument("--repetitions", type=int, help="of the routes; 5 unless given")
    parser.add_argument("--output", type=Path, help="folder to write to; this one, or a temporary one with --quick")
    options = parser.parse_args()
    options.repetitions = options.repetitions or (1 if options.quick else 5)
    folder = options.output or (Path(tempfile.gettempdir()) / "ricochet-benchmarks" if options.quick else HERE)
    folder.mkdir(parents=True, exist_ok=True)

    file = folder / "results.json"
    results: dict[str, Any] = {"parts": {}}
    if file.exists():
        results = json.loads(file.read_text(encoding="utf-8"))
    warm_up()
    usual = [name for name in PARTS if options.full or name != long_batches.__name__]
    for name in options.only or usual:
        print(f"measuring {name}", file=sys.stderr)
        about = {"measured_at": datetime.now(UTC).isoformat(timespec="seconds"), "machine": machine()}
        begin = time.perf_counter()
        results |= PARTS[name](options)
        results["parts"][name] = {
            **about,
            "duration_s": round(time.perf_counter() - begin, 1),
            "settings": {"quick": options.quick, "repetitions": options.repetitions},
            "versions": versions(),
        }
        file.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    if results["parts"].keys() >= set(usual):
        (folder / "results.md").write_text(as_markdown(results), encoding="utf-8")
        subprocess.run(
            [sys.executable, str(HERE / "plots.py"), str(folder)], check=True
        )  # keeps matplotlib out of here
    print(f"wrote what was measured to {folder}", file=sys.stderr)


if __name__ == "__main__":
    main()
