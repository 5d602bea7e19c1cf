"""Description of the machine and its software, and printing of tables."""

import os
import platform
import statistics
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from service.version import VERSION
from solver import ENGINE_VERSION


def machine() -> dict[str, Any]:
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "os": f"{_system()}, {platform.system()} {platform.release()}, {platform.machine()}",
        "load_average_before": round(os.getloadavg()[0], 2),
    }


def versions() -> dict[str, str]:
    """Return the versions of Python, of the packages that affect the speed, and of ricochet and its engine."""
    packages = {name: version(name) for name in ("numpy", "numba", "llvmlite")}
    return {"python": platform.python_version()} | packages | {"ricochet": VERSION, "engine": ENGINE_VERSION}


def print_machine() -> None:
    """Print date, machine and versions. Call this before a measurement, so that the load is that of other programs."""
    here = machine()
    print(f"{datetime.now(UTC):%Y-%m-%d}, {here['processor']}, {here['cores']} cores, {here['memory_gb']} GB;")
    print(f"{here['os']}; load average before {here['load_average_before']}.")
    print(", ".join(f"{name} {number}" for name, number in versions().items()) + ".\n", flush=True)


def print_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a Markdown table."""
    for row in (head, ["---"] * len(head), *rows):
        print(f"| {' | '.join(map(str, row))} |")
    print(flush=True)


def spread(values: Sequence[float], unit: str = "") -> str:
    """Return the median and, in brackets, the extremes of repeated measurements, as text."""
    low, middle, high = (_digits(value) for value in (min(values), statistics.median(values), max(values)))
    return f"{middle}{unit and f' {unit}'} ({low}-{high})"


def time_spread(seconds: Sequence[float]) -> str:
    """Return the median and the extremes of times as text, in the unit that suits the median."""
    median = statistics.median(seconds)
    unit, scale = ("s", 1.0) if median >= 1.0 else ("ms", 1e3) if median >= 1e-3 else ("µs", 1e6)
    return spread([scale * value for value in seconds], unit)


def _digits(value: float) -> str:
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def _processor() -> str:
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _system() -> str:
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except OSError:
        return platform.platform(terse=True)
