"""Requests for tests of the jobs: what a worker does with them is plain to see.

Nothing is imported here that a worker does not have already, so that its first call takes no longer than the others.
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
    """A number to be squared; what else happens is up to `how`."""

    number: float
    folder: str = ""
    """Each run leaves a file here; none if it is empty."""
    how: str = "square"
    seconds: float = 0.0

    def canonical(self) -> dict[str, Any]:
        return asdict(self)


def square(request: bytes) -> tuple[dict[str, Any], None]:
    """Answer a question, in a worker."""
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
    """How often each number was worked on."""
    counts: dict[float, int] = {}
    for path in folder.iterdir():
        number = float(path.name.split("-")[0])
        counts[number] = counts.get(number, 0) + 1
    return counts


def workers(folder: Path) -> list[int]:
    """Which process did each piece of work."""
    return [int(path.name.split("-")[-1]) for path in folder.iterdir()]
