"""Computations that end early: when a signal handler raises in the main thread, or when another thread gives them up.

Python runs signal handlers between two steps of its own, never during a compiled call. So compiled code looks at two
numbers before each of its steps, its control, and every call of it goes through `compute`.
"""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

import numpy as np

from solver.arrays import IntArray
from solver.compilation import lean

CANCELLED, STEPS_LEFT = range(2)
"""Places in a control: not zero to end the computation, and the number of steps that it may take."""
NO_LIMIT = 2**62
"""Steps, more than any computation takes."""
QUICK_STEPS = 20_000
"""Steps of a computation in the main thread, of 10 to 20 µs each. One that needs more, a few in a thousand, is begun
again in another thread, for 0.3 ms, and the main thread is free for signals. A usual search takes 1,000 steps."""
PANELS_PER_STEP = 100
"""Panels whose loads take as long as those of a step by Gauss points."""

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class CancelledError(Exception):
    """A computation was given up by `Cancellation.cancel`. It is no `RicochetError`: it says nothing of the case."""


@lean
def may_step(control: IntArray) -> bool:
    """Count a step; return whether it may be taken. Another thread writes to the control meanwhile."""
    control[STEPS_LEFT] -= 1
    return bool(control[CANCELLED] == 0 and control[STEPS_LEFT] >= 0)


class Cancellation:
    """Gives up computations from another thread, those that run and those that begin later.

    Examples
    --------
    In the thread that computes::

        answer = cancellation.run(critical_angle, projectile=projectile, target=target, velocity=238.0)

    In another one, upon which the first raises `CancelledError` within a step::

        cancellation.cancel()
    """

    def __init__(self) -> None:
        self._parent = _current.get()
        self._lock = threading.RLock()  # A signal handler that cancels may interrupt this very class.
        self._cancelled = False
        self._controls: dict[int, IntArray] = {}

    def run(self, function: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        """Call a function, whose computations in this thread can then be given up.

        Raises
        ------
        CancelledError
            If they were.
        """
        token = _current.set(self)
        try:
            return function(*args, **kwargs)
        finally:
            _current.reset(token)

    def cancel(self) -> None:
        """Give up the computations; this can be called by any thread, and more than once."""
        with self._lock:
            self._cancelled = True
            for control in self._controls.values():
                control[CANCELLED] = 1

    @contextmanager
    def covering(self, control: IntArray) -> Iterator[None]:
        """Let a computation be given up, during this block."""
        with self._lock:
            self._controls[id(control)] = control
            control[CANCELLED] |= self._cancelled
        try:
            with nullcontext() if self._parent is None else self._parent.covering(control):
                yield
        finally:
            with self._lock:
                del self._controls[id(control)]


_current: ContextVar[Cancellation | None] = ContextVar("cancellation", default=None)
"""The innermost cancellation that the present code runs under."""


class ComputingThreads(ThreadPoolExecutor):
    """Threads that compute; when their block is left early, by Ctrl-C for instance, the computations are given up."""

    def __init__(self, count: int) -> None:
        super().__init__(count, "solver")
        self._cancellation = Cancellation()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Begin a call, under the cancellation of these threads."""
        return super().submit(self._cancellation.run, fn, *args, **kwargs)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is not None:
            self._cancellation.cancel()
            self.shutdown(wait=False, cancel_futures=True)
        super().__exit__(kind, error, traceback)


def compute(function: Callable[[IntArray], Result], panels: int = 0) -> Result:
    """Return what a function returns that calls compiled code, such that it can be given up.

    Parameters
    ----------
    function
        Makes the arrays it writes to, as it may be called twice, and hands the control to the compiled code.
    panels
        Number of panels, which make each step take longer.

    Raises
    ------
    CancelledError
        If it was given up.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    quick_steps = QUICK_STEPS // (1 + panels // PANELS_PER_STEP)
    control = np.array([0, quick_steps if in_main_thread else NO_LIMIT])
    cancellation = _current.get()
    with nullcontext() if cancellation is None else cancellation.covering(control):
        result = function(control)
        if in_main_thread and control[STEPS_LEFT] < 0 and control[CANCELLED] == 0:
            control[STEPS_LEFT] = NO_LIMIT
            result = _compute_elsewhere(function, control)
    if control[CANCELLED] != 0:
        raise CancelledError
    return result


def _compute_elsewhere(function: Callable[[IntArray], Result], control: IntArray) -> Result:
    """Call a function in another thread, and wait for it as Python does, ready for signals."""
    with ThreadPoolExecutor(1, "solver") as thread:
        try:
            return thread.submit(function, control).result()
        except BaseException:
            control[CANCELLED] = 1  # The thread ends within a step, and this one waits for it.
            raise
