"""What runs inside the pool: the solver only. Takes solver objects, returns solver results."""

import fcntl
import multiprocessing
import os
import pickle
import select
import signal
import socket
import struct
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeAlias

from solver import CriticalAngle, Impact, ParameterError, Trajectory, critical_angle, simulate, warm_up
from solver.arrays import FloatArray
from solver.calibration import (
    DecayLawFits,
    DepthFit,
    MotionHistory,
    ObliquityFit,
    fit_decay_laws,
    fit_depth,
    fit_obliquity,
    penetration_depths,
    predict_motion,
)

Call: TypeAlias = tuple[Callable[..., Any], tuple[Any, ...]]
"""A picklable function and its arguments."""

READY = b"ready"
STOP = b""
"""Asks a worker to leave the calls it has not begun, and is its answer that it has."""
LENGTH = struct.Struct("!Q")
GULP = 1 << 18
"""Bytes to read at once: more than a socket holds. A reader that lags behind catches up in one read."""
NICENESS = 5
"""Below the server, which has to answer others while the workers fill the cores."""
STRIKE = ("velocity", "angle_of_attack", "angular_velocity")
"""What a critical angle is sought for and a run takes as part of its impact."""
MODEL = ("projectile", "target", "resistance")
"""What a fit and a prediction beside it have in common."""


@dataclass(frozen=True, slots=True)
class CriticalCase:
    """A critical angle and, if it was asked for and there is one, the motion at it."""

    found: CriticalAngle
    trajectory: Trajectory | None


@dataclass(frozen=True, slots=True)
class DepthCalibration:
    """A fit to depths, and curves beside it: strength factor, velocities and depths of each."""

    fit: DepthFit
    curves: Sequence[tuple[float, FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class MotionCalibration:
    """Fits to motions, and predictions beside them: for each run the strength factors and the motions.

    `several` says whether the request has runs.
    """

    fits: DecayLawFits
    compared: Sequence[Sequence[tuple[float, MotionHistory]]]
    several: bool


@dataclass(frozen=True, slots=True)
class Finished:
    """What became of a call.

    Parameters
    ----------
    value
        What it returned; None if it did not.
    error
        What it raised, or why the pool could not bring it to an end; None if it returned.
    seconds
        It took in the worker.
    """

    value: Any
    error: Exception | None
    seconds: float


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


def run_depth_calibration(
    arguments: Mapping[str, Any], strength_factors: Sequence[float], velocities: FloatArray
) -> DepthCalibration:
    """Run :func:`solver.calibration.fit_depth` with these keyword arguments, and a curve for each strength factor."""
    model = {name: arguments[name] for name in MODEL}
    fit = fit_depth(**arguments)
    curves = [
        (factor, velocities, penetration_depths(**model, velocities=velocities, strength_factor=factor))
        for factor in strength_factors
    ]
    return DepthCalibration(fit, curves)


def run_motion_calibration(
    arguments: Mapping[str, Any], strength_factors: Sequence[float], times: Sequence[FloatArray], several: bool
) -> MotionCalibration:
    """Run :func:`solver.calibration.fit_decay_laws` with these keyword arguments, and motions for strength factors.

    Raises
    ------
    ParameterError
        With the fields of the request, which are in `runs` even if there is but one.
    """
    try:
        fits = fit_decay_laws(**arguments)
    except ParameterError as error:
        if several and error.field.startswith("history."):
            raise ParameterError(f"runs.0.{error.field}", error.requirement) from None
        raise
    model = {name: arguments[name] for name in MODEL}
    compared = [
        [
            (factor, predict_motion(**model, impact=run.impact, times=rows, strength_factor=factor))
            for factor in strength_factors
        ]
        for run, rows in zip(arguments["runs"], times, strict=True)
    ]
    return MotionCalibration(fits, compared, several)


def run_obliquity_calibration(arguments: Mapping[str, Any]) -> ObliquityFit:
    """Run :func:`solver.calibration.fit_obliquity` with these keyword arguments."""
    return fit_obliquity(**arguments)


class Channel:
    """One end of a private socket, for whole messages.

    The connections of multiprocessing let go of the interpreter lock three times a message; in a busy server each time
    may cost the switch interval of 5 ms. This one does so twice, for as many messages as have arrived.
    """

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._arrived = bytearray()
        self._readable = select.poll()
        self._readable.register(end, select.POLLIN)

    def send(self, message: bytes, seconds: float | None = None) -> None:
        """Send a message; TimeoutError if the other end has not taken it in this time."""
        self._end.settimeout(seconds)
        self._end.sendall(LENGTH.pack(len(message)) + message)
        self._end.settimeout(None)  # with one, each recv would wait and let go of the lock once more

    def receive(self, seconds: float | None = None) -> bytes | None:
        """Next message, None if this time passes without a byte; EOFError if the other end has gone."""
        while (message := self._next()) is None:
            if not self._readable.poll(None if seconds is None else 1000.0 * seconds):
                return None
            gulp = self._end.recv(GULP)
            if not gulp:
                raise EOFError
            self._arrived += gulp
        return message

    def waiting(self) -> bool:
        """Tell whether there is something to receive, be it the end."""
        return bool(self._arrived or self._readable.poll(0))

    def close(self) -> None:
        """Hang up."""
        self._end.close()

    def _next(self) -> bytes | None:
        if len(self._arrived) < LENGTH.size:
            return None
        end = LENGTH.size + LENGTH.unpack_from(self._arrived)[0]
        if len(self._arrived) < end:
            return None
        with memoryview(self._arrived) as arrived:
            message = bytes(arrived[LENGTH.size : end])
        del self._arrived[:end]
        return message


def serve(end: socket.socket) -> None:
    """Body of a worker process: work off one chunk after the other until the other end of the channel closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent ends its workers itself
    end_with_parent()
    os.nice(NICENESS)
    warm_up()
    channel = Channel(end)
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        channel.send(READY)
        while True:
            message = channel.receive()
            if message == STOP:
                channel.send(STOP)
            elif message is not None:
                work_off(pickle.loads(message), channel)  # noqa: S301 (from the parent only)


def work_off(calls: Sequence[bytes], channel: Channel) -> None:
    """Answer these calls one after the other, until there is word from the parent: that can only be to stop."""
    for call in calls:
        if channel.waiting():
            return
        channel.send(answer(call))


def answer(call: bytes) -> bytes:
    """Run a pickled call; return the pickled (value, error, seconds) of what became of it."""
    started = time.perf_counter()
    try:
        function, arguments = pickle.loads(call)  # noqa: S301 (from the parent only)
        result = function(*arguments)
        return pickle.dumps((result, None, time.perf_counter() - started), pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001 (whatever it is, the parent has to know)
        seconds = time.perf_counter() - started
        error.add_note("".join(traceback.format_exception(error)))
        try:
            return pickle.dumps((None, error, seconds), pickle.HIGHEST_PROTOCOL)
        except Exception:  # noqa: BLE001 (an exception may hold anything)
            told = RuntimeError("\n".join(error.__notes__))
            return pickle.dumps((None, told, seconds), pickle.HIGHEST_PROTOCOL)


def packed(call: Call) -> bytes:
    """Pickle a call; one that cannot be pickled becomes a call that says so."""
    try:
        return pickle.dumps(call, pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001 (arguments may hold anything)
        return pickle.dumps((refuse, (str(error),)))


def refuse(why: str) -> None:
    """Stand in for a call that could not be pickled."""
    raise pickle.PicklingError(why)


def unpacked(reply: bytes) -> Finished:
    """Unpickle what became of a call."""
    try:
        return Finished(*pickle.loads(reply))  # noqa: S301 (from our own worker)
    except Exception as error:  # noqa: BLE001 (some exceptions can be pickled, but not back)
        return Finished(None, error, 0.0)


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
