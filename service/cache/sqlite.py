"""Layout number and decoding of text, shared by the SQLite files of a data folder."""

import sqlite3
from functools import partial

from service.errors import FolderLayoutError

LAYOUT = 3
"""Number of the layout of the SQLite files and of the segments, raised when one of them changes. A folder with another
layout is refused, and neither read nor changed."""


def check_layout(connection: sqlite3.Connection, name: str) -> int:
    """Return the layout number of a file, 0 for a new file. Must be called before anything is written to the file.

    Raises
    ------
    FolderLayoutError
        If the file has the layout of another version.
    sqlite3.Error
        If the file cannot be read.
    """
    layout: int = connection.execute("PRAGMA user_version").fetchone()[0]
    if layout == LAYOUT or (layout == 0 and not connection.execute("SELECT 1 FROM sqlite_master").fetchall()):
        return layout
    raise FolderLayoutError(name, layout, LAYOUT)


decode = partial(str, encoding="utf-8", errors="replace")
"""Function that decodes a string, with replacements for damaged bytes. The damage is then found when the value is
checked, and reported with its job or key; a strict decoder would fail the whole query."""
