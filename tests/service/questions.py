"""Requests for tests of the runner: what a worker does with them is plain to see.

Nothing is imported here that a worker does not have already, so that its first call takes no longer than the others.
"""

import json
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solver import ParameterError

PROBLEM = {"type": "urn:ricochet:problem:timeout", "title": "t", "status": 422, "detail": "d", "errors": []}


@dataclass(frozen=True)
class Question:
    """Asks for the square of a number; what else happens is up to `how`."""

    number: float
    folder: str = ""
    """Each run leaves a file here; none if it is empty."""
    how: str = "square"
    seconds: float = 0.0

    def canonical(self) -> dict[str, Any]:
        return {"number": self.number, "folder": self.folder, "how": self.how, "seconds": self.seconds}


def parse(text: bytes) -> Question:
    return Question(**json.loads(text))


def work(asked: Question) -> float:
    if asked.folder:
        name = f"{asked.number:g}-{time.monotonic_ns()}-{os.getpid()}"
        (Path(asked.folder) / name).touch()
    if asked.seconds:
        time.sleep(asked.seconds)
    if asked.how == "deadly":
        signal.raise_signal(signal.SIGKILL)
    if asked.how == "wrong":
        raise ParameterError("velocity", "must be positive")
    if asked.how == "broken":
        raise RuntimeError("secret")
    return asked.number**2


def runs(folder: Path) -> dict[float, int]:
    """How often each number was worked on."""
    counts: dict[float, int] = {}
    for path in folder.iterdir():
        number = float(path.name.split("-")[0])
        counts[number] = counts.get(number, 0) + 1
    return counts
