"""Memory that a process keeps after it has compiled the solver."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


def resident_bytes() -> int:
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("Private_Dirty:"))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(not Path("/proc/self/smaps_rollup").exists(), reason="reads /proc")
def test_template_needs_no_more_memory_after_compiling_than_after_loading(tmp_path: Path) -> None:
    def memory() -> int:
        program = (
            "import tests.service.test_heap as h, service.workers.worker as w; w.warm_up(); print(h.resident_bytes())"
        )
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, check=True)
        return int(done.stdout)

    compiled, loaded = memory(), memory()
    assert compiled < loaded + 20e6
