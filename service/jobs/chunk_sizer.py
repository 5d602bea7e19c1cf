"""Number of cases in a chunk, adapted to the time that earlier cases took."""

from collections.abc import Sequence

FIRST_CASES = 4
"""Number of cases in the first chunk, whose time is unknown: the slowest cases take a minute each."""
MOST_CASES = 256
"""Largest number of cases in a chunk. With cases of 1 ms such a chunk takes 0.25 s, the usual duration."""
MOST_BYTES = 16 * 1024 * 1024
"""Largest size of the answers of one chunk, the same as of a segment [bytes]. Some answers take 4 MB each."""
SHRUNK = 8
"""Factor by which chunks shrink after one that exceeded its timeout. Chosen by judgement: two steps lead from the usual
20 cases or so to single ones."""
NEWEST = 0.3
"""Weight of the latest chunk in the moving averages, which follow a sweep as its cases become slower or faster. Chosen
by judgement: a single odd chunk should not decide, and chunks should be forgotten after some ten others."""


class ChunkSizer:
    """Chooses the size of chunks from the time and the bytes of earlier cases.

    Parameters
    ----------
    seconds
        Desired duration of a chunk. [s]
    """

    def __init__(self, seconds: float) -> None:
        self._target = seconds
        self._seconds: float | None = None
        self._nbytes = 0.0
        self._most = MOST_CASES

    @property
    def cases(self) -> int:
        """Number of cases for the next chunk."""
        if self._seconds is None:
            return FIRST_CASES
        by_time = self._target / max(self._seconds, 1e-6)
        by_bytes = MOST_BYTES / max(self._nbytes, 1.0)
        return max(1, int(min(by_time, by_bytes, self._most)))

    def shrink(self, cases: int) -> None:
        """Make the next chunks smaller, because a chunk of `cases` cases exceeded its timeout."""
        self._most = max(1, min(self._most, cases // SHRUNK))

    def note(self, seconds: Sequence[float], nbytes: int) -> None:
        """Update the averages with the times of cases [s] and the size of all their answers [bytes]."""
        if not seconds:
            return
        mean, size = sum(seconds) / len(seconds), nbytes / len(seconds)
        if self._seconds is None:
            self._seconds, self._nbytes = mean, size
        self._seconds += NEWEST * (mean - self._seconds)
        self._nbytes += NEWEST * (size - self._nbytes)
