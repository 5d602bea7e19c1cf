"""An operation for tests of jobs: squaring a number, with selectable behaviour and a trace of each run.

This module imports only modules that a worker has already imported, so that its first call is not slower.
"""

import json
import os
import signal
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from service.operations import Operation
from service.schemas.quantities import Part
from solver import ParameterError

PROBLEM = {"type": "urn:ricochet:problem:timeout", "title": "t", "status": 422, "detail": "d", "errors": []}


@dataclass(frozen=True)
class Question:
    """A number to be squared; `how` selects what else happens."""

    number: float
    folder: str = ""
    """Folder in which each run leaves a file; no file if empty."""
    how: str = "square"
    seconds: float = 0.0

    def canonical(self) -> dict[str, Any]:
        return asdict(self)


def square(request: bytes) -> tuple[dict[str, Any], None]:
    """Answer a question in a worker."""
    question = Question(**json.loads(request))
    if question.folder:
        name = f"{question.number:g}-{time.monotonic_ns()}-{os.getpid()}"
        (Path(question.folder) / name).touch()
    if question.seconds:
        time.sleep(question.seconds)
    if question.how == "deadly":
        signal.raise_signal(signal.SIGKILL)
    if question.how == "wrong":
        raise ParameterError("velocity", "must be positive")
    if question.how == "refused":
        raise ParameterError("search.lower", "must be below the upper end")
    if question.how == "broken":
        raise RuntimeError("secret")
    return {"number": question.number, "square": question.number**2, "warnings": []}, None


SQUARE = Operation("square", compute=square, request=Part)


def runs(folder: Path) -> dict[float, int]:
    """Number of runs for each number."""
    counts: dict[float, int] = {}
    for path in folder.iterdir():
        number = float(path.name.split("-")[0])
        counts[number] = counts.get(number, 0) + 1
    return counts


def workers(folder: Path) -> list[int]:
    """Process ids of the runs."""
    return [int(path.name.split("-")[-1]) for path in folder.iterdir()]
