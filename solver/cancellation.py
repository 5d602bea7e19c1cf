"""Cancellation of computations, by a signal handler in the main thread or by another thread.

Python runs signal handlers between two bytecode instructions, never during a compiled call. So every integration and
every compiled search is called through `compute`, and checks a control, an array of two numbers, before each step.
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
"""Indices in a control: a flag that ends the computation unless it is zero, and the number of steps left."""
# No computation takes that many steps, and counting down from it cannot overflow.
NO_LIMIT = 2**62
"""Number of steps that means no limit."""
# A step takes 10 to 20 µs and a usual search 1,000 steps, so nearly all computations end in the main thread within 0.4
# s. A few in a thousand reach the limit and start again in another thread. Creating that thread takes 0.3 ms, and the
# main thread is then free to handle signals.
QUICK_STEPS = 20_000
"""Largest number of steps that a computation takes in the main thread."""
# Evaluating the loads on this number of panels takes about as long as one step of the Gauss-point method.
PANELS_PER_STEP = 100
"""Number of panels whose evaluation counts as one step."""

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class CancelledError(Exception):
    """Raised in a computation that `Cancellation.cancel` has ended.

    It is not a `RicochetError`, since the inputs do not cause it.
    """


@lean
def may_step(control: IntArray) -> bool:
    """Count a step and return whether it may be taken."""
    # Another thread may set the flag at any time. Writing one machine word needs no lock.
    control[STEPS_LEFT] -= 1
    return bool(control[CANCELLED] == 0 and control[STEPS_LEFT] >= 0)


class Cancellation:
    """Handle with which one thread cancels the computations of another, whether running or not yet started.

    Examples
    --------
    In the thread that computes::

        answer = cancellation.run(critical_angle, projectile=projectile, target=target, velocity=238.0)

    In another thread, to make the first one raise `CancelledError` within a step::

        cancellation.cancel()
    """

    def __init__(self) -> None:
        self._parent = _current.get()
        self._lock = threading.RLock()  # reentrant: a signal handler that cancels may interrupt this class
        self._cancelled = False
        self._controls: dict[int, IntArray] = {}

    def run(self, function: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        """Call a function, and return its result unless `cancel` ends its computations in this thread.

        Raises
        ------
        CancelledError
            If the computations were cancelled.
        """
        token = _current.set(self)
        try:
            return function(*args, **kwargs)
        finally:
            _current.reset(token)

    def cancel(self) -> None:
        """Cancel the running and the future computations of this object; can be called from any thread."""
        with self._lock:
            self._cancelled = True
            for control in self._controls.values():
                control[CANCELLED] = 1

    @contextmanager
    def covering(self, control: IntArray) -> Iterator[None]:
        """Register the control of a computation for the duration of a block, so that `cancel` ends it."""
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
"""Innermost cancellation of the calling context."""


class ComputingThreads(ThreadPoolExecutor):
    """Thread pool that cancels its computations if an exception, such as Ctrl-C, ends its ``with`` block."""

    def __init__(self, count: int) -> None:
        super().__init__(count, "solver")
        self._cancellation = Cancellation()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call that runs under the cancellation of this pool."""
        return super().submit(self._cancellation.run, fn, *args, **kwargs)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is not None:
            self._cancellation.cancel()
            self.shutdown(wait=False, cancel_futures=True)
        super().__exit__(kind, error, traceback)


def compute(function: Callable[[IntArray], Result], panels: int = 0) -> Result:
    """Call a function that runs compiled code, with a control by which it can be cancelled; return its result.

    Parameters
    ----------
    function
        Function that passes the control to the compiled code. It may be called twice, so it must allocate the arrays
        that it writes to.
    panels
        Number of panels. With more panels a step takes longer, so fewer steps are allowed in the main thread.

    Raises
    ------
    CancelledError
        If the computation was cancelled.
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
    """Call a function in another thread and wait for it in Python, where signal handlers can run."""
    with ThreadPoolExecutor(1, "solver") as thread:
        try:
            return thread.submit(function, control).result()
        except BaseException:
            control[CANCELLED] = 1  # the thread ends within a step, and leaving the block waits for it
            raise
