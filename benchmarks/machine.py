"""What the figures were measured on and with."""

import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from solver import ENGINE_VERSION


def machine() -> dict[str, Any]:
    """Processor, cores, memory and operating system, and how busy the machine was."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "os": f"{_system()}, {platform.system()} {platform.release()}, {platform.machine()}",
        "load_average_before": round(os.getloadavg()[0], 2),
    }


def versions() -> dict[str, str]:
    """Of Python, of the packages that decide the speed, and of the solver."""
    packages = {name: version(name) for name in ("numpy", "numba", "llvmlite", "ricochet")}
    return {"python": platform.python_version()} | packages | {"engine": ENGINE_VERSION}


def _processor() -> str:
    """Name the processor gives itself; Linux alone tells it in a file."""
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
