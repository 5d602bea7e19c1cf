"""Places that requests hold while they last, of everybody and of each owner: event streams, and single queries."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import OwnerQueriesError, OwnerStreamsError, StreamsFullError

QUERY_SECONDS = 1
"""Until one of a hundred queries has been answered. [s]"""


class Streams:
    """Event streams that are open.

    Parameters
    ----------
    most
        At once.
    most_of_owner
        Of them, of one owner.
    """

    def __init__(self, most: int, most_of_owner: int) -> None:
        self._most = most
        self._most_of_owner = most_of_owner
        self._held: Counter[str] = Counter()

    @contextmanager
    def held(self, owner: str) -> Iterator[None]:
        """Hold one as long as it is open.

        Raises
        ------
        OwnerStreamsError, StreamsFullError
            If there is no room for it.
        """
        if self._held[owner] >= self._most_of_owner:
            raise OwnerStreamsError(f"{self._most_of_owner} event streams are open; end one, or ask for the job itself")
        if self._held.total() >= self._most:
            raise StreamsFullError(f"{self._most} event streams are open; ask for the job itself")
        with counted(self._held, owner):
            yield


class Queries:
    """Single queries that wait or run.

    Parameters
    ----------
    most_of_owner
        Of one owner.
    """

    def __init__(self, most_of_owner: int) -> None:
        self._most_of_owner = most_of_owner
        self._held: Counter[str] = Counter()

    @contextmanager
    def held(self, owner: str) -> Iterator[None]:
        """Hold one as long as it takes.

        Raises
        ------
        OwnerQueriesError
            If the owner has as many already.
        """
        if self._held[owner] >= self._most_of_owner:
            raise OwnerQueriesError(QUERY_SECONDS)
        with counted(self._held, owner):
            yield


@contextmanager
def counted(held: Counter[str], owner: str) -> Iterator[None]:
    """Count one more meanwhile."""
    held[owner] += 1
    try:
        yield
    finally:
        held[owner] -= 1
        if not held[owner]:
            del held[owner]
