"""Measure what the service has to hold, under load and through faults; write stress.json and stress.md.

    python -m benchmarks.stress            # up to ten minutes
    python -m benchmarks.stress --quick    # a minute, to see that it runs; writes to a temporary folder
    python -m benchmarks.stress --full     # 20,000 and 100,000 cases, 50 rounds of every fault: 40 minutes
    python -m benchmarks.stress --only load

Everything runs on this machine: servers with folders of their own, and clients over the loopback interface. Progress
goes to stderr. In stress.json every line of the table has its number, what was required and measured, whether it held,
and under ``details`` the figures behind it; times are in seconds.
"""

import argparse
import json
import sys
import tempfile
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.machine import machine, versions
from benchmarks.stress import load
from benchmarks.stress.attacks import measure_attacks
from benchmarks.stress.faults import measure_faults
from benchmarks.stress.hostile import measure_hostile
from benchmarks.stress.lines import Line
from benchmarks.stress.report import as_json, as_markdown, as_table
from solver import warm_up

HERE = Path(__file__).parents[1]
PACKAGES = ("fastapi", "uvicorn", "uvloop", "pydantic", "orjson", "h5py")
PARTS = ("load", "hostile", "attacks", "faults")
BODIES, FEW_BODIES = 10_000, 500
FAULT_SECONDS, FEW_FAULT_SECONDS = 180.0, 30.0
"""For as many rounds of faults as fit."""


def measure(parts: list[str], *, quick: bool, full: bool) -> list[Line]:
    """Every line that is asked for, by number."""
    warm_up()
    lines: list[Line] = []
    if "load" in parts:
        lines += load.measure_load(load.QUICK if quick else load.FULL if full else load.USUAL)
    if "hostile" in parts:
        lines += measure_hostile(FEW_BODIES if quick else BODIES)
    if "attacks" in parts:
        lines += measure_attacks(quick=quick)
    if "faults" in parts:
        lines += measure_faults(full=full, seconds=FEW_FAULT_SECONDS if quick else FAULT_SECONDS)
    return sorted(lines, key=lambda line: line.number)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stress", description="Measure what the service has to hold."
    )
    parser.add_argument("--quick", action="store_true", help="a smoke run of a minute")
    parser.add_argument("--full", action="store_true", help="larger batches and more rounds, 40 minutes")
    parser.add_argument("--only", choices=PARTS, help="one part of it")
    parser.add_argument("--output", type=Path, help="folder to write to; benchmarks, or a temporary one with --quick")
    options = parser.parse_args()
    folder = options.output or (Path(tempfile.gettempdir()) / "ricochet-benchmarks" if options.quick else HERE)
    folder.mkdir(parents=True, exist_ok=True)

    begin = time.perf_counter()
    about: dict[str, Any] = {"machine": machine()}
    lines = measure([options.only] if options.only else list(PARTS), quick=options.quick, full=options.full)
    about |= {
        "measured_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": " ".join(["python -m benchmarks.stress", *sys.argv[1:]]),
        "duration_s": round(time.perf_counter() - begin, 1),
        "versions": versions() | {name: version(name) for name in PACKAGES},
    }
    print(as_table(lines))
    (folder / "stress.json").write_text(json.dumps(as_json(about, lines), indent=1) + "\n", encoding="utf-8")
    (folder / "stress.md").write_text(as_markdown(about, lines), encoding="utf-8")
    print(f"wrote stress.json and stress.md to {folder}", file=sys.stderr)
    sys.exit(0 if all(line.held is not False for line in lines) else 1)
