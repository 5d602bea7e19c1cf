"""How much may wait: refusals that say when to come back, from the rate at which work was done lately."""

import math
import time
from collections import deque
from typing import Any

from service.schemas.requests import Case
from solver import ParameterError

MEMORY_SECONDS = 30.0
"""How far back a rate looks: a few chunks of slow work, not the hour before."""
STEP_SECONDS = 0.5
"""What was done within this time is counted as one entry."""
LONGEST_WAIT_SECONDS = 3600
"""Nobody plans further ahead than the rate is worth."""


def check_work(case: Any, most: float) -> None:
    """Refuse a case whose runs could take far longer than any is given.

    Raises
    ------
    ParameterError
        If panels times steps are more than this.
    """
    work = case.panel_steps() if isinstance(case, Case) else 0.0
    if work > most:
        raise ParameterError(
            "numerics.panels",
            f"times the termination time over `time_step_s` must be at most {most:g}, got {work:g}: take fewer panels, "
            "longer steps or an earlier end",
        )


class Rate:
    """Cases done in a second, measured lately."""

    def __init__(self) -> None:
        self._entries: deque[tuple[float, int]] = deque()
        self._count = 0

    def add(self, count: int) -> None:
        """So many have been done just now."""
        now = time.monotonic()
        self._count += count
        if self._entries and now - self._entries[-1][0] < STEP_SECONDS:
            began, before = self._entries.pop()
            self._entries.append((began, before + count))
        else:
            self._entries.append((now, count))
        self._forget(now)

    @property
    def per_second(self) -> float:
        """Mean over the time looked back; 0 if nothing was done in it."""
        now = time.monotonic()
        self._forget(now)
        if not self._entries:
            return 0.0
        return self._count / max(now - self._entries[0][0], STEP_SECONDS)

    def seconds_for(self, count: int) -> int:
        """Whole seconds until so many more are done, at least 1."""
        rate = self.per_second
        return min(LONGEST_WAIT_SECONDS, max(1, math.ceil(count / rate))) if rate else 5

    def _forget(self, now: float) -> None:
        while self._entries and now - self._entries[0][0] > MEMORY_SECONDS:
            self._count -= self._entries.popleft()[1]
