"""Memory and open files of a service and its workers, as the kernel counts them."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from benchmarks.stress.faults_victim import Victim

OWN = ("Pss_Anon:", "Pss_Shmem:", "SwapPss:")
"""Of the kernel's figures. Mapped files are left out: how much of a library counts depends on who else uses it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Footprint:
    """What the processes of a service hold at one moment.

    Parameters
    ----------
    round
        After which it was looked at.
    server_bytes, all_bytes
        Memory of the server, and of it with its workers. [bytes]
    server_handles, all_handles
        Open files, likewise.
    processes
        How many there are.
    """

    round: int
    server_bytes: int
    all_bytes: int
    server_handles: int
    all_handles: int
    processes: int


def footprint(victim: Victim, number: int) -> Footprint:
    """Look at all processes of a service."""
    processes = victim.processes()
    memory = {process: _own_bytes(process) for process in processes}
    handles = {process: _handles(process) for process in processes}
    return Footprint(
        round=number,
        server_bytes=memory[victim.pid],
        all_bytes=sum(memory.values()),
        server_handles=handles[victim.pid],
        all_handles=sum(handles.values()),
        processes=len(processes),
    )


def largest_change(prints: Sequence[Footprint], name: Literal["server_bytes", "all_bytes"]) -> float:
    """Largest distance of later ones from the first, up or down, as a share of it."""
    first, *later = (getattr(each, name) for each in prints)
    return max((abs(each - first) / first for each in later), default=0.0)


def _own_bytes(process: int) -> int:
    """Memory but for mapped files; pages that forked processes share are divided among them."""
    with suppress(OSError):  # it has ended
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
        return sum(1024 * int(line.split()[1]) for line in lines if line.startswith(OWN))
    return 0


def _handles(process: int) -> int:
    with suppress(OSError):
        return len(list(Path(f"/proc/{process}/fd").iterdir()))
    return 0
