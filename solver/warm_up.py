"""Load or compile every compiled function, so that no query has to wait for it."""

import os
import subprocess
import sys

from solver.cases import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact
from solver.compilation import can_keep, compilation_progress
from solver.numerics import Numerics
from solver.processors import PORTABLE
from solver.search.critical_angle import critical_angle
from solver.trajectory import simulate


def warm_up() -> None:
    """Run both routes and a search once: half a minute on a new machine, a fraction of a second after.

    What is not on disk is compiled in two other processes, each of which begins with another half; the memory that the
    compiler takes ends with them.
    """
    compiled, functions = compilation_progress()
    if compiled < functions and can_keep():
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        scripts = (f"from solver.warm_up import {name}; {name}()" for name in ("run_trajectories", "run_search"))
        commands = ([sys.executable, "-c", script] for script in scripts)
        begun = [subprocess.Popen(command, env=environment) for command in commands]  # noqa: S603 (our own)
        for process in begun:
            process.wait()
    run_trajectories()
    run_search()


def compile_portable(folder: str) -> None:
    """Compile for each of the processors of `solver.processors` that this one can run, into a folder of its name."""
    for each in PORTABLE:
        if each.runs_here:
            chosen = {"NUMBA_CPU_NAME": each.name, "NUMBA_CPU_FEATURES": each.features}
            environment = os.environ | chosen | {"NUMBA_CACHE_DIR": os.path.join(folder, each.name)}  # noqa: PTH118 (a string)
            command = [sys.executable, "-c", "import solver; solver.warm_up()"]
            subprocess.run(command, env=environment, check=True)  # noqa: S603 (our own)


def run_trajectories() -> None:
    """Run both routes once."""
    for method in ("adaptive", "panels"):
        simulate(
            projectile=PAPER_PROJECTILE,
            target=PAPER_TARGET,
            impact=paper_impact(oblique_angle_degrees=45.0),
            numerics=Numerics(method=method, panels=100, termination_time=1e-4),
            sample_interval=1e-4,
        )


def run_search() -> None:
    """Find one critical angle."""
    critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY)
