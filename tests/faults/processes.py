"""Find the processes of a service, by the data folder in their environment, and read their processor time."""

import os
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

BUSY_SECONDS = 0.3
"""Time in which a computing process gets a time slice even on a busy machine. [s]"""


def processes_of(data: Path) -> list[int]:
    """Return the ids of all processes of the service with this data folder, whatever their parents."""
    variable = f"RICOCHET_DATA_DIR={data}".encode()
    running = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]
    return [process for process in running if variable in _environment(process)]


def workers_of(data: Path, server: int) -> list[int]:
    """Return the ids of the workers: children of a template process, which is a child of the server."""
    return [process for process in processes_of(data) if process != server and _parent(process) != server]


def children_of(data: Path, server: int) -> list[int]:
    """Return the ids of the children of the server, i.e. of its template process."""
    return [process for process in processes_of(data) if _parent(process) == server]


def kill(process: int) -> bool:
    """Send SIGKILL; return whether the process was still there."""
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)
        return True
    return False


def busy(processes: Sequence[int]) -> bool:
    """Return whether any of these processes uses the processor within `BUSY_SECONDS`."""
    before = {process: processor_seconds(process) for process in processes}
    time.sleep(BUSY_SECONDS)
    return any(processor_seconds(process) > seconds for process, seconds in before.items())


def processor_seconds(process: int) -> float:
    """Return the processor time used so far; 0 if the process has ended. [s]"""
    status = _status(process)
    return (int(status[11]) + int(status[12])) / os.sysconf("SC_CLK_TCK") if status else 0.0


def _environment(process: int) -> list[bytes]:
    with suppress(OSError):  # The process has ended, or belongs to another user.
        return Path(f"/proc/{process}/environ").read_bytes().split(b"\0")
    return []


def _parent(process: int) -> int:
    status = _status(process)
    return int(status[1]) if status else 0


def _status(process: int) -> list[str]:
    """Return the fields of /proc/PID/stat after the command name; none if the process has ended."""
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return []
