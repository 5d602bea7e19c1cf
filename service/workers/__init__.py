"""Executors: what the service computes with, and the one queue that stands before them."""

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
        What it returned; None if it did not.
    error
        What it raised, or why the executor could not finish it; None if it returned.
    seconds
        Time it took in the worker.
    """

    value: Any
    error: Exception | None
    seconds: float
