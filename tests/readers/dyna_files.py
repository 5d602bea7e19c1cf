"""Writers of LS-DYNA files for bodies whose motion is given along the global axes."""

import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

from solver.arrays import FloatArray

Bodies = Mapping[int, FloatArray]
"""Displacements and rotations of each body as an array (n, 6), by body id."""

TITLE = b" a title with an umlaut, \xfc\n                         ls-dyna (version R12)     date 01/01/2026\n"


def write_rbdout(path: Path, time: FloatArray, bodies: Bodies) -> None:
    text = []
    for state, instant in enumerate(time):
        text.append(f"1\n\n  r i g i d   b o d y   m o t i o n   a t  cycle={state:8d}    time={instant:15.6E}\n")
        for body, motion in bodies.items():
            row = "".join(f"{value:12.4E}" for value in motion[state])
            text.append(
                f"\n rigid body{body:8d}\n"
                "   global             x           y           z          x-rot       y-rot       z-rot\n"
                f"   coordinates:  {row[:36]}\n displacements:  {row}\n    velocities:  {row}\n accelerations:  {row}\n"
                "\nprincipal or user defined local coordinate direction vectors\n"
                "                     a           b           c\n"
                f"     row 1{1.0:15.4E}{0.0:15.4E}{0.0:15.4E}\n"
                f"     row 2{0.0:15.4E}{1.0:15.4E}{0.0:15.4E}\n"
                f"     row 3{0.0:15.4E}{0.0:15.4E}{1.0:15.4E}\n\n"
                " output in principal or user defined local coordinate directions\n"
                "                      a           b           c          a-rot       b-rot       c-rot\n"
                + f" displacements:  {9.0:12.4E}{9.0:12.4E}{9.0:12.4E}{9.0:12.4E}{9.0:12.4E}{9.0:12.4E}\n"
                * 3
            )
    path.write_bytes(TITLE + "".join(text).encode())


def write_nodout(path: Path, time: FloatArray, bodies: Bodies, *, rotations: bool = True) -> None:
    legend = "".join(f"{node:9d}     the nose\n" for node in bodies)
    text = [f"\n\n{{BEGIN LEGEND}}\n Entity #        Title\n{legend}{{END LEGEND}}\n"]
    for state, instant in enumerate(time):
        head = "\n\n\n n o d a l   p r i n t   o u t   f o r   t i m e  s t e p"
        head += f"{state:8d}{'':30}( at time{instant:14.7E} )\n"
        text.append(
            f"{head}\n nodal point  x-disp     y-disp      z-disp      x-vel       y-vel       z-vel      x-accl\n"
        )
        text += [_node(node, [*motion[state, :3], *[0.0] * 9]) for node, motion in bodies.items()]
        if rotations:
            text.append(f"{head}\n nodal point  x-rot      y-rot       z-rot       x-rot vel   y-rot vel   z-rot vel\n")
            text += [_node(node, [*motion[state, 3:], *[0.0] * 6]) for node, motion in bodies.items()]
    path.write_bytes(TITLE + "".join(text).encode())


def _node(node: int, numbers: Sequence[float]) -> str:
    return f"{node:9d} " + "".join(f"{number:12.4E}" for number in numbers) + "\n"


def write_binout(
    path: Path,
    time: FloatArray,
    bodies: Bodies,
    *,
    database: str = "rbdout",
    order: str = "<",
    first: int = 1,
    present: Callable[[int], Sequence[int]] | None = None,
    ids_in: Literal["states", "metadata", "first metadata"] = "first metadata",
) -> None:
    """Write a binout with one symbol table for the metadata and one for the states, as after a flush of LS-DYNA.

    Parameters
    ----------
    present
        Ids of the bodies in each state, in the order of the file; by default all.
    ids_in
        Where the file has these ids: with each state, in the metadata whenever they change, or once at the start.
    """
    present = present or (lambda state: list(bodies))
    prefix, names = ("global_", "dx dy dz rdx rdy rdz") if database == "rbdout" else ("", "x y z rx ry rz")
    suffix = "" if database == "rbdout" else "_displacement"
    file = _Lsda(order)
    file.write(f"/{database}/metadata", "ids", "i", present(0))
    file.write(f"/{database}/metadata", "title", "b", list(b"a title"))
    file.end_table()
    for state, instant in enumerate(time):
        folder = f"/{database}/d{state + first:06d}"
        if ids_in == "metadata" and state and present(state) != present(state - 1):
            file.write(f"/{database}/metadata", "ids", "i", present(state))
        if ids_in == "states":
            file.write(folder, "ids", "i", present(state))
        file.write(folder, "time", "d", [float(instant)])
        for place, name in enumerate(names.split()):
            numbers = [float(motion[state, place]) for motion in map(bodies.__getitem__, present(state))]
            file.write(folder, f"{prefix}{name}{suffix}", "f", numbers)
    file.end_table()
    path.write_bytes(file.content)


class _Lsda:
    """Writer of LSDA records, with lengths and offsets of eight bytes, and commands and types of one byte."""

    TYPES = {"b": 1, "i": 3, "f": 9, "d": 10}  # noqa: RUF012

    def __init__(self, order: str) -> None:
        self.order = order
        self.content = bytearray([8, 8, 8, 1, 1, order == "<", 0, 0])
        self.link = len(self.content) + 9  # position of the offset of the next table
        self.folder = ""
        self.entries: list[tuple[str, str, int, int, int]] = []
        self.record(7, bytes(8))

    def record(self, command: int, content: bytes) -> int:
        place = len(self.content)
        self.content += struct.pack(f"{self.order}qb", 9 + len(content), command) + content
        return place

    def write(self, folder: str, name: str, code: str, numbers: Sequence[float]) -> None:
        kind = self.TYPES[code]
        if folder != self.folder:
            up = (
                f"../{folder.rpartition('/')[2]}"
                if folder.rpartition("/")[0] == self.folder.rpartition("/")[0]
                else folder
            )
            self.record(2, up.encode())
            self.folder = folder
        head = struct.pack("bb", kind, len(name)) + name.encode()
        place = self.record(3, head + struct.pack(f"{self.order}{len(numbers)}{code}", *numbers))
        self.entries.append((folder, name, kind, place, len(numbers)))

    def end_table(self) -> None:
        start, folder = len(self.content), ""
        self.record(5, b"")
        for where, name, kind, place, count in self.entries:
            if where != folder:
                same = where.rpartition("/")[0] == folder.rpartition("/")[0]
                self.record(2, (f"../{where.rpartition('/')[2]}" if same else where).encode())
                folder = where
            self.record(4, name.encode() + struct.pack(f"{self.order}bqq", kind, place, count))
        end = self.record(6, bytes(8))
        self.content[start : start + 8] = struct.pack(f"{self.order}q", len(self.content) - start)
        self.content[self.link : self.link + 8] = struct.pack(f"{self.order}q", start)
        self.link, self.entries = end + 9, []
