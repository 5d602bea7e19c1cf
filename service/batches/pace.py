"""How large the next chunk is to be, from what the cases before it took."""

from collections.abc import Sequence

FIRST_CASES = 4
"""Before anything is known of the cases: the slowest take a minute each."""
MOST_CASES = 256
MOST_BYTES = 16 * 1024 * 1024
"""Of answers in one chunk: those with long histories take 4 MB each."""
SHRUNK = 8
"""A job whose cases differ that much goes on with chunks of an eighth."""
NEWEST = 0.3
"""Weight of the latest chunk: cases of a sweep become slower or faster on the way."""


class Pace:
    """Seconds and bytes that a case takes.

    Parameters
    ----------
    seconds
        Of work that one chunk should be.
    """

    def __init__(self, seconds: float) -> None:
        self._target = seconds
        self._seconds: float | None = None
        self._nbytes = 0.0
        self._most = MOST_CASES

    @property
    def cases(self) -> int:
        """How many the next chunk should hold."""
        if self._seconds is None:
            return FIRST_CASES
        by_time = self._target / max(self._seconds, 1e-6)
        by_bytes = MOST_BYTES / max(self._nbytes, 1.0)
        return max(1, int(min(by_time, by_bytes, self._most)))

    def shrink(self, cases: int) -> None:
        """Take nothing for granted any more: a chunk of so many cases took far too long."""
        self._most = max(1, min(self._most, cases // SHRUNK))

    def note(self, seconds: Sequence[float], nbytes: int) -> None:
        """Take these cases into account; `nbytes` is of all their answers."""
        if not seconds:
            return
        mean, size = sum(seconds) / len(seconds), nbytes / len(seconds)
        if self._seconds is None:
            self._seconds, self._nbytes = mean, size
        self._seconds += NEWEST * (mean - self._seconds)
        self._nbytes += NEWEST * (size - self._nbytes)
