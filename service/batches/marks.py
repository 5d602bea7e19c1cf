"""What became of the cases of a chunk."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from service.batches.active import Waiting
from service.engine import Answered
from service.errors import ComputationCancelled, PoolUnavailableError, QueueFullError, case_problem
from service.jobs.slices import CaseState

PASSING = (ComputationCancelled, PoolUnavailableError, QueueFullError)
"""Errors that are none of the case's own: it is tried again."""


@dataclass(slots=True)
class Marks:
    """What became of cases, by number; `again` are those to be tried once more."""

    states: dict[int, CaseState] = field(default_factory=dict)
    problems: dict[int, dict[str, Any]] = field(default_factory=dict)
    again: list[Waiting] = field(default_factory=list)
    unavailable: bool = False
    """No worker could take them."""

    def fail(self, numbers: Sequence[int], error: Exception) -> None:
        """Note that these cases, all alike, have no answer."""
        self.states |= dict.fromkeys(numbers, CaseState.FAILED)
        self.problems |= dict.fromkeys(numbers, case_problem(error))

    def take(
        self, numbers: Mapping[str, Sequence[int]], answers: Mapping[str, "asyncio.Future[Answered]"], state: CaseState
    ) -> None:
        """Note these answers: the first case of each key is in this state, its twins need no work of their own."""
        for key, future in answers.items():
            error = future.exception() if future.done() and not future.cancelled() else ComputationCancelled()
            if error is None:
                self.states |= dict.fromkeys(numbers[key], CaseState.CACHED) | {numbers[key][0]: state}
            elif isinstance(error, PASSING) or not isinstance(error, Exception):
                self.again.extend(Waiting(number, key) for number in numbers[key])
                self.unavailable |= not isinstance(error, ComputationCancelled)
            else:
                self.fail(numbers[key], error)
