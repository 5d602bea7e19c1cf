"""What waits for the workers of the pool: singly submitted calls ahead of chunks, else in order of arrival."""

import queue
import time
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field

from service.pool.worker import Call, Finished, packed

PROBE, SINGLE, CHUNK, END = range(4)
"""Priorities of jobs. A probe and a single call overtake chunks, also one that runs, between two of its calls."""
OVERTAKE_SECONDS = 0.02
"""Between asking one lane and the next to leave its chunk: with many cores, one call must not halt them all."""


@dataclass(order=True, slots=True)
class Job:
    """Calls that one worker runs in turn; lower priorities first, then in order of arrival."""

    priority: int
    number: int
    calls: Sequence[Call] = field(default=(), compare=False)
    future: Future[list[Finished]] = field(default_factory=Future, compare=False)
    finished: list[Finished] = field(default_factory=list, compare=False)
    cancelled: float | None = field(default=None, compare=False)
    """When it was given up while it ran, on the monotonic clock."""
    crashes: int = field(default=0, compare=False)
    """Workers that the first unfinished call has ended."""
    _messages: list[bytes] = field(default_factory=list, compare=False)

    def begin(self) -> bool:
        """Tell whether it is still wanted; it has been begun before if another overtook it."""
        if not self._messages:
            if not self.future.set_running_or_notify_cancel():
                return False
            self._messages = [packed(call) for call in self.calls]
        return True

    @property
    def left(self) -> list[bytes]:
        """What a worker is to be given now: all that is not finished, but a call that has ended a worker goes alone."""
        first = len(self.finished)
        return self._messages[first : first + 1 if self.crashes else None]

    def finish(self, finished: Finished) -> None:
        """Note what became of the first unfinished call."""
        self.finished.append(finished)
        self.crashes = 0


class Backlog(queue.PriorityQueue[Job]):
    """Jobs that wait for a lane."""

    urgent = 0
    """Those of them that overtake chunks."""
    _asked = 0.0

    def _put(self, item: Job) -> None:
        super()._put(item)
        self.urgent += item.priority < CHUNK

    def _get(self) -> Job:
        job = super()._get()
        self.urgent -= job.priority < CHUNK
        return job

    def asks(self, job: Job) -> bool:
        """Tell whether whoever runs this job should leave it for another."""
        if job.priority < CHUNK or not self.urgent:
            return False
        now = time.monotonic()
        if now < self._asked + OVERTAKE_SECONDS:
            return False
        self._asked = now
        return True
