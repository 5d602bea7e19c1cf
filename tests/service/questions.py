"""An operation for tests of jobs, which squares a number, behaves in a selectable way and leaves a trace of each run.

It imports only modules that a worker has already imported, so that the first call is not slower.
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
    """A request to square a number; `how` selects another behaviour, such as a failure."""

    number: float
    folder: str = ""
    """Folder in which each run creates a file; none if empty."""
    how: str = "square"
    seconds: float = 0.0

    def canonical(self) -> dict[str, Any]:
        return asdict(self)


def square(request: bytes) -> tuple[dict[str, Any], None]:
    """Compute the answer to a question; called in a worker."""
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
    """Count how often each number was squared, from the files that the runs left in a folder."""
    counts: dict[float, int] = {}
    for path in folder.iterdir():
        number = float(path.name.split("-")[0])
        counts[number] = counts.get(number, 0) + 1
    return counts


def workers(folder: Path) -> list[int]:
    """Return the process id of each run, from the names of the files in a folder."""
    return [int(path.name.split("-")[-1]) for path in folder.iterdir()]
