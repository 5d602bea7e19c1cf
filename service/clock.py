"""The two clocks of the machine: dates follow the one that can be set, durations the one that cannot."""

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

WATCH_SECONDS = 60.0
"""Time between two comparisons of the clocks."""
DIVERGENCE_SECONDS = 30.0
"""Difference that is reported: time synchronisation corrects less without a jump."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Clock:
    """Where the time comes from.

    Parameters
    ----------
    now
        Returns the date, in seconds since 1970: for expiry of keys and retention of jobs. [s]
    monotonic
        Returns the time since some instant, whatever the date is set to: for quotas and timeouts. [s]
    """

    now: Callable[[], float] = time.time
    monotonic: Callable[[], float] = time.monotonic


SYSTEM = Clock()


class ClockWatch:
    """Warns when date and duration diverge: the clock of the machine has been set, or the machine has slept."""

    def __init__(self, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._offset = clock.now() - clock.monotonic()

    def compare(self) -> None:
        """Compare the clocks, and report a divergence since they were last compared."""
        offset = self._clock.now() - self._clock.monotonic()
        jump, self._offset = offset - self._offset, offset
        if abs(jump) > DIVERGENCE_SECONDS:
            log.warning(
                "the clock of the machine went %s by %.0f s, by setting it or in its sleep: keys expire and jobs are "
                "removed by the new date, quotas and time limits go on as before",
                "forward" if jump > 0.0 else "back",
                abs(jump),
            )

    async def run(self) -> None:
        """Compare the clocks for ever."""
        while True:
            await asyncio.sleep(WATCH_SECONDS)
            self.compare()
