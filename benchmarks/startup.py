"""Time and memory that a new process needs for its first critical angle.

    python benchmarks/startup.py [--quick] [--repetitions 5]

Each repetition starts a process that loads compiled code from disk, and the command `ricochet cra`, which also computes
the range of the angle. Without `--quick`, one more process has no compiled code and compiles it, in half a minute or
more.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.machine import print_machine, print_table, spread, time_spread
from solver import warm_up

FIRST_ANSWER = """
import time
begin = time.perf_counter()
import json, resource
from solver import critical_angle
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
imported = time.perf_counter()
critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY)
answered, at = time.perf_counter(), time.monotonic()
memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps({"import": imported - begin, "answer": answered - imported, "at": at, "memory": memory}))
"""
COMMAND = """cra --nose ogive --caliber-radius-head 3 --diameter 0.08 --length 0.53 --mass 13
--compressive-strength 39e6 --density 2250 --velocity 238"""


def start(**environment: str) -> dict[str, float]:
    """Run a process that computes one angle; return its times [s] and its largest resident memory [bytes]."""
    begin = time.monotonic()
    command = [sys.executable, "-c", FIRST_ANSWER]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, check=True)
    times: dict[str, float] = json.loads(done.stdout)
    return times | {"until": times["at"] - begin, "process": time.monotonic() - begin}


def run_command() -> dict[str, float]:
    """Run `ricochet cra`; return its wall time and processor time. [s]"""
    begin, before = time.monotonic(), os.times()
    subprocess.run([Path(sys.executable).with_name("ricochet"), *COMMAND.split()], capture_output=True, check=True)
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return {"process": time.monotonic() - begin, "processor": used}


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the first critical angle of new processes.")
    parser.add_argument("--quick", action="store_true", help="measure one repetition without compilation")
    parser.add_argument("--repetitions", type=int, default=5)
    options = parser.parse_args()
    print_machine()
    warm_up()
    repetitions = range(1 if options.quick else options.repetitions)
    starts, commands = [start() for _ in repetitions], [run_command() for _ in repetitions]
    rows = [
        ["import of the solver", time_spread([each["import"] for each in starts])],
        ["first critical angle", time_spread([each["answer"] for each in starts])],
        ["from the start of the interpreter to that angle", time_spread([each["until"] for each in starts])],
        ["whole process, its end included", time_spread([each["process"] for each in starts])],
        ["`ricochet cra`", time_spread([each["process"] for each in commands])],
        ["its processor time", time_spread([each["processor"] for each in commands])],
        ["most resident memory", spread([each["memory"] / 1e6 for each in starts], "MB")],
    ]
    if not options.quick:
        with tempfile.TemporaryDirectory() as folder:
            compiling = start(NUMBA_CACHE_DIR=folder)["process"]
        rows.append(["whole process when everything is compiled first", f"{compiling:.1f} s"])
    print_table(["a fresh process", "median (lowest-highest)"], rows)


if __name__ == "__main__":
    main()
