"""LS-DYNA's rbdout as text: rigid bodies, state by state.

A state begins with ``r i g i d   b o d y   m o t i o n   a t  cycle= ... time= ...``. For each body there is a line
``rigid body N`` or ``nodal rigid body N``, then coordinates, displacements, velocities and accelerations along the
global axes, the last three with rotations, then the same along the axes of the body.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from service.readers.axes import States
from service.readers.dyna_text import chosen, numbers_of
from service.readers.errors import FileError

MARK = "r i g i d   b o d y   m o t i o n"
STATE = re.compile(r"\s*r i g i d +b o d y +m o t i o n +a t +cycle= *\S+ +time= *(?P<time>\S+)\s*")
BODY = re.compile(r"\s*(nodal )?rigid body\s+(?P<body>\d+)\b.*")
DISPLACEMENTS = re.compile(r"\s*displacements:(?P<numbers>.*)")


def read_rbdout(path: str | Path, lines: Sequence[str], part: int | None) -> States:
    """Read the motion of one rigid body.

    Raises
    ------
    FileError
        If the body is not there, or one of its states is not whole.
    """
    bodies = sorted({int(found["body"]) for found in map(BODY.fullmatch, lines) if found})
    wanted = chosen(path, "rigid body", bodies, part)
    places: list[int] = []
    times: list[float] = []
    motions: list[list[float]] = []
    inside = False
    for line, text in enumerate(lines, 1):
        if found := STATE.fullmatch(text):
            _require_whole(path, wanted, places, motions)
            times += numbers_of(path, line, found["time"], 1, "time")[:1]
            places.append(line)
        elif found := BODY.fullmatch(text):
            inside = int(found["body"]) == wanted
        elif inside and places and (found := DISPLACEMENTS.fullmatch(text)):
            if len(motions) == len(places):
                raise FileError(path, f"the state has rigid body {wanted} twice", line)
            motions.append(numbers_of(path, line, found["numbers"], 6, "displacements and rotations"))
            inside = False  # what follows is along the axes of the body
    _require_whole(path, wanted, places, motions)
    motion = np.array([row[:6] for row in motions]).reshape(-1, 6)
    return States(path=path, time=np.array(times), displacement=motion[:, :3], rotation=motion[:, 3:], lines=places)


def _require_whole(path: str | Path, wanted: int, places: Sequence[int], motions: Sequence[list[float]]) -> None:
    if len(motions) < len(places):
        raise FileError(
            path, f"the state has no displacements of rigid body {wanted}: is the file cut short?", places[-1]
        )
