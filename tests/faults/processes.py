"""Processes of a service, found in /proc by the data folder in their environment."""

import os
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

BUSY_SECONDS = 0.3
"""Interval in which a process that computes gets a time slice even on a busy machine. [s]"""


def processes_of(data: Path) -> list[int]:
    """Every running process of the service with this data folder, whatever its parent."""
    variable = f"RICOCHET_DATA_DIR={data}".encode()
    running = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]
    return [process for process in running if variable in _environment(process)]


def workers_of(data: Path, server: int) -> list[int]:
    """Worker processes: children of a template process, which is a child of the server and may have died."""
    return [process for process in processes_of(data) if process != server and _parent(process) != server]


def children_of(data: Path, server: int) -> list[int]:
    """Children of the server: the template process."""
    return [process for process in processes_of(data) if _parent(process) == server]


def kill(process: int) -> bool:
    """Send SIGKILL; return whether the process was still there."""
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)
        return True
    return False


def busy(processes: Sequence[int]) -> bool:
    """Return whether any of these processes uses the processor."""
    before = {process: processor_seconds(process) for process in processes}
    time.sleep(BUSY_SECONDS)
    return any(processor_seconds(process) > seconds for process, seconds in before.items())


def processor_seconds(process: int) -> float:
    """Processor time used so far; 0 after the process has ended. [s]"""
    status = _status(process)
    return (int(status[11]) + int(status[12])) / os.sysconf("SC_CLK_TCK") if status else 0.0


def _environment(process: int) -> list[bytes]:
    with suppress(OSError):  # it has ended, or belongs to another user
        return Path(f"/proc/{process}/environ").read_bytes().split(b"\0")
    return []


def _parent(process: int) -> int:
    status = _status(process)
    return int(status[1]) if status else 0


def _status(process: int) -> list[str]:
    """Fields of /proc/PID/stat after the command name; none if the process has ended."""
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return []
