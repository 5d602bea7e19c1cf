"""Files crafted to make readers slow, and valid files with changed bytes, are read or refused with one clear error."""

import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.cli.arguments import CommandError
from service.cli.case_table import read_cases
from service.cli.request_body import read_object
from service.readers.calibration import (
    read_depth_tests,
    read_motion,
    read_motion_runs,
    read_obliquity_points,
    read_shots,
)
from service.readers.dyna import CoordinateAxis
from service.readers.files import FileError
from service.schemas.strike import PAPER
from tests.readers.dyna_files import write_binout, write_nodout, write_rbdout

pytestmark = pytest.mark.timeout(60)
MANY = 300_000
AXES = {"depth_displacement": CoordinateAxis.named("-z"), "lateral_displacement": CoordinateAxis.named("x")}
LONGEST = 1_000
"""Largest length of an error message. [characters]"""
STATE = "\n r i g i d   b o d y   m o t i o n   a t  cycle=       0   time= 0.0000E+00\n"
TABLE = "\n n o d a l   p r i n t   o u t   f o r   t i m e  s t e p       1  ( at time 0.0E+00 )\n"
NODES = TABLE + "\n nodal point  x-disp     y-disp\n"


def motion(path: Path) -> object:
    return read_motion(path, axes=AXES if path.suffix != ".csv" else None)


def cases(path: Path) -> object:
    return read_cases(path, "cra", PAPER)


Reader = Callable[[Path], Any]
TABLES: tuple[Reader, ...] = (read_depth_tests, read_shots, read_obliquity_points, read_motion_runs, motion, cases)


def answer_of(reader: Reader, path: Path) -> str:
    """Read a file; return the error message, which must begin with the name of the file, or "" without an error."""
    try:
        reader(path)
    except (FileError, CommandError) as error:
        said = str(error)
    else:
        return ""
    assert said.startswith(str(path))
    assert len(said) - len(str(path)) < LONGEST
    assert "\n" not in said
    return said


LINES = {
    "digits": "velocity_m_s,depth_m\n" + "1" * 130_000 + "x,0.3\n",
    "more digits than a cell has": "velocity_m_s,depth_m\n" + "1" * MANY + "x,0.3\n",
    "digits alone": "1" * MANY,
    "comments of a keyword file": "$ " * 32,
    "lines of comments": "$\n" * MANY,
    "asterisks": "*" * MANY,
    "asterisks and a title": "*" * MANY + "LEGAL NOTICE",
    "titles": "ls-dyna date" * 20 + " " * 5_000_000 + "r i g i d   b o d y",
    "blanks before a unit": "time" + " " * MANY + "[s] depth\n1 2\n",
    "rows of units": "velocity,depth\n" + "m_s,a]b\n" * MANY,
    "columns": "a," * 1_000_000 + "velocity_m_s,depth_m\n",
    "quote that does not end": 'velocity_m_s,depth_m\n"' + "1\n" * MANY,
    "separators": "velocity_m_s,depth_m\n" + "," * MANY,
    "brackets": "(" * 100_000 + ",depth_m\n1,2\n",
}
DYNA = {
    "digits of a body": f"{STATE}rigid body {'1' * MANY}\n",
    "digits of a displacement": f"{STATE}rigid body 1\ndisplacements: {'1' * MANY}\n",
    "asterisks of a displacement": f"{STATE}rigid body 1\ndisplacements: {'*' * MANY}\n",
    "digits of a time": STATE.replace("0.0000E+00", "1" * MANY),
    "digits of a node": NODES + "1" * MANY,
    "digits of a node and a point": NODES + "1" * MANY + ".",
    "brackets of a time": "n o d a l   p r i n t   o u t   f o r   t i m e  s t e p" + "( at time " * MANY,
    "blanks of a node": f"{NODES} 1{' ' * MANY}x\n",
}


@pytest.mark.parametrize("text", LINES.values(), ids=LINES.keys())
def test_table_crafted_to_be_slow_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "file.csv").write_text(text)
    for reader in TABLES:
        assert answer_of(reader, tmp_path / "file.csv")


@pytest.mark.parametrize("text", DYNA.values(), ids=DYNA.keys())
def test_text_file_crafted_to_be_slow_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "file").write_text(text)
    assert answer_of(motion, tmp_path / "file")


BINOUT_HEAD = struct.pack("<6B2x", 8, 8, 8, 1, 1, 1)


def record(command: int, content: bytes = b"", length: int | None = None) -> bytes:
    return struct.pack("<QB", 9 + len(content) if length is None else length, command) + content


def with_tables(*records: bytes) -> bytes:
    """Return a binout whose only table has these records."""
    first = record(7, struct.pack("<Q", 8 + 17))
    return BINOUT_HEAD + first + record(5) + b"".join(records)


def overlapping(states: int) -> bytes:
    """Return a binout in which the list of ids of each state extends to the end of the file."""
    table = 8 + 17
    names = [b"/rbdout/d%06d" % number for number in range(states)]
    size = 9 + sum(2 * 9 + len(name) + 3 + 17 + 9 + 4 + 17 for name in names) + 17
    data, step = table + size, 32
    end = data + step * states + 64
    content = record(5)
    for number, name in enumerate(names):
        at = data + step * number
        count = (end - at - 9 - 1 - 1 - 3) // 4 - 2
        content += record(2, name)
        content += record(4, b"ids" + struct.pack("<BQQ", 3, at, count))
        content += record(4, b"time" + struct.pack("<BQQ", 10, data + step * states, 1))
    content += record(6, bytes(8))
    assert len(content) == size
    for number in range(states):
        content += record(3, b"\3\3ids", end - data - step * number).ljust(step, b"\0")
    content += record(3, b"\x0a\4time" + bytes(8)).ljust(64, b"\0")
    return BINOUT_HEAD + record(7, struct.pack("<Q", table)) + content


BINOUTS = {
    "record of length 0": with_tables(record(2, length=0)),
    "table in a table of length 0": with_tables(record(5, length=0)),
    "record that ends before it begins": with_tables(record(4, length=3)),
    "folders in folders": with_tables(*[record(2, b"a")] * MANY),
    "ids that overlap": overlapping(10_000),
    "state of 3,000 digits": with_tables(record(4, b"/rbdout/d" + b"1" * 3000 + b"/time" + b"\x09" + bytes(16))),
}


@pytest.mark.parametrize("content", BINOUTS.values(), ids=BINOUTS.keys())
def test_binout_crafted_to_be_slow_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "file").write_bytes(content)
    assert answer_of(motion, tmp_path / "file")


STRIKES = {
    "parts of a key.toml": "a." * 100_000 + "a=1",
    "parts of a table.toml": "[" + "a." * 100_000 + "a]",
    "parts in quotes.toml": '"\\"".' * 100_000 + "a=1",
    "parts of a key in braces.toml": "a={" + "a." * 100_000 + "a=1}",
    "quotes.toml": "a=" + '"\\' * MANY,
    "brackets.toml": "a=" + "[" * MANY,
    "digits.toml": "a=" + "1" * MANY,
    "digits.json": '{"a":' + "1" * MANY + "}",
    "brackets.json": "[" * MANY,
    "braces.json": '{"a":' * MANY,
    "blanks.json": " " * 20_000_000 + "{}",
}


@pytest.mark.parametrize(("name", "text"), STRIKES.items(), ids=STRIKES.keys())
def test_strike_file_crafted_to_be_slow_is_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    said = answer_of(read_object, tmp_path / name)
    assert said
    assert "sys." not in said


def test_endless_device_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.readers.files.MAX_BYTES", 1_000_000)
    monkeypatch.setattr("service.cli.request_body.MAX_OBJECT", 1_000_000)
    for reader in (read_shots, read_object):
        assert "larger than 1,000,000 bytes" in answer_of(reader, Path("/dev/zero"))


def valid_files(folder: Path) -> dict[Path, Reader]:
    """Write a valid file of each kind; return the function that reads each file, by path."""
    time, zero = np.linspace(0.0, 4.0, 9), np.zeros(9)
    bodies = {7: np.column_stack([120.0 * time, zero, -200.0 * np.sin(time / 3.0), zero, zero, zero])}
    write_rbdout(folder / "rbdout", time, bodies)
    write_nodout(folder / "nodout", time, bodies)
    write_binout(folder / "binout", time, bodies)
    write_binout(folder / "big", time, bodies, order=">")
    texts = {
        "tests.csv": "velocity (m/s),depth_mm,mass_kg,weight\n238,300,13,1\n275,380,13,1\n314.5,450,12.9,1\n",
        "shots.csv": "# shots\nvelocity_m_s;depth_m\n238,1;0,30\n",
        "points.csv": "oblique_angle_deg\tstrength_factor\n0\t8.5\n30\t7.9\n45\t6.5\n",
        "runs.csv": "file,oblique_angle_deg\nhistory.csv,30\n",
        "history.csv": "time  depth_displacement [mm]\n0 0\n1e-3 200\n2e-3 280\n",
        "cases.csv": "velocity_m_s,custom_id\n238,a\n240,b\n",
        "strike.toml": '[projectile]\nmass_kg = 13.0\nnose = { shape = "flat" }\n[impact]\nvelocity_m_s = 238.0\n',
        "strike.json": '{"projectile": {"mass_kg": 13.0, "nose": {"shape": "flat"}}, "x": [1, 2e5, true, "a"]}',
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    readers: tuple[Reader, ...] = (
        *[motion] * 4, read_depth_tests, read_shots, read_obliquity_points, read_motion_runs, motion, cases,
        read_object, read_object,
    )  # fmt: skip
    return dict(zip([folder / name for name in ("rbdout", "nodout", "binout", "big", *texts)], readers, strict=True))


def mutated(content: bytes, drawn: random.Random) -> bytes:
    """Return the content with some bytes changed, removed, repeated or inserted."""
    changed = bytearray(content)
    for _ in range(drawn.randint(1, 4)):
        begin, end = sorted(drawn.randrange(len(changed) + 1) for _ in range(2))
        kind = drawn.randrange(6)
        if kind == 0 and changed:
            changed[drawn.randrange(len(changed))] = drawn.choice(b"\x00\xff\"'.,;=[]{}()$*-+eE 0919\n\r\t\\")
        elif kind == 1 and changed:
            changed[drawn.randrange(len(changed))] = drawn.randrange(256)
        elif kind == 2:
            del changed[begin : min(end, begin + 20)]
        elif kind == 3:
            changed[begin:begin] = changed[begin : begin + 30] * drawn.choice((1, 3, 2000))
        elif kind == 4:
            changed[begin:begin] = bytes([drawn.choice(b'1. *($"[\n\x00\xff,;')]) * drawn.choice((1, 8, 50_000))
        else:
            del changed[max(1, end) :]
    return bytes(changed)


@pytest.mark.timeout(280)
def test_every_reader_returns_an_answer_or_one_clear_error(tmp_path: Path) -> None:
    drawn, read, refused = random.Random(46), 0, 0  # noqa: S311
    for path, reader in valid_files(tmp_path).items():
        assert "not a" not in answer_of(reader, path)
        content = path.read_bytes()
        for _ in range(150):
            path.write_bytes(mutated(content, drawn))
            if answer_of(reader, path):
                refused += 1
            else:
                read += 1
        path.write_bytes(content)
    assert min(read, refused) > 100
