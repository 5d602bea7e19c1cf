"""The fork server of multiprocessing: it loads the compiled solver once, and every worker is a fork of it."""

import multiprocessing
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import forkserver
from multiprocessing.util import get_temp_dir
from pathlib import Path

PRELOAD = ("service.workers.preload", "service.workers.worker")
SOCKET_FOLDER_BYTES = 70
"""Longest path of a folder for sockets: the names below it take 32, and macOS allows 103 in all, Linux 107."""


def start_fork_server(preload: Sequence[str] = ()) -> None:
    """Start the fork server unless it runs, and return without waiting for what it loads.

    A command that will need workers calls this before its own imports, so that both load side by side. The server
    imports nothing from the working folder, and listens where its path is short enough.

    Parameters
    ----------
    preload
        Modules that it imports besides its own.
    """
    os.environ["PYTHONSAFEPATH"] = "1"  # else it runs a user's solver.py or secrets.py in place of the installed one
    usual, tempfile.tempdir = tempfile.tempdir, socket_folder()
    try:
        get_temp_dir()  # multiprocessing makes its folder at the first call and keeps it
    finally:
        tempfile.tempdir = usual
    multiprocessing.set_forkserver_preload([*PRELOAD, *preload])
    with existing_folder():
        forkserver.ensure_running()


def socket_folder() -> str:
    """Return the folder for temporary files, or /tmp if the path of a socket in it would be too long."""
    folder = tempfile.gettempdir()
    return folder if len(os.fsencode(folder)) <= SOCKET_FOLDER_BYTES else "/tmp"  # noqa: S108 (folders in it are private)


@contextmanager
def existing_folder() -> Iterator[None]:
    """Leave a working folder that has been deleted, and return to it: multiprocessing starts no process in one."""
    try:
        Path.cwd()
    except FileNotFoundError:
        deleted = os.open(".", os.O_RDONLY)
        try:
            os.chdir("/")
            yield
        finally:
            os.fchdir(deleted)
            os.close(deleted)
    else:
        yield
