"""LS-DYNA files rbdout, nodout and binout: the same motion is read from each, and invalid files are refused."""

import math
import random
import re
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.readers.calibration import read_motion
from service.readers.dyna import CoordinateAxis
from service.readers.files import FileError
from solver.arrays import FloatArray
from tests.readers.dyna_files import write_binout, write_nodout, write_rbdout

TIME = np.linspace(0.0, 4.0, 21)  # ms
DEPTH, LATERAL, ROTATION = 200.0 * np.sin(TIME / 3.0), 120.0 * TIME, 0.05 * TIME**2  # mm, mm, rad
AXES = {
    "depth_displacement": CoordinateAxis.named("-z"),
    "lateral_displacement": CoordinateAxis.named("x"),
    "rotation": CoordinateAxis.named("-y"),
}
UNITS = {"time": "ms", "depth_displacement": "mm", "lateral_displacement": "mm"}
OTHER = np.full((len(TIME), 6), -1.2345e-101)


def along_axes() -> FloatArray:
    zero = np.zeros_like(TIME)
    return np.column_stack([LATERAL, zero, -DEPTH, zero, -ROTATION, zero])


Writer = Callable[..., None]
WRITERS = pytest.mark.parametrize(
    ("write", "choice"),
    [
        (write_rbdout, {"part": 42}),
        (write_nodout, {"node": 42}),
        (write_binout, {"part": 42}),
        (lambda *a: write_binout(*a, order=">"), {"part": 42}),
        (lambda *a: write_binout(*a, database="nodout"), {"node": 42}),
    ],
    ids=["rbdout", "nodout", "binout", "binout of the other byte order", "binout of nodes"],
)


@WRITERS
def test_motion_is_read_along_the_named_axes(tmp_path: Path, write: Writer, choice: dict[str, Any]) -> None:
    write(tmp_path / "file", TIME, {7: OTHER, 42: along_axes()})
    history = read_motion(tmp_path / "file", units=UNITS, axes=AXES, **choice)
    assert np.allclose(history.time, 1e-3 * TIME)
    for name, expected in (("depth_displacement", 1e-3 * DEPTH), ("lateral_displacement", 1e-3 * LATERAL)):
        assert np.allclose(history.columns[name], expected, rtol=2e-4, atol=1e-12), name
    assert np.allclose(history.columns["rotation"], ROTATION, rtol=2e-4, atol=1e-12)


@WRITERS
def test_motion_counts_from_the_first_state(tmp_path: Path, write: Writer, choice: dict[str, Any]) -> None:
    write(tmp_path / "file", TIME + 5.0, {7: OTHER, 42: along_axes() + 3.0})
    history = read_motion(tmp_path / "file", axes=AXES, **choice)
    assert [history.time[0], *(column[0] for column in history.columns.values())] == [0.0] * 4
    assert history.time[-1] == pytest.approx(4.0)
    later = read_motion(tmp_path / "file", axes=AXES, contact=6.1, **choice)
    assert later.time[-1] == pytest.approx(2.9)


@WRITERS
def test_body_must_be_chosen_if_there_are_several(tmp_path: Path, write: Writer, choice: dict[str, Any]) -> None:
    file = tmp_path / "file"
    write(file, TIME, {7: OTHER, 42: along_axes()})
    absent: dict[str, Any] = dict.fromkeys(choice, 3)
    with pytest.raises(FileError, match=r"there is no .* 3, there are: 7, 42"):
        read_motion(file, axes=AXES, **absent)
    with pytest.raises(FileError, match=r"name the .* to read, there are: 7, 42"):
        read_motion(file, axes=AXES)
    with pytest.raises(FileError, match="name the axes of depth"):
        read_motion(file, **choice)
    write(file, TIME, {42: along_axes()})
    assert len(read_motion(file, axes=AXES).time) == len(TIME)


@WRITERS
def test_one_state_or_repeated_time_is_refused(tmp_path: Path, write: Writer, choice: dict[str, Any]) -> None:
    write(tmp_path / "file", TIME[:1], {42: along_axes()})
    with pytest.raises(FileError, match="at least 2 rows"):
        read_motion(tmp_path / "file", axes=AXES)
    write(tmp_path / "file", np.where(TIME == 4.0, 3.8, TIME), {42: along_axes()})
    with pytest.raises(FileError, match=r"(:\d+|state 21): time must increase from row to row, got 3.8 s after 3.8 s"):
        read_motion(tmp_path / "file", axes=AXES)


@pytest.mark.parametrize("write", [write_rbdout, write_nodout], ids=["rbdout", "nodout"])
def test_damaged_text_is_refused_with_its_line(tmp_path: Path, write: Writer) -> None:
    file = tmp_path / "file"
    write(file, TIME, {42: along_axes()})
    lines = file.read_bytes().splitlines(keepends=True)
    row = next(n for n, line in enumerate(lines) if f"{-DEPTH[3]:12.4E}".encode() in line and b"coord" not in line)
    for damage, reason in (
        (b" ***********", "must be a finite"),
        (b"         NaN", "z disp.*finite"),
        (b"   0.12E", "be numbers"),
    ):
        damaged = lines[row].replace(f"{-DEPTH[3]:12.4E}".encode(), damage)
        file.write_bytes(b"".join([*lines[:row], damaged, *lines[row + 1 :]]))
        with pytest.raises(FileError, match=reason) as refused:
            read_motion(file, axes=AXES)
        assert refused.value.line == row + 1
    file.write_bytes(b"".join(lines[:row]))
    with pytest.raises(FileError, match="is the file cut short"):
        read_motion(file, axes=AXES)


def test_truncated_or_damaged_binout_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "binout0000"
    write_binout(file, TIME[:3], {42: along_axes()})
    whole = file.read_bytes()
    for length in range(1, len(whole), 7):
        file.write_bytes(whole[:length])
        with pytest.raises(FileError):
            read_motion(file, axes=AXES, part=42)
    shuffle = random.Random(5)  # noqa: S311
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[shuffle.randrange(len(whole))] = shuffle.randrange(256)
        file.write_bytes(damaged)
        with suppress(FileError):  # There is no error if the damage only changes a number.
            read_motion(file, axes=AXES, part=42)


def test_binout_continues_in_its_next_file(tmp_path: Path) -> None:
    write_binout(tmp_path / "binout0000", TIME[:8], {42: along_axes()[:8]})
    write_binout(tmp_path / "binout0000%001", TIME[8:], {42: along_axes()[8:]}, first=9)
    history = read_motion(tmp_path / "binout0000", units=UNITS, axes=AXES)
    assert np.allclose(history.columns["depth_displacement"], 1e-3 * DEPTH, rtol=2e-4)


@pytest.mark.parametrize(
    ("database", "choice", "reason"),
    [
        ("nodout", {"part": 42}, "the binout has no rbdout, but nodout"),
        ("rbdout", {"node": 42}, "the binout has no nodout, but rbdout"),
        ("matsum", {}, "the binout has no rbdout and no nodout, but matsum"),
    ],
)
def test_error_about_a_binout_without_the_motion_lists_its_content(
    tmp_path: Path, database: str, choice: dict[str, Any], reason: str
) -> None:
    write_binout(tmp_path / "binout", TIME, {42: along_axes()}, database=database)
    with pytest.raises(FileError, match=reason):
        read_motion(tmp_path / "binout", axes=AXES, **choice)


@pytest.mark.parametrize("ids_in", ["states", "metadata"])
@pytest.mark.parametrize("database", ["rbdout", "nodout"])
def test_binout_reader_follows_a_body_whose_position_changes(tmp_path: Path, database: str, ids_in: Any) -> None:
    def present(state: int) -> list[int]:
        return [7, 42] if state < 5 else [42, 8, 7] if state < 9 else [42]

    bodies = {7: OTHER, 8: OTHER, 42: along_axes()}
    write_binout(tmp_path / "binout", TIME, bodies, database=database, present=present, ids_in=ids_in)
    choice: dict[str, Any] = {"part" if database == "rbdout" else "node": 42}
    history = read_motion(tmp_path / "binout", units=UNITS, axes=AXES, **choice)
    assert np.allclose(history.columns["depth_displacement"], 1e-3 * DEPTH, rtol=2e-4)


@pytest.mark.parametrize(
    ("ids_in", "present", "reason"),
    [
        (
            "states",
            lambda n: [7, 42] if n < 5 else [7],
            "state 6 has rigid body 42 not at all: a part that is switched",
        ),
        (
            "states",
            lambda n: [7] if n < 5 else [7, 42],
            "state 1 has rigid body 42 not at all: a part that is switched",
        ),
        ("states", lambda n: [7, 42, 42], "state 1 has rigid body 42 2 times"),
        (
            "first metadata",
            lambda n: [7, 42] if n < 5 else [42],
            "state 6: global_dx has 1 numbers, but there are 2 ids",
        ),
        (
            "first metadata",
            lambda n: [42] if n < 5 else [7, 42],
            "state 6: global_dx has 2 numbers, but there are 1 ids",
        ),
    ],
)
def test_rigid_deformable_switches_are_refused(tmp_path: Path, ids_in: Any, present: Any, reason: str) -> None:
    write_binout(tmp_path / "binout", TIME, {7: OTHER, 42: along_axes()}, present=present, ids_in=ids_in)
    with pytest.raises(FileError, match=re.escape(reason)):
        read_motion(tmp_path / "binout", axes=AXES, part=42)


def test_rigid_deformable_switch_is_named_in_errors(tmp_path: Path) -> None:
    write_rbdout(tmp_path / "rbdout", TIME, {7: OTHER, 42: along_axes()})
    lines = (tmp_path / "rbdout").read_text("latin-1").splitlines(keepends=True)
    starts = [n for n, line in enumerate(lines) if line.startswith(" rigid body      42")]
    del lines[starts[7] : starts[7] + 20]
    (tmp_path / "rbdout").write_text("".join(lines), "latin-1")
    with pytest.raises(FileError, match="no rigid body 42: a part that is switched to deformable"):
        read_motion(tmp_path / "rbdout", axes=AXES, part=42)


@WRITERS
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(("column", "used"), [(1, None), (3, None), (2, "z displacement"), (4, "y rotation")])
def test_non_finite_number_is_refused_only_where_it_is_read(
    tmp_path: Path, write: Writer, choice: dict[str, Any], value: float, column: int, used: str | None
) -> None:
    motion = along_axes()
    motion[4, column] = value
    write(tmp_path / "file", TIME, {7: np.full_like(OTHER, value), 42: motion})
    if used is None:
        assert len(read_motion(tmp_path / "file", axes=AXES, **choice).time) == len(TIME)
    else:
        with pytest.raises(FileError, match=rf"(:\d+|state 5): .* \(the column of {used}\) must be a finite number"):
            read_motion(tmp_path / "file", axes=AXES, **choice)


@pytest.mark.parametrize("write", [write_rbdout, write_nodout], ids=["rbdout", "nodout"])
@pytest.mark.parametrize(
    "title",
    ["rigid body 3 at 45 deg", "       3  1.0000E+00  2.0000E+00", "2024. test 3.5", " displacements:  1.0 2.0"],
)
def test_title_that_looks_like_data_is_skipped(tmp_path: Path, write: Writer, title: str) -> None:
    write(tmp_path / "file", TIME, {42: along_axes()})
    content = (tmp_path / "file").read_bytes()
    for mark in (b"  r i g i d   b o d y", b" n o d a l   p r i n t"):
        content = content.replace(mark, title.encode() + b"\n" + mark)
    (tmp_path / "file").write_bytes(title.encode() + b"\n" + content)
    history = read_motion(tmp_path / "file", units=UNITS, axes=AXES)
    assert np.allclose(history.columns["depth_displacement"], 1e-3 * DEPTH, rtol=2e-4)


GLSTAT = (
    b" a title\n                         ls-dyna mpp.190 s              date 10/29/2021\n\n"
    b" dt of cycle       1 is controlled by solid         100778 of part        10\n\n"
    b" time...........................   0.00000E+00\n kinetic energy.................   1.00000E+03\n"
)


@pytest.mark.parametrize(
    ("content", "name"),
    [
        (b"".ljust(40) + struct.pack("<54i", 0, 1, 960, 0, 0, 4, 808, 0, *[6] * 46), "LS-DYNA's d3plot"),
        (b"".ljust(80) + struct.pack(">54q", 0, 1, 960, 0, 0, 4, 808, 0, *[6] * 46), "LS-DYNA's d3plot"),
        (b"$ units: mm, ms, kg\n*KEYWORD\n*TITLE\nstrike\n", "an LS-DYNA keyword file"),
        (b"*KEYWORD\r\n*NODE\r\n", "an LS-DYNA keyword file"),
        (GLSTAT, "LS-DYNA's glstat"),
        (f"\n\n {'*' * 63}\n *     ANSYS 2021 R1          LEGAL NOTICES     *\n".encode(), "LS-DYNA's d3hsp"),
        (GLSTAT[:82] + b"\n\n c o n t a c t\n", "an LS-DYNA text file other than rbdout and nodout"),
        (b"\x1f\x8b\x08\x00rest of it", "a compressed file; decompress it first"),
        (b"PK\x03\x04\x14\x00rest of it", "an Excel workbook or a ZIP archive"),
        (b"\x89HDF\r\n\x1a\nrest of it", "an HDF5 file"),
        (b"PAR1\x15\x04rest of it", "a Parquet file"),
    ],
)
def test_error_about_an_unsupported_format_names_it(tmp_path: Path, content: bytes, name: str) -> None:
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(FileError, match=f"this is {name}"):
        read_motion(tmp_path / "file", axes=AXES)


def test_file_without_rotations_gives_only_displacements(tmp_path: Path) -> None:
    write_nodout(tmp_path / "nodout", TIME, {42: along_axes()}, rotations=False)
    with pytest.raises(FileError, match="the file has no rotations"):
        read_motion(tmp_path / "nodout", axes=AXES)
    history = read_motion(tmp_path / "nodout", axes={"depth_displacement": CoordinateAxis.named("-z")})
    assert history.columns.keys() == {"depth_displacement"}


def test_flags_of_another_file_format_are_refused(tmp_path: Path) -> None:
    write_rbdout(tmp_path / "rbdout", TIME, {42: along_axes()})
    with pytest.raises(FileError, match="only CSV files have columns"):
        read_motion(tmp_path / "rbdout", {"time": "T"}, axes=AXES)
    with pytest.raises(FileError, match="cannot be along the same axis"):
        read_motion(tmp_path / "rbdout", axes=AXES | {"lateral_displacement": CoordinateAxis.named("z")})
    with pytest.raises(FileError, match="unknown unit 'furlong' of time"):
        read_motion(tmp_path / "rbdout", units={"time": "furlong"}, axes=AXES)
    (tmp_path / "file.csv").write_text("time_s,rotation_deg\n0,0\n1,1\n")
    with pytest.raises(FileError, match="a CSV file has no axes"):
        read_motion(tmp_path / "file.csv", axes=AXES)
    assert math.isclose(read_motion(tmp_path / "file.csv").columns["rotation"][1], math.radians(1.0))
