"""Compilation of the whole solver in advance, so that no computation has to wait for it."""

import os
import subprocess
import sys
from collections.abc import Callable
from warnings import warn

from solver.compilation import Progress, can_keep, compilation_progress
from solver.search.critical_angle import critical_angle
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, Numerics, paper_impact
from solver.trajectory import simulate

# Compilation takes about a minute. A line each second shows that it is making progress.
POLL_SECONDS = 1.0
"""Interval between progress reports. [s]"""

Report = Callable[[str], object]
"""Function that shows a progress line to the user."""


def warm_up(report: Report | None = None) -> None:
    """Compile all functions of the solver, or load them from the cache.

    The first call on a machine takes about a minute, later ones a fraction of a second. Functions that are not in the
    cache are compiled in another process, so that the memory of the compiler is freed when that process ends. If that
    process fails, a `RuntimeWarning` gives the reason, and this process compiles the rest. If the cache cannot be
    written, this process compiles everything.

    Parameters
    ----------
    report
        Function such as `print`, called with a progress line at the beginning, and then once a second if there is
        progress.
    """
    progress = compilation_progress()
    if progress.left and sys.executable and can_keep():
        _compile_elsewhere(report or (lambda _: None), progress)
    run_trajectories()
    run_search()


def _compile_elsewhere(report: Report, progress: Progress) -> None:
    """Compile the solver in another process and report its progress."""
    report(str(progress))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    script = f"from {__name__} import run_search, run_trajectories; run_trajectories(); run_search()"
    command = [sys.executable, "-c", script]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)  # noqa: S603 (our own)
    errors = None
    while errors is None:
        try:
            _, errors = process.communicate(timeout=POLL_SECONDS)
        except subprocess.TimeoutExpired:
            if (now := compilation_progress()) != progress:
                progress = now
                report(str(progress))
    if process.returncode:
        cause = (errors.strip().splitlines() or ["no message"])[-1]
        text = f"a process that compiles the solver ended with code {process.returncode}: {cause}"
        warn(text, RuntimeWarning, stacklevel=3)


def run_trajectories() -> None:
    """Run a short trajectory by each method, which compiles all functions of trajectories."""
    for method in ("adaptive", "panels"):
        simulate(
            projectile=PAPER_PROJECTILE,
            target=PAPER_TARGET,
            impact=paper_impact(oblique_angle_degrees=45.0),
            numerics=Numerics(method=method, panels=100, termination_time=1e-4),
            sample_interval=1e-4,
        )


def run_search() -> None:
    """Find the critical angle of the paper's strike, which compiles all functions of searches."""
    critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY)
