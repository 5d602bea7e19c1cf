"""What runs inside the pool: the solver only. Takes solver objects, returns solver results."""

import fcntl
import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from solver import CriticalAngle, Impact, Trajectory, critical_angle, simulate, warm_up

READY = b"ready"
NICENESS = 5
"""Below the server, which has to answer others while the workers fill the cores."""
STRIKE = ("velocity", "angle_of_attack", "angular_velocity")
"""What a critical angle is sought for and a run takes as part of its impact."""


@dataclass(frozen=True, slots=True)
class CriticalCase:
    """A critical angle and, if it was asked for and there is one, the motion at it."""

    found: CriticalAngle
    trajectory: Trajectory | None


def run_trajectory(arguments: Mapping[str, Any]) -> Trajectory:
    """Run :func:`solver.simulate` with these keyword arguments."""
    return simulate(**arguments)


def run_cra(arguments: Mapping[str, Any], sample_interval: float | None) -> CriticalCase:
    """Run :func:`solver.critical_angle` with these keyword arguments; a sample interval asks for the motion too."""
    found = critical_angle(**arguments)
    if sample_interval is None or found.angle is None:
        return CriticalCase(found, None)
    motion = dict(arguments)
    motion.pop("search", None)
    strike = {name: motion.pop(name) for name in STRIKE if name in motion}
    motion["impact"] = Impact(oblique_angle=found.angle, **strike)
    return CriticalCase(found, simulate(**motion, sample_interval=sample_interval))


def serve(pipe: Connection) -> None:
    """Body of a worker process: answer one task after the other until the other end of the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent ends its workers itself
    end_with_parent()
    os.nice(NICENESS)
    warm_up()
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        pipe.send_bytes(READY)
        while True:
            pipe.send_bytes(answer(pipe.recv_bytes()))


def answer(message: bytes) -> bytes:
    """Run a pickled (function, arguments); return the pickled (True, result) or (False, exception)."""
    try:
        function, arguments = pickle.loads(message)  # noqa: S301 (from the parent only)
        return pickle.dumps((True, function(*arguments)), pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001 (whatever it is, the parent raises it)
        error.add_note("".join(traceback.format_exception(error)))
        try:
            return pickle.dumps((False, error), pickle.HIGHEST_PROTOCOL)
        except Exception:  # noqa: BLE001 (an exception may hold anything)
            return pickle.dumps((False, RuntimeError("\n".join(error.__notes__))), pickle.HIGHEST_PROTOCOL)


def end_with_parent() -> None:
    """Have the kernel end this process as soon as its parent has gone.

    A thread watching the parent would never run while compiled code holds the interpreter lock. SIGIO needs no
    interpreter: the kernel raises it when the pipe that only the parent holds open closes, and it is not caught.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, fcntl.fcntl(parent.sentinel, fcntl.F_GETFL) | os.O_ASYNC)
    if not parent.is_alive():  # it went before the kernel was asked
        sys.exit()
