"""LS-DYNA's text files, state by state: rigid bodies in rbdout, nodes in nodout.

A state of rbdout begins with ``r i g i d   b o d y   m o t i o n   a t  cycle= ... time= ...``. For each body there is
a line ``rigid body N`` or ``nodal rigid body N``, then coordinates, displacements, velocities and accelerations along
the global axes, the last three with rotations, then the same along the axes of the body.

A state of nodout begins with ``n o d a l   p r i n t   o u t   f o r   t i m e  s t e p ... ( at time ... )`` and a
line of column names from ``nodal point  x-disp`` on, then a line for each node: its number and twelve numbers, the
displacements first. Models with rotations write the state again, from ``x-rot`` on.
"""

import re
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from service.readers.files import FileError
from service.readers.units import States, select

NUMBER = re.compile(r"[+-]?\d+\.\d*(?:[EeDd][+-]?\d+|[+-]\d{3})?")
BARE_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d{3})$")
"""Fortran omits the E before an exponent of three digits."""

RBDOUT_MARK = "r i g i d   b o d y   m o t i o n"
RBDOUT_STATE = re.compile(r"\s*r i g i d +b o d y +m o t i o n +a t +cycle= *\S+ +time= *(?P<time>\S+)\s*")
BODY = re.compile(r"\s*(nodal )?rigid body\s+(?P<body>\d+)\b.*")
DISPLACEMENTS = re.compile(r"\s*displacements:(?P<numbers>.*)")

NODOUT_MARK = "n o d a l   p r i n t   o u t"
NODOUT_STATE = re.compile(
    r"\s*n o d a l +p r i n t +o u t +f o r +t i m e +s t e p.*\( *at time *(?P<time>[^\s)]+) *\)\s*"
)
COLUMN_NAMES = re.compile(r"\s*nodal point\s+x-(?P<kind>disp|rot)\b.*")
NODE = re.compile(r"\s*(?P<node>\d+)(?P<numbers>\s*[+-]?\d*\..*)")


def read_rbdout(path: str | Path, lines: Sequence[str], part: int | None) -> States:
    """Read the motion of one rigid body.

    Raises
    ------
    FileError
        If the body is missing, or one of its states is incomplete.
    """
    wanted = select(
        path, "rigid body", sorted({int(found["body"]) for found in map(BODY.fullmatch, lines) if found}), part
    )
    starts: list[int] = []
    times: list[float] = []
    motions: list[list[float]] = []
    inside = False
    missing = f"displacements of rigid body {wanted}"
    for line, text in enumerate(lines, 1):
        if found := RBDOUT_STATE.fullmatch(text):
            _require_complete(path, missing, starts, motions)
            times += _numbers(path, line, found["time"], 1, "time")[:1]
            starts.append(line)
        elif found := BODY.fullmatch(text):
            inside = int(found["body"]) == wanted
        elif inside and starts and (found := DISPLACEMENTS.fullmatch(text)):
            if len(motions) == len(starts):
                raise FileError(path, f"the state has rigid body {wanted} twice", line)
            motions.append(_numbers(path, line, found["numbers"], 6, "displacements and rotations"))
            inside = False  # the following numbers are along the axes of the body
    _require_complete(path, missing, starts, motions)
    motion = np.array([row[:6] for row in motions]).reshape(-1, 6)
    return States(path=path, time=np.array(times), displacement=motion[:, :3], rotation=motion[:, 3:], lines=starts)


def read_nodout(path: str | Path, lines: Sequence[str], node: int | None) -> States:
    """Read the motion of one node.

    Raises
    ------
    FileError
        If the node is missing, or one of its states is incomplete.
    """
    wanted = select(path, "node", _nodes(lines), node)
    times: dict[str, list[float]] = {"disp": [], "rot": []}
    motions: dict[str, list[list[float]]] = {"disp": [], "rot": []}
    starts: dict[str, list[int]] = {"disp": [], "rot": []}
    time, start, kind = 0.0, 0, ""
    missing = f"line of node {wanted}"
    for line, text in enumerate(lines, 1):
        if state := NODOUT_STATE.fullmatch(text):
            time, start, kind = _numbers(path, line, state["time"], 1, "time")[0], line, ""
        elif names := COLUMN_NAMES.fullmatch(text):
            kind = names["kind"]
            _require_complete(path, missing, starts[kind], motions[kind])
            starts[kind].append(start)
            times[kind].append(time)
        elif kind and len(motions[kind]) < len(starts[kind]):
            row = NODE.fullmatch(text)
            if row and int(row["node"]) == wanted:
                motions[kind].append(_numbers(path, line, row["numbers"], 3, f"node {wanted}")[:3])
    for kind, lines_of_states in starts.items():
        _require_complete(path, missing, lines_of_states, motions[kind])
    return States(
        path=path,
        time=np.array(times["disp"]),
        displacement=np.array(motions["disp"]).reshape(-1, 3),
        rotation=np.array(motions["rot"]).reshape(-1, 3) if times["rot"] == times["disp"] else None,
        lines=starts["disp"],
    )


def _nodes(lines: Sequence[str]) -> list[int]:
    """Return the nodes of the first state."""
    nodes: list[int] = []
    begun = False
    for text in lines:
        if COLUMN_NAMES.fullmatch(text):
            begun = True
        elif begun and (row := NODE.fullmatch(text)):
            nodes.append(int(row["node"]))
        elif begun and NODOUT_STATE.fullmatch(text):
            break
    return nodes


def _require_complete(path: str | Path, missing: str, starts: Sequence[int], motions: Sequence[list[float]]) -> None:
    if len(motions) < len(starts):
        raise FileError(path, f"the state has no {missing}: is the file cut short?", starts[-1])


def _numbers(path: str | PathLike[str], line: int, text: str, least: int, what: str) -> list[float]:
    """Return the numbers of a line; in fixed-width formats they may follow each other without a blank.

    Raises
    ------
    FileError
        If the line holds something else, or fewer numbers.
    """
    rest = NUMBER.sub(" ", text).strip()
    if rest:
        raise FileError(path, f"{what} must be numbers, got {rest[:40]!r}", line)
    found = [float(BARE_EXPONENT.sub(r"E\1", each.upper().replace("D", "E"))) for each in NUMBER.findall(text)]
    if len(found) < least:
        raise FileError(path, f"{what}: {least} numbers are needed, the line has {len(found)}", line)
    return found
