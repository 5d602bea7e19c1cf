"""Free memory goes back to the system."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path

import pytest

from service.api.app import give_back_memory

BLOCK, BLOCKS, PINNED = 4096, 40_000, 50
"""Bytes; blocks; one in so many stays. Pages between them are free, but not at the end of the heap."""


def resident_bytes() -> int:
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("Private_Dirty:"))


@pytest.mark.skipif(
    not Path("/proc/self/smaps_rollup").exists() or not hasattr(ctypes.CDLL(None), "malloc_trim"),
    reason="looks at the memory of Linux with glibc",
)
def test_memory_between_what_stays_is_given_back() -> None:
    blocks = [bytes([1]) * BLOCK for _ in range(BLOCKS)]
    pinned = blocks[::PINNED]
    blocks.clear()
    before = resident_bytes()
    give_back_memory()
    assert before - resident_bytes() > 0.5 * BLOCK * BLOCKS
    assert all(block[0] == 1 for block in pinned)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(not Path("/proc/self/smaps_rollup").exists(), reason="reads /proc")
def test_fork_server_that_has_compiled_takes_no_more_memory_than_one_that_has_loaded(tmp_path: Path) -> None:
    def memory() -> int:
        program = "import service.workers.preload, tests.service.test_heap as h; print(h.resident_bytes())"
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, check=True)
        return int(done.stdout)

    compiled, loaded = memory(), memory()
    assert compiled < loaded + 20e6
