"""The records used last, in memory."""

import threading
from collections import OrderedDict

from service.results.record import Record


class RecentRecords:
    """The records used last, up to a number of bytes."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._records: OrderedDict[str, tuple[Record, int]] = OrderedDict()
        self._nbytes = 0
        self._lock = threading.Lock()

    def get(self, key: str) -> Record | None:
        """Record of this key, which becomes the latest."""
        with self._lock:
            if key not in self._records:
                return None
            self._records.move_to_end(key)
            return self._records[key][0]

    def put(self, record: Record) -> None:
        """Keep the record, if it fits at all, and drop as many of those used longest ago as it takes."""
        nbytes = record.nbytes
        with self._lock:
            _, replaced = self._records.pop(record.key, (None, 0))
            self._nbytes -= replaced
            if nbytes > self._limit:
                return
            self._records[record.key] = (record, nbytes)
            self._nbytes += nbytes
            while self._nbytes > self._limit:
                _, (_, dropped) = self._records.popitem(last=False)
                self._nbytes -= dropped
