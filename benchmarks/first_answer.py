"""From nothing to the first answer in a fresh process, and the memory it then holds; prints JSON.

python benchmarks/first_answer.py
"""

import time

begin = time.perf_counter()

import json  # noqa: E402 # the clock starts before anything else
import os  # noqa: E402
import resource  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402

from solver import critical_angle  # noqa: E402
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY  # noqa: E402

imported = time.perf_counter()


def resident_memory() -> float:
    """Of this process now; at its peak where the system tells no more. [MB]"""
    pages = Path("/proc/self/statm")
    if pages.exists():
        return int(pages.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0) / 1e6


def main() -> None:
    critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY)
    answered = time.perf_counter()
    spent = {"import_s": imported - begin, "answer_s": answered - imported, "cpu_s": time.process_time()}
    print(json.dumps(spent | {"resident_mb": resident_memory()}))


if __name__ == "__main__":
    main()
