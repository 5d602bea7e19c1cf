"""What a fresh process needs: time to its first answer, time to compile, memory."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.timing import spread

HERE = Path(__file__).parent


def run_alone(script: str, *arguments: str, environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """What a script of this folder prints as JSON, run in a process of its own."""
    command = [sys.executable, str(HERE / script), *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, check=True)
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def measure_startup(repetitions: int, *, compiling: bool) -> dict[str, Any]:
    """Start processes with the compiled code on disk and, if asked, one that must compile it first."""
    starts = [_start() for _ in range(repetitions)]
    found: dict[str, Any] = {name: spread([start[name] for start in starts]) for name in starts[0]}
    if compiling:
        with tempfile.TemporaryDirectory() as folder:
            found["compiling_s"] = _start(os.environ | {"NUMBA_CACHE_DIR": folder})["process_s"]
    return found


def _start(environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    begin = time.perf_counter()
    answer = run_alone("first_answer.py", environment=environment)
    return answer | {"process_s": time.perf_counter() - begin}
