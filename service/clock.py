"""The wall clock, for dates, and the monotonic clock, which cannot be set, for durations."""

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

WATCH_SECONDS = 60.0
"""Interval between comparisons of the clocks, an arbitrary choice: a jump is logged within a minute. [s]"""
DIVERGENCE_SECONDS = 30.0
"""Smallest change in the difference between the clocks that is logged. [s] Time synchronisation that slews the clock
stays below it: chrony slews by at most 8.3 % by default, which is 5 s between two comparisons."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Clock:
    """Source of dates and durations; tests pass their own.

    Parameters
    ----------
    now
        Function that returns the time since 1970, for the expiry of keys and the retention of jobs. [s]
    monotonic
        Function that returns the time since an arbitrary instant, unaffected by setting the clock, for quotas and
        timeouts. [s]
    """

    now: Callable[[], float] = time.time
    monotonic: Callable[[], float] = time.monotonic


SYSTEM = Clock()


class ClockWatch:
    """Logs a warning when the system clock has been set or the machine has slept."""

    def __init__(self, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._offset = clock.now() - clock.monotonic()

    def compare(self) -> None:
        """Compare the clocks, and log a jump of the wall clock since the previous comparison."""
        offset = self._clock.now() - self._clock.monotonic()
        jump, self._offset = offset - self._offset, offset
        if abs(jump) > DIVERGENCE_SECONDS:
            log.warning(
                "the system clock jumped %s by %.0f s: it was set, or the machine slept; keys expire and jobs are "
                "removed according to the new time, quotas and time limits are not affected",
                "forward" if jump > 0.0 else "back",
                abs(jump),
            )

    async def run(self) -> None:
        """Compare the clocks every `WATCH_SECONDS` until the task is cancelled."""
        while True:
            await asyncio.sleep(WATCH_SECONDS)
            self.compare()
