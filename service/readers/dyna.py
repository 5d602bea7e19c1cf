"""Readers of LS-DYNA's files: the motion of a rigid body or a node, state by state.

The text file rbdout contains rigid bodies, nodout nodes; the binary binout contains both, with a folder for each state.

A state of rbdout begins with ``r i g i d   b o d y   m o t i o n   a t  cycle= ... time= ...``. For each body there is
a line ``rigid body N`` or ``nodal rigid body N``, then coordinates, displacements, velocities and accelerations along
the global axes, the last three with rotations, then the same along the axes of the body.

A state of nodout begins with ``n o d a l   p r i n t   o u t   f o r   t i m e  s t e p ... ( at time ... )`` and a
line of column names from ``nodal point  x-disp`` on, then a line for each node: its number and twelve numbers, the
displacements first. If the model has rotations, the state is written a second time, from ``x-rot`` on.

A binout is in the LSDA format: variables in folders, listed in tables of symbols. It begins with eight bytes: the
length of this header, the widths of a length, an offset, a command and a type, and the byte order, 1 for little-endian.
Records follow, each a length, a command and content. The first record gives the offset of the first table of symbols;
each table ends with the offset of the next, 0 in the last. A table changes folders and lists variables by type, offset
and length; the offset is that of the record with the numbers.
"""

import itertools
import posixpath
import re
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from service.readers.files import FileError, Readings, read_bytes
from solver.arrays import FloatArray

AXIS = re.compile(r"(?P<sign>[+-]?)(?P<letter>[xyz])")
TRANSLATIONS = ("depth_displacement", "lateral_displacement")


@dataclass(frozen=True, slots=True)
class CoordinateAxis:
    """A global axis of the model, with a direction.

    Parameters
    ----------
    index
        0, 1, 2 for x, y, z.
    sign
        1 along the axis, -1 against it.
    """

    index: int
    sign: float

    @classmethod
    def named(cls, name: str) -> "CoordinateAxis":
        """Return the axis with a name such as ``-z``.

        Raises
        ------
        ValueError
            If the name is not an axis.
        """
        match = AXIS.fullmatch(name.strip().lower())
        if match is None:
            raise ValueError(f"must be x, y or z, with a minus sign for the other direction, got {name!r}")
        return cls("xyz".index(match["letter"]), -1.0 if match["sign"] == "-" else 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class States:
    """Motion of a body along the global axes, state by state, in the units of the model.

    Parameters
    ----------
    time
        (n,) Times.
    displacement
        (n, 3) Displacements.
    rotation
        (n, 3) Rotations; None if the file has none. [rad]
    lines, rotation_lines
        Line of the displacements and of the rotations of each state, both None for binary files. `rotation_lines` is
        also None if the rotations are on the same lines.

    Notes
    -----
    Text in place of a number, such as asterisks, is read as NaN.
    """

    path: str | PathLike[str]
    time: FloatArray
    displacement: FloatArray
    rotation: FloatArray | None = None
    lines: Sequence[int] | None = None
    rotation_lines: Sequence[int] | None = None


def along(states: States, axes: Mapping[str, CoordinateAxis]) -> Readings:
    """Return the motion along the given axes, in the units of the model.

    Raises
    ------
    FileError
        If no axis is given, depth and lateral displacement have the same axis, rotation has an axis but the file has no
        rotations, or a number is not finite.
    """
    if not axes:
        raise FileError(states.path, "the motion is along x, y, z: name the axes of depth, lateral and rotation")
    given = [axes[name].index for name in TRANSLATIONS if name in axes]
    if len(set(given)) < len(given):
        raise FileError(states.path, "depth and lateral displacement cannot be along the same axis")
    if "rotation" in axes and states.rotation is None:
        raise FileError(states.path, "the file has no rotations: leave out the axis of rotation")
    values, columns = {"time": states.time}, {"time": "time"}
    for name, axis in axes.items():
        kind, source = ("rotation", states.rotation) if name == "rotation" else ("displacement", states.displacement)
        if source is not None:
            values[name] = axis.sign * np.asarray(source)[:, axis.index] + 0.0
            columns[name] = f"{'xyz'[axis.index]} {kind}"
    readings = Readings(path=states.path, values=values, lines=states.lines)
    for name, column in columns.items():
        at = replace(readings, lines=states.rotation_lines or states.lines) if name == "rotation" else readings
        at.require(name, np.isfinite(values[name]), f"(the column of {column}) must be a finite number", "")
    return readings


def select(path: str | PathLike[str], kind: str, ids: Sequence[int], wanted: int | None) -> int:
    """Return the id of the body to read: the one requested or, without a request, the only one in the file.

    Raises
    ------
    FileError
        If the requested body is missing, or there are several and none is requested.
    """
    listed = ", ".join(str(one) for one in ids[:20]) + (", ..." if len(ids) > 20 else "")
    if wanted is None:
        if len(ids) == 1:
            return ids[0]
        raise FileError(path, f"name the {kind} to read, there are: {listed or 'none'}")
    if wanted not in ids:
        raise FileError(path, f"there is no {kind} {wanted}, there are: {listed or 'none'}")
    return wanted


# The number of digits is limited: otherwise the search would start again at each digit of a long number.
NUMBER = re.compile(
    r"[+-]?\d{1,40}\.\d{,40}(?:[EeDd][+-]?\d{1,9}|[+-]\d{3})?|[+-]?(?:nan|inf(?:inity)?)", re.IGNORECASE
)
MAX_LINE = 10_000
"""Longest line of numbers that is parsed [characters]. Lines in LS-DYNA files have some 200; the limit bounds the time
for a crafted line (the number is arbitrary)."""
ASTERISKS, COLUMN_WIDTH = re.compile(r"\*+"), 12
"""Fortran fills the column of a number that does not fit with asterisks; a column of LS-DYNA is 12 characters wide."""
BARE_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d{3})$")
"""Exponent of three digits, before which Fortran omits the E."""

RBDOUT_MARK = "r i g i d   b o d y   m o t i o n"
RBDOUT_STATE = re.compile(r"\s*r i g i d +b o d y +m o t i o n +a t +cycle= *\S+ +time= *(?P<time>\S+)\s*")
SWITCHED = "a part that is switched to deformable is not a rigid body"
"""Hint in the error for a body that is missing from a state in the middle of a file."""
BODY = re.compile(r"\s*(nodal )?rigid body\s+(?P<body>\d{1,18})\b.*")
DISPLACEMENT_LINE = re.compile(r"\s*displacements:(?P<numbers>.*)")

NODOUT_MARK = "n o d a l   p r i n t   o u t"
NODOUT_STATE = re.compile(
    r"\s*n o d a l +p r i n t +o u t +f o r +t i m e +s t e p.*\( *at time *(?P<time>[^\s)]+) *\)\s*"
)
COLUMN_NAMES = re.compile(r"\s*nodal point\s+x-(?P<kind>disp|rot)\b.*")
NODE = re.compile(r"\s*(?P<node>\d{1,18})(?P<numbers>(?:\s*[+-]?\d{,40}\.|\s*\*|\s+[+-]?(?:nan|inf)).*)", re.IGNORECASE)


def read_rbdout(path: str | Path, lines: Sequence[str], part: int | None) -> States:
    """Read the motion of one rigid body from the lines of rbdout.

    Raises
    ------
    FileError
        If the body is missing, or one of its states is incomplete.
    """
    starts: list[int] = []
    times: list[float] = []
    rows: list[tuple[int, int, int, str]] = []  # Each row holds body, state, line and numbers.
    body: int | None = None
    for line, text in enumerate(lines, 1):
        if found := RBDOUT_STATE.fullmatch(text):
            times += _numbers(path, line, found["time"], 1, "time")[:1]
            starts.append(line)
            body = None
        elif found := BODY.fullmatch(text):
            body = int(found["body"])
        elif body is not None and starts and (found := DISPLACEMENT_LINE.fullmatch(text)):
            rows.append((body, len(starts), line, found["numbers"]))
            # Later displacements of this body are along its own axes, and are skipped.
            body = None
    wanted = select(path, "rigid body", sorted({row[0] for row in rows}), part)
    motions: list[list[float]] = []
    places = [row[2] for row in rows if row[0] == wanted]
    for _, state, line, numbers in (row for row in rows if row[0] == wanted):
        if len(motions) == state:
            raise FileError(path, f"the state has rigid body {wanted} twice", line)
        _require_complete(path, f"rigid body {wanted}", starts, state - 1, motions)
        motions.append(_numbers(path, line, numbers, 6, "displacements and rotations"))
    _require_complete(path, f"rigid body {wanted}", starts, len(starts), motions)
    motion = np.array([row[:6] for row in motions]).reshape(-1, 6)
    return States(path=path, time=np.array(times), displacement=motion[:, :3], rotation=motion[:, 3:], lines=places)


def read_nodout(path: str | Path, lines: Sequence[str], node: int | None) -> States:
    """Read the motion of one node from the lines of nodout.

    Raises
    ------
    FileError
        If the node is missing, or one of its states is incomplete.
    """
    wanted = select(path, "node", _nodes(lines), node)
    times: dict[str, list[float]] = {"disp": [], "rot": []}
    motions: dict[str, list[list[float]]] = {"disp": [], "rot": []}
    starts: dict[str, list[int]] = {"disp": [], "rot": []}
    places: dict[str, list[int]] = {"disp": [], "rot": []}
    time, start, kind = 0.0, 0, ""
    missing = f"line of node {wanted}"
    begun = False
    for line, text in enumerate(lines, 1):
        if state := NODOUT_STATE.fullmatch(text):
            time, start, kind = _numbers(path, line, state["time"], 1, "time")[0], line, ""
        elif names := COLUMN_NAMES.fullmatch(text):
            kind, begun = names["kind"], False
            _require_complete(path, missing, starts[kind], len(starts[kind]), motions[kind])
            starts[kind].append(start)
            times[kind].append(time)
        elif kind and (row := NODE.fullmatch(text)):
            begun = True
            if int(row["node"]) == wanted and len(motions[kind]) < len(starts[kind]):
                motions[kind].append(_numbers(path, line, row["numbers"], 3, f"node {wanted}")[:3])
                places[kind].append(line)
        elif begun:
            # A table ends at the first line that is not a row, since the title of the next state may look like a row.
            kind = ""
    for kind, lines_of_states in starts.items():
        _require_complete(path, missing, lines_of_states, len(lines_of_states), motions[kind])
    return States(
        path=path,
        time=np.array(times["disp"]),
        displacement=np.array(motions["disp"]).reshape(-1, 3),
        rotation=np.array(motions["rot"]).reshape(-1, 3) if times["rot"] == times["disp"] else None,
        lines=places["disp"],
        rotation_lines=places["rot"],
    )


def _nodes(lines: Sequence[str]) -> list[int]:
    """Return the ids of the nodes in the first state."""
    nodes: list[int] = []
    begun = False
    for text in lines:
        if COLUMN_NAMES.fullmatch(text):
            begun = True
        elif begun and (row := NODE.fullmatch(text)):
            nodes.append(int(row["node"]))
        elif nodes:
            break
    return nodes


def _require_complete(
    path: str | Path, missing: str, starts: Sequence[int], states: int, motions: Sequence[list[float]]
) -> None:
    """Raise an error if one of the first `states` states has no row of the wanted body."""
    if len(motions) < states:
        reason = "is the file cut short?" if len(motions) == len(starts) - 1 else SWITCHED
        raise FileError(path, f"the state has no {missing}: {reason}", starts[len(motions)])


def _numbers(path: str | PathLike[str], line: int, text: str, least: int, what: str) -> list[float]:
    """Return the numbers of a line, NaN for asterisks; columns of fixed width need no separators.

    Raises
    ------
    FileError
        If the line holds anything but numbers, or fewer than `least`.
    """
    if len(text) > MAX_LINE:
        raise FileError(path, f"{what}: the line has more than {MAX_LINE:,} characters", line)
    text = ASTERISKS.sub(lambda found: " nan" * max(1, len(found[0]) // COLUMN_WIDTH), text)
    rest = NUMBER.sub(" ", text).strip()
    if rest:
        raise FileError(path, f"{what} must be numbers, got {rest[:40]!r}", line)
    found = [float(BARE_EXPONENT.sub(r"E\1", each.upper().replace("D", "E"))) for each in NUMBER.findall(text)]
    if len(found) < least:
        raise FileError(path, f"{what}: {least} numbers are needed, the line has {len(found)}", line)
    return found


STATE = re.compile(r"/(?P<database>rbdout|nodout)/d(?P<state>\d{1,18})/time")
DISPLACEMENTS = {
    "rbdout": ("global_dx", "global_dy", "global_dz"),
    "nodout": ("x_displacement", "y_displacement", "z_displacement"),
}
ROTATIONS = {
    "rbdout": ("global_rdx", "global_rdy", "global_rdz"),
    "nodout": ("rx_displacement", "ry_displacement", "rz_displacement"),
}
BODIES = {"rbdout": "rigid body", "nodout": "node"}

CHANGE_FOLDER, DATA, VARIABLE, TABLE, TABLE_END, FIRST_TABLE = 2, 3, 4, 5, 6, 7
HEADER_BYTES = 8
MAX_PATH = 1000
"""Longest path of a variable [characters]. Paths in LS-DYNA files have some 50; a damaged file could nest folders
without end, and each variable keeps its whole path."""
TYPES: Mapping[int, str] = {
    1: "i1", 2: "i2", 3: "i4", 4: "i8", 5: "u1", 6: "u2", 7: "u4", 8: "u8", 9: "f4", 10: "f8"
}  # fmt: skip


def is_binout(content: bytes) -> bool:
    """Return True if a file begins with the header of a binout."""
    return (
        len(content) > HEADER_BYTES
        and content[0] >= HEADER_BYTES
        and all(size in (1, 2, 4, 8) for size in content[1:5])
        and content[5] in (0, 1)
    )


def read_binout(path: str | Path, content: bytes, part: int | None, node: int | None) -> States:
    """Read the motion of one rigid body or of one node.

    Without an id of either, a node is read only if the file has no rigid bodies.

    Raises
    ------
    FileError
        If the body is missing, or the file is damaged.
    """
    files = [Lsda(path, content), *_continuations(path)]
    states: dict[str, list[tuple[int, Folder]]] = {"rbdout": [], "nodout": []}
    for file in files:
        for name in file.names():
            if found := STATE.fullmatch(name):
                folder = Folder(file, name.removesuffix("/time"))
                states[found["database"]].append((int(found["state"]), folder))
    database = "nodout" if node is not None or (part is None and not states["rbdout"]) else "rbdout"
    folders = [folder for _, folder in sorted(states[database], key=lambda state: state[0])]
    if not folders:
        others = sorted({name.split("/")[1] for file in files for name in file.names()})[:20]
        sought = database if node is not None or part is not None else "rbdout and no nodout"
        reason = f"the binout has no {sought}, but {', '.join(others) or 'nothing'}"
        raise FileError(path, f"{reason}; LS-DYNA may have written it to another file of the run")
    known = _ids_of_states(files, folders, database)
    kind = BODIES[database]
    different = {id(ids): ids for ids in known}
    listed = list(dict.fromkeys(int(each) for ids in different.values() for each in ids[np.isfinite(ids)]))
    wanted = select(path, kind, listed, node if database == "nodout" else part)
    found_in = {key: np.flatnonzero(ids == wanted) for key, ids in different.items()}
    places = []
    for row, ids in enumerate(known):
        columns = found_in[id(ids)]
        if len(columns) != 1:
            times = f"{len(columns)} times" if len(columns) else f"not at all: {SWITCHED}"
            raise FileError(path, f"state {row + 1} has {kind} {wanted} {times}")
        places.append((int(columns[0]), len(ids)))
    rotated = folders[0].file.read(f"{folders[0].path}/{ROTATIONS[database][0]}") is not None
    return States(
        path=path,
        time=_over_states(folders, "time", [(0, 1)] * len(folders)),
        displacement=np.column_stack([_over_states(folders, name, places) for name in DISPLACEMENTS[database]]),
        rotation=np.column_stack([_over_states(folders, name, places) for name in ROTATIONS[database]])
        if rotated
        else None,
    )


def _continuations(path: str | Path) -> Iterator["Lsda"]:
    """Yield the files in which LS-DYNA continues a full binout, such as binout0000%001 and binout0000%002."""
    for number in itertools.count(1):
        further = Path(f"{path}%{number:03d}")
        if not further.exists():
            return
        yield Lsda(further, read_bytes(further))


def _ids_of_states(files: Sequence["Lsda"], folders: Sequence["Folder"], database: str) -> list[FloatArray]:
    """Return the ids of the bodies in each state, in the order in which the state lists their values.

    States with equal ids share an array. The ids are taken from the state itself or, if it has none, from the metadata
    last written before it. LS-DYNA writes the metadata again when a part is switched between rigid and deformable, and
    in each file that continues a run.
    """
    known: list[FloatArray] = []
    latest: FloatArray | None = None
    for folder in folders:
        ids = folder.file.read(f"{folder.path}/ids")
        if ids is None:
            written = folder.file.read(f"/{database}/metadata/ids", before=folder.path)
            ids = latest = latest if written is None else written
        if ids is None:
            raise FileError(files[0].path, f"the binout has no ids for its {database}")
        known.append(known[-1] if known and (ids is known[-1] or np.array_equal(ids, known[-1])) else ids)
    return known


def _over_states(folders: Sequence["Folder"], name: str, places: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
    """Return one variable of the body over all states.

    Parameters
    ----------
    places
        Position of the body in each state, and the number of bodies there.
    """
    values = []
    for row, (folder, (column, bodies)) in enumerate(zip(folders, places, strict=True)):
        numbers = folder.file.read(f"{folder.path}/{name}")
        if numbers is None:
            raise FileError(folder.file.path, f"state {row + 1}: {name} is missing: is the file cut short?")
        if len(numbers) != bodies:
            reason = f"{name} has {len(numbers)} numbers, but there are {bodies} ids: which body is which is not known"
            raise FileError(folder.file.path, f"state {row + 1}: {reason}")
        values.append(numbers[column])
    return np.array(values)


@dataclass(frozen=True, slots=True)
class Folder:
    """The folder of a state in one of the files of a run."""

    file: "Lsda"
    path: str


@dataclass(frozen=True, slots=True)
class Variable:
    """Type and position of the numbers of a variable."""

    dtype: np.dtype[Any]
    start: int
    count: int


def _start(variable: Variable) -> int:
    return variable.start


class Lsda:
    """Reader of the variables of an LSDA file.

    Parameters
    ----------
    content
        The whole file.

    Raises
    ------
    FileError
        If the file is damaged or cut short.
    """

    def __init__(self, path: str | Path, content: bytes) -> None:
        self.path = path
        self._content = content
        self._length, self._offset, self._command, self._type = content[1:5]
        self._order: Literal["little", "big"] = "little" if content[5] else "big"
        self._variables: dict[str, list[Variable]] = {}
        self._numbers: dict[Variable, NDArray[np.float64]] = {}
        self._bytes = 0
        self._read_tables()
        for versions in self._variables.values():
            versions.sort(key=_start)

    def names(self) -> Iterator[str]:
        """Yield the paths of all variables."""
        yield from self._variables

    def read(self, name: str, before: str = "") -> NDArray[np.float64] | None:
        """Return the numbers of a variable; None if there is no such variable.

        Parameters
        ----------
        before
            Folder of a state. A variable may be written several times: the last one before this state is read or, if
            there is none, the first; by default the last in the file.
        """
        versions = self._variables.get(name)
        if versions is None:
            return None
        variable = versions[-1]
        if before:
            end = self._variables[f"{before}/time"][-1].start
            variable = versions[max(0, bisect_left(versions, end, key=_start) - 1)]
        if variable not in self._numbers:
            size = variable.count * variable.dtype.itemsize
            self._bytes += size
            if variable.start + size > len(self._content):
                raise self._cut_short(variable.start)
            # In an undamaged file each variable has its own bytes. Without this check a crafted table could name the
            # same bytes under many names, and fill the memory.
            if self._bytes > len(self._content):
                raise self._damaged("its variables overlap")
            numbers = np.frombuffer(self._content, variable.dtype, variable.count, variable.start)
            self._numbers[variable] = numbers.astype(np.float64)
        return self._numbers[variable]

    def _read_tables(self) -> None:
        command, position, _ = self._record(self._content[0])
        if command != FIRST_TABLE:
            raise FileError(self.path, "the binout has no table of symbols")
        seen = set()
        while table := self._integer(position, self._offset):
            if table in seen:
                raise self._damaged("its tables of symbols form a cycle")
            seen.add(table)
            position = self._read_table(table)

    def _read_table(self, position: int) -> int:
        """Read one table of symbols, and return the position of the offset of the next one."""
        command, position, _ = self._record(position)
        if command != TABLE:
            raise self._damaged(f"no table of symbols at byte {position}")
        folder = "/"
        while True:
            command, start, end = self._record(position)
            if command == TABLE_END:
                return start
            if end < start:
                raise self._damaged(f"a record at byte {position} has no length")
            if command == CHANGE_FOLDER:
                folder = self._path(folder, self._text(start, end))
            elif command == VARIABLE:
                name_end = end - self._type - self._offset - self._length
                name = self._text(start, name_end)
                self._add(self._path(folder, name), name, name_end)
            position = end

    def _path(self, folder: str, name: str) -> str:
        path = posixpath.normpath(posixpath.join(folder, name))
        if len(path) > MAX_PATH:
            raise self._damaged(f"it has folders of more than {MAX_PATH} characters")
        return path

    def _add(self, path: str, name: str, position: int) -> None:
        kind = self._integer(position, self._type)
        # Other types are links to folders, whose variables are read under their own paths.
        if kind not in TYPES:
            return
        offset = self._integer(position + self._type, self._offset)
        count = self._integer(position + self._type + self._offset, self._length)
        command, start, end = self._record(offset)
        if command != DATA:
            raise self._damaged(f"{path} is not at byte {offset}")
        start += self._type + 1 + len(name)
        dtype = np.dtype(TYPES[kind]).newbyteorder("<" if self._order == "little" else ">")
        if count * dtype.itemsize > end - start:
            raise self._damaged(f"{path} is longer than its record")
        self._variables.setdefault(path, []).append(Variable(dtype, start, count))

    def _record(self, position: int) -> tuple[int, int, int]:
        """Return the command of a record, and the start and end of its content."""
        length = self._integer(position, self._length)
        start = position + self._length + self._command
        end = position + length
        command = self._integer(position + self._length, self._command)
        if command not in (TABLE, TABLE_END) and end < start:
            raise self._damaged(f"a record at byte {position} has no length")
        return command, start, end

    def _integer(self, position: int, width: int) -> int:
        if not 0 <= position <= len(self._content) - width:
            raise self._cut_short(position)
        return int.from_bytes(self._content[position : position + width], self._order)

    def _text(self, start: int, end: int) -> str:
        if end > len(self._content) or end < start:
            raise self._cut_short(start)
        return self._content[start:end].decode("latin-1")

    def _damaged(self, how: str) -> FileError:
        return FileError(self.path, f"the binout is damaged: {how}")

    def _cut_short(self, position: int) -> FileError:
        return FileError(
            self.path, f"the binout is cut short: it ends at byte {len(self._content)}, but byte {position} is needed"
        )
