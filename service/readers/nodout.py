"""LS-DYNA's nodout as text: nodes, state by state.

A state begins with ``n o d a l   p r i n t   o u t   f o r   t i m e  s t e p ... ( at time ... )`` and a line of names
from ``nodal point  x-disp`` on, then a line for each node: its number and twelve numbers, the displacements first.
Models with rotations write the state again, from ``x-rot`` on.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from service.readers.axes import States
from service.readers.dyna_text import chosen, numbers_of
from service.readers.errors import FileError

MARK = "n o d a l   p r i n t   o u t"
STATE = re.compile(r"\s*n o d a l +p r i n t +o u t +f o r +t i m e +s t e p.*\( *at time *(?P<time>[^\s)]+) *\)\s*")
NAMES = re.compile(r"\s*nodal point\s+x-(?P<kind>disp|rot)\b.*")
NODE = re.compile(r"\s*(?P<node>\d+)(?P<numbers>\s*[+-]?\d*\..*)")


def read_nodout(path: str | Path, lines: Sequence[str], node: int | None) -> States:
    """Read the motion of one node.

    Raises
    ------
    FileError
        If the node is not there, or one of its states is not whole.
    """
    wanted = chosen(path, "node", _nodes(lines), node)
    found_times: dict[str, list[float]] = {"disp": [], "rot": []}
    found_motions: dict[str, list[list[float]]] = {"disp": [], "rot": []}
    found_places: dict[str, list[int]] = {"disp": [], "rot": []}
    time, place, kind = 0.0, 0, ""
    for line, text in enumerate(lines, 1):
        if state := STATE.fullmatch(text):
            time, place, kind = numbers_of(path, line, state["time"], 1, "time")[0], line, ""
        elif names := NAMES.fullmatch(text):
            kind = names["kind"]
            _require_whole(path, wanted, found_places[kind], found_motions[kind])
            found_places[kind].append(place)
            found_times[kind].append(time)
        elif kind and len(found_motions[kind]) < len(found_places[kind]):
            row = NODE.fullmatch(text)
            if row and int(row["node"]) == wanted:
                found_motions[kind].append(numbers_of(path, line, row["numbers"], 3, f"node {wanted}")[:3])
    for kind, places in found_places.items():
        _require_whole(path, wanted, places, found_motions[kind])
    rotated = found_times["rot"] == found_times["disp"]
    return States(
        path=path,
        time=np.array(found_times["disp"]),
        displacement=np.array(found_motions["disp"]).reshape(-1, 3),
        rotation=np.array(found_motions["rot"]).reshape(-1, 3) if rotated else None,
        lines=found_places["disp"],
    )


def _nodes(lines: Sequence[str]) -> list[int]:
    """Return the nodes of the first state."""
    there: list[int] = []
    begun = False
    for text in lines:
        if NAMES.fullmatch(text):
            begun = True
        elif begun and (row := NODE.fullmatch(text)):
            there.append(int(row["node"]))
        elif begun and STATE.fullmatch(text):
            break
    return there


def _require_whole(path: str | Path, wanted: int, places: Sequence[int], motions: Sequence[list[float]]) -> None:
    if len(motions) < len(places):
        raise FileError(path, f"the state has no line of node {wanted}: is the file cut short?", places[-1])
