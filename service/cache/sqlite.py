"""Settings and layout shared by the SQLite files of a data folder."""

import sqlite3

from service.errors import FolderLayoutError

LAYOUT = 3
"""Number of the tables in these files and of the segments beside them, raised when one of them changes. A folder of
another layout is refused: it is neither read nor changed."""


def check_layout(connection: sqlite3.Connection, name: str) -> int:
    """Return the layout of a file, before anything is written to it; 0 if it is new.

    Raises
    ------
    FolderLayoutError
        If it is another than that of this version.
    sqlite3.Error
        If it cannot be read.
    """
    layout: int = connection.execute("PRAGMA user_version").fetchone()[0]
    if layout == LAYOUT or (layout == 0 and not connection.execute("SELECT 1 FROM sqlite_master").fetchall()):
        return layout
    raise FolderLayoutError(name, layout, LAYOUT)


def decode(text: bytes) -> str:
    """Decode a text; of a damaged one what can be read, so that it is found out where it is used."""
    return text.decode(errors="replace")
