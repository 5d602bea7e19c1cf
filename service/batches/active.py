"""A job that is being worked on, as the service has it in memory."""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from service.batches.pace import Pace
from service.jobs.slices import SLICE
from service.jobs.store import JobState

CHUNK_SECONDS = 0.25
"""Of work in a chunk: what a crash costs at most, and a hundred times what handing it over does."""


class Waiting(NamedTuple):
    """A case without a result."""

    number: int
    key: str


@dataclass(eq=False)
class ActiveJob:
    """How far a job is."""

    state: JobState
    pace: Pace = field(default_factory=lambda: Pace(CHUNK_SECONDS))
    waiting: deque[Waiting] = field(default_factory=deque)
    """Looked up and not in the cache: to be computed next."""
    looked_up: int = 0
    """Slices."""
    work: set["asyncio.Task[None]"] = field(default_factory=set)
    """Looking up, and chunks."""
    stops: set[Callable[[], object]] = field(default_factory=set)
    """End what the work waits for."""
    ending: bool = False
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    """Set at the next change, and another one put in its place."""

    @property
    def left(self) -> bool:
        """Whether there are cases to hand out."""
        return not self.ending and (bool(self.waiting) or self.looked_up * SLICE < self.state.total)

    def take(self) -> list[Waiting]:
        """Take out the cases of the next chunk."""
        return [self.waiting.popleft() for _ in range(min(self.pace.cases, len(self.waiting)))]

    def update(self, state: JobState) -> None:
        """Take over a newer state, and wake those who follow it."""
        if state.revision > self.state.revision:
            self.state = state
        changed, self.changed = self.changed, asyncio.Event()
        changed.set()
