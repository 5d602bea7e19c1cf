"""Number of cases in each chunk, from the time that earlier ones took."""

from collections.abc import Sequence

FIRST_CASES = 4
"""Cases of the first chunk, when their time is unknown: the slowest take a minute each."""
MOST_CASES = 256
"""Largest number of cases in a chunk: one of a millisecond each takes as long as the usual one."""
MOST_BYTES = 16 * 1024 * 1024
"""Size of the answers of one chunk: those with long histories take 4 MB each. [bytes]"""
SHRUNK = 8
"""Factor by which chunks shrink after one that took far too long."""
NEWEST = 0.3
"""Weight of the latest chunk in the mean, as the cases of a sweep become slower or faster on the way."""


class ChunkSizer:
    """Sizes chunks from the time and the bytes that their cases take.

    Parameters
    ----------
    seconds
        Duration that one chunk should have. [s]
    """

    def __init__(self, seconds: float) -> None:
        self._target = seconds
        self._seconds: float | None = None
        self._nbytes = 0.0
        self._most = MOST_CASES

    @property
    def cases(self) -> int:
        """Number of cases that the next chunk should hold."""
        if self._seconds is None:
            return FIRST_CASES
        by_time = self._target / max(self._seconds, 1e-6)
        by_bytes = MOST_BYTES / max(self._nbytes, 1.0)
        return max(1, int(min(by_time, by_bytes, self._most)))

    def shrink(self, cases: int) -> None:
        """Make the next chunks smaller, because one of so many cases took far too long."""
        self._most = max(1, min(self._most, cases // SHRUNK))

    def note(self, seconds: Sequence[float], nbytes: int) -> None:
        """Take the times of these cases into account; `nbytes` is the size of all their answers."""
        if not seconds:
            return
        mean, size = sum(seconds) / len(seconds), nbytes / len(seconds)
        if self._seconds is None:
            self._seconds, self._nbytes = mean, size
        self._seconds += NEWEST * (mean - self._seconds)
        self._nbytes += NEWEST * (size - self._nbytes)
