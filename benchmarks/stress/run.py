"""Measure what the service has to hold, under load and through faults; write stress.json and stress.md.

    python -m benchmarks.stress            # up to ten minutes, without the soak
    python -m benchmarks.stress --quick    # two minutes, to see that it runs; writes to a temporary folder
    python -m benchmarks.stress --full     # 20,000 and 100,000 cases, 50 rounds of every fault, the soak: an hour
    python -m benchmarks.stress --only soak

Everything runs on this machine: servers with folders of their own, and clients over the loopback interface. Progress
goes to stderr. In stress.json every part has its machine, date and command, and every line of its table a number, what
was required and measured, whether it held, and under ``details`` the figures behind it; times are in seconds. Parts
that are not measured stay as they were.
"""

import argparse
import sys
import tempfile
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.machine import machine, versions
from benchmarks.stress import load, soak
from benchmarks.stress.attacks import measure_attacks
from benchmarks.stress.faults import measure_faults
from benchmarks.stress.hostile import measure_hostile
from benchmarks.stress.lines import Line
from benchmarks.stress.report import as_json, as_table, write_part
from solver import warm_up

HERE = Path(__file__).parents[1]
PACKAGES = ("fastapi", "uvicorn", "uvloop", "pydantic", "orjson", "h5py")
PARTS = ("load", "hostile", "attacks", "faults", "soak")
BODIES, FEW_BODIES = 10_000, 500
FAULT_SECONDS, FEW_FAULT_SECONDS = 180.0, 30.0
"""For as many rounds of faults as fit."""


def measure(part: str, *, quick: bool, full: bool) -> list[Line]:
    """Every line of a part."""
    if part == "load":
        return load.measure_load(load.QUICK if quick else load.FULL if full else load.USUAL)
    if part == "hostile":
        return measure_hostile(FEW_BODIES if quick else BODIES)
    if part == "attacks":
        return measure_attacks(quick=quick)
    if part == "faults":
        return list(measure_faults(full=full, seconds=FEW_FAULT_SECONDS if quick else FAULT_SECONDS))
    return soak.measure_soak(soak.QUICK if quick else soak.FULL)


def measure_part(part: str, *, quick: bool, full: bool) -> tuple[dict[str, Any], list[Line]]:
    """Measure a part; return on what, when and how, and its lines."""
    begin = time.perf_counter()
    about: dict[str, Any] = {"machine": machine()}
    lines = measure(part, quick=quick, full=full)
    about |= {
        "measured_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": " ".join(["python -m benchmarks.stress", *sys.argv[1:]]),
        "duration_s": round(time.perf_counter() - begin, 1),
        "versions": versions() | {name: version(name) for name in PACKAGES},
    }
    return about, lines


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stress", description="Measure what the service has to hold."
    )
    parser.add_argument("--quick", action="store_true", help="a smoke run of two minutes")
    parser.add_argument("--full", action="store_true", help="larger batches, more rounds and the soak, an hour")
    parser.add_argument("--only", choices=PARTS, help="one part of it")
    parser.add_argument("--output", type=Path, help="folder to write to; benchmarks, or a temporary one with --quick")
    options = parser.parse_args()
    folder = options.output or (Path(tempfile.gettempdir()) / "ricochet-benchmarks" if options.quick else HERE)
    folder.mkdir(parents=True, exist_ok=True)

    warm_up()
    usual = [part for part in PARTS if part != "soak" or options.quick or options.full]
    held = True
    for part in [options.only] if options.only else usual:
        about, lines = measure_part(part, quick=options.quick, full=options.full)
        print(as_table(lines))
        held &= all(line.held is not False for line in lines)
        write_part(folder, part, as_json(about, lines))
    print(f"wrote stress.json and stress.md to {folder}", file=sys.stderr)
    sys.exit(not held)
