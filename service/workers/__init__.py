"""Executors, which run the computations of the service, and the queue from which they take work."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

Call: TypeAlias = tuple[Callable[..., Any], tuple[Any, ...]]
"""A picklable function and its arguments."""


@dataclass(frozen=True, slots=True)
class CallResult:
    """Outcome of a call.

    Parameters
    ----------
    value
        Return value; None if the call failed.
    error
        Exception raised by the call, or by the executor if it could not finish the call; None on success.
    seconds
        Time that the call took in the worker. [s]
    """

    value: Any
    error: Exception | None
    seconds: float
