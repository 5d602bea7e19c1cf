"""Depth tests and histories read from CSV files, and errors that name the line."""

import math
from pathlib import Path

import numpy as np
import pytest

from service.readers.calibration import Expected, read_depth_tests, read_motion, read_obliquity_points, read_shots
from service.readers.files import FileError
from solver import Impact, Shot
from solver.strike import PAPER_PROJECTILE

STRIKE = Expected(impact=Impact(velocity=238.0, oblique_angle=math.radians(30.0)), projectile=PAPER_PROJECTILE)
TESTS = "velocity_m_s,depth_m\n200,0.2\n300,0.4\n"
HISTORY = (
    "time_s,depth_displacement_m,lateral_displacement_m,rotation_deg\n0,0,0,0\n0.001,0.2,0.1,1\n0.002,0.3,0.2,3.5\n"
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "file.csv"


def test_published_tables_of_depth_tests_need_no_flags(file: Path) -> None:
    file.write_text("series,mass_kg,striking_velocity_m_s,penetration_depth_m\nA,12.9,312.5,0.61\nB,13.0,200,0.42\n")
    first, second = read_depth_tests(file)
    assert (first.velocity, first.depth, first.mass, first.group) == (312.5, 0.61, 12.9, None)
    assert (second.velocity, second.depth, second.mass) == (200.0, 0.42, 13.0)
    named = read_depth_tests(file, {"group": "series", "mass": ""}, grouped=True)
    assert [(test.group, test.mass) for test in named] == [("A", None), ("B", None)]


@pytest.mark.parametrize("head", ["Projectile Mass (kg)", "mass [kg]", "projectile_mass_kg"])
def test_mass_of_the_projectile_is_recognized(file: Path, head: str) -> None:
    file.write_text(f"velocity_m_s,depth_m,{head}\n200,0.2,12.9\n300,0.4,13\n")
    assert [test.mass for test in read_depth_tests(file)] == [12.9, 13.0]


@pytest.mark.parametrize(
    "table",
    [
        "Speed (m/s),Penetration depth (mm)\n200,200\n300,400\n",
        "v0 [m/s];P [cm]\n200;20\n300;40\n",
        "shot,Impact speed (km/s),Penetration,remark\na,0.2,0.2,\nb,0.3,0.4,deep\n",
        "Striking speed\tDepth\nm/s\tmm\n200\t200\n300\t400\n",
    ],
)
def test_usual_spellings_of_headers_are_accepted(file: Path, table: str) -> None:
    file.write_text(table)
    shots = [Shot(velocity=200.0, depth=0.2), Shot(velocity=300.0, depth=0.4)]
    assert read_shots(file) == shots
    assert [Shot(velocity=test.velocity, depth=test.depth) for test in read_depth_tests(file)] == shots


def test_invalid_numbers_in_unused_columns_are_ignored(file: Path) -> None:
    file.write_text("velocity_m_s,depth_m,Sabot Mass (kg),strain\n200,0.2,nan,1e999\n300,0.4,\u22121,***\n")
    assert [test.mass for test in read_depth_tests(file, {"mass": ""})] == [None, None]
    with pytest.raises(FileError, match=r":2: mass \('Sabot Mass \(kg\)'\) must be a finite number, got 'nan'"):
        read_depth_tests(file, {"mass": "Sabot Mass (kg)"})


def test_finite_element_history_needs_no_flags(file: Path) -> None:
    head = "time_s,depth_displacement_m,lateral_displacement_m,rotation_deg,depth_velocity_m_s,angular_velocity_deg_s"
    file.write_text(f"{head}\n0,0,0,0,206.1,0\n2.00247e-05,0.00412737,0.00238294,0,206.114,26.5\n1e-3,.18,.1,9,190,3\n")
    history = read_motion(file, expected=STRIKE)
    assert history.time.tolist() == [0.0, 2.00247e-05, 1e-3]
    assert history.rotation is not None
    assert history.rotation[-1] == pytest.approx(math.radians(9.0))


@pytest.mark.parametrize(
    "head", ["time_ms,depth_displacement_mm,rotation_rad", "time [ms];depth displacement (mm);Rotation(rad)"]
)
def test_units_in_the_header_are_converted(file: Path, head: str) -> None:
    separator = ";" if ";" in head else ","
    file.write_text(f"{head}\n" + "0,0,0\n1,150,0.1\n".replace(",", separator))
    history = read_motion(file)
    columns = history.columns
    assert np.allclose([history.time[1], columns["depth_displacement"][1], columns["rotation"][1]], [1e-3, 0.15, 0.1])


def test_columns_of_openradioss_are_selected_by_name(file: Path) -> None:
    """OpenRadioss' converter quotes and pads names, ends the header with a comma, and may omit the last number."""
    head = '"time","INTERNAL ENERGY","CG 42 body  DX        ","CG 42 body  DZ        ","CG 42 body  FX        ",'
    file.write_text(f"{head}\n0.000000,0.1,0.000000,-0.000000,7\n1.000000,0.1,100.000000,-150.000000,\n")
    columns = {"depth_displacement": "-CG 42 body DZ", "lateral_displacement": "CG 42 body DX"}
    units = {"time": "ms", "depth_displacement": "mm", "lateral_displacement": "mm"}
    history = read_motion(file, columns, units, expected=STRIKE)
    assert {name: column[1] for name, column in history.columns.items()} == {
        "depth_displacement": pytest.approx(0.15),
        "lateral_displacement": pytest.approx(0.1),
    }


@pytest.mark.parametrize(
    "content",
    [
        TESTS.encode(),
        b"\xef\xbb\xbf" + TESTS.encode(),
        TESTS.replace("\n", "\r\n").encode(),
        TESTS.replace(",", ";").encode(),
        TESTS.replace(",", "\t").encode(),
        ("# by hand\n\n" + TESTS + "\n\n").encode(),
        ("% Model: strike\n" + TESTS + "% end\n").encode(),
        ("sep=;\r\n" + TESTS.replace(",", ";")).encode("utf-8-sig"),
        ("sep=|\n" + TESTS.replace(",", "|")).encode(),
        (TESTS + ",\n,,\n\n").encode(),
        b"  velocity_m_s     depth_m\n  2.0000E+02   2.0000E-01\n  3.0000E+02   4.0000E-01\n",
        b"velocity (km/s)  depth (m)  note\n0.200  0.2  first\n0.300  0.4  second\n",
        b"# velocity_m_s depth_m\n2.0e+02 2.0e-01\n3.0e+02 4.0e-01\n",
        b"% Model: strike\n% velocity_m_s    depth_m\n200    0.2\n300   0.4\n",
        b"Test,Velocity,Depth\n-,(m/s),(mm)\nA,200,200\nB,300,400\n",
        b"Test;velocity;depth;weight;note\n;km/s;[cm];-\nA;.2;20;1;\nB;.3;40;1;\n",
        "velocity_m_s,depth_m,offset\n200,2e\u22121,\u22121\n300,0.4,\u22122\n".encode(),
    ],
    ids=[
        *("plain", "byte order mark", "crlf", "semicolons", "tabs", "comments", "per cent", "sep=;", "sep=|"),
        *("empty rows at the end", "fixed columns", "blanks before units", "numpy.savetxt", "COMSOL"),
        *("units below the names", "units below the names, in a spreadsheet", "typeset minus"),
    ],
)
def test_usual_dialects_of_csv_are_read(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    assert [(test.velocity, test.depth) for test in read_depth_tests(file)] == [(200.0, 0.2), (300.0, 0.4)]


@pytest.mark.parametrize(
    ("content", "line", "reason"),
    [
        ("velocity_m_s,depth_m\n200,0.2\n300,\n", 3, "depth is missing: the cell is empty"),
        ("velocity_m_s,depth_m\n200,0.2\n300\n", 3, "the line has 1 cells, the header 2"),
        ("velocity_m_s,depth_m\n200,0.2\n\n300,0.4\n", 3, "the line is empty"),
        ("velocity_m_s,depth_m\n200,0.2\n300,0.4,1\n", 3, "the line has 3 cells, the header 2"),
        ("velocity_m_s,mass_kg\n200,13\n300,13\n", 1, "no column of depth; there are: velocity_m_s, mass_kg"),
        ("velocity_m_s,depth_m\n200,0.2\n", 2, "at least 2 rows are needed, the file has 1"),
        ("velocity_m_s,depth_m\n", 1, "there are no rows below the header"),
        ("velocity_m_s,depth_m\n200,0.2\n0,0.4\n", 3, "velocity must be greater than 0, got 0 m/s"),
        ("velocity_m_s,depth_m\n200,0.2\n300,-0.4\n", 3, "depth must be greater than 0, got -0.4 m"),
        ("velocity_m_s,depth_m,mass_kg\n200,0.2,1\n300,0.4,0\n", 3, "mass must be greater than 0, got 0 kg"),
        ("velocity_m_s,depth_m,depth_mm\n200,0.2,200\n300,0.4,400\n", 1, "there are 2 columns of depth"),
        ("velocity_m_s,velocity_m_s,depth_m\n1,1,1\n1,1,1\n", 1, "there are 2 columns of velocity"),
        ("v,depth_m\n200,0.2\n300,deep\n", 3, "depth must be a finite number, got 'deep'"),
        ("velocity_m_s,depth_m\n200,0.2\n300,nan\n", 3, "depth must be a finite number, got 'nan'"),
        ("velocity_m_s,depth_m\n200,0.2\n300,1e999\n", 3, "depth must be a finite number, got '1e999'"),
        ("velocity_m_s,depth_m\n200,0.2\n1_000,0.4\n", 3, "velocity must be a finite number, got '1_000'"),
        ("velocity_m_s;depth_m\n200;0.2\n300;0,4\n", 3, "write decimals with a point"),
        ('velocity_m_s,depth_m\n"1,530",0.2\n300,0.4\n', 2, "got '1,530'; write 1530 or 1.530, whichever it means"),
        ('velocity_m_s,depth_m\n"1,530.5",0.2\n300,0.4\n', 2, "write 1530.5, without commas between thousands"),
        ("velocity_m_s;depth_m\n200;0,125\n300;0,4\n", 2, "got '0,125'; write decimals with a point"),
        ("velocity,depth\nof it,of its nose\n200,0.2\n", 2, "is this a second header? Units may stand below the names"),
        (",Impact,Result\nTest,velocity,depth\nA,200,0.2\n", 1, "line 2 holds no numbers: keep one header"),
        ("Curveplot\nLS-DYNA\nTime\nZ-displacement\n", 1, "no column of velocity; there are: Curveplot; line 2 holds"),
        ("velocity,depth,Sabot Mass (kg)\n200,0.2,1\n300,0.4,1\n", 1, "'Sabot Mass (kg)' is not read as mass; choose"),
        (";;\n;;\n", None, "the file holds comments only"),
        ("velocity_m_s,depth_furlong\n200,0.2\n300,0.4\n", 1, "unknown unit 'furlong' of depth, known are m, cm, mm"),
        ("velocity_km_s,depth_m\n200,0.2\n300,0.4\n", 2, "velocity is above 10 km/s (wrong unit?), got 200,000 m/s"),
        ("velocity,depth\n200,0.2\n300,400\n", 3, "depth is above 1000 diameters (wrong unit?), got 400 m"),
        ('velocity_m_s,depth_m\n200,0.2\n"300,0.4\n', 3, "not a CSV file"),
    ],
)
def test_invalid_tests_are_refused_with_their_line(file: Path, content: str, line: int | None, reason: str) -> None:
    file.write_text(content)
    with pytest.raises(FileError) as refused:
        read_depth_tests(file, {"velocity": "v"} if content.startswith("v,") else {}, diameter=0.08)
    assert str(refused.value).startswith(f"{file}:{line}: " if line else f"{file}: ")
    assert reason in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("0.002,", "0.001,", 4, "time must increase from row to row, got 0.001 s after 0.001 s"),
        ("0.002,", "0.0005,", 4, "time must increase from row to row, got 0.0005 s after 0.001 s"),
        ("0,0,0,0", "-0.001,0,0,0", 2, "time must be at least 0, first contact"),
        ("0.001,0.2", "0.001,", 3, "depth_displacement is missing: the cell is empty"),
        ("rotation_deg", "rotation_turns", 1, "unknown unit 'turns' of rotation"),
        ("rotation_deg", "time_ms", 1, "there are 2 columns of time: 'time_s' and 'time_ms'"),
        ("time_s", "clock", 1, "no column of time"),
        (
            "depth_displacement_m",
            "depth_displacement",
            3,
            "depth_displacement of 200 m after 0.001 s is more than possible",
        ),
        ("time_s", "time_ms", 3, "m after 1e-06 s is more than possible after an impact at 238 m/s"),
        ("depth_displacement_m,", "depth_displacement_mm,", 3, "of 0.0002 m after 0.001 s is much less than possible"),
        ("rotation_deg", "rotation", 4, "rotation of 3.5 rad after 0.002 s is more than possible"),
        ("0.2,3.5", "-0.32,3.5", 4, "lateral_displacement goes from 0.1 to -0.32 m within 0.001 s, more than possible"),
        ("0.2,3.5", "0.2,-115", 4, "rotation goes from 0.01745 to -2.007 rad within 0.001 s, more than possible"),
    ],
)
def test_invalid_histories_are_refused_with_their_line(file: Path, old: str, new: str, line: int, reason: str) -> None:
    content = HISTORY.replace(old, new)
    if new == "depth_displacement":
        content = content.replace("0.2,0.1", "200,0.1")
    file.write_text(content)
    with pytest.raises(FileError) as refused:
        read_motion(file, expected=STRIKE)
    assert str(refused.value).startswith(f"{file}:{line}: ")
    assert reason in str(refused.value)


def test_history_without_motion_is_refused(file: Path) -> None:
    file.write_text("time_s,depth_displacement_m\n0,0\n0.001,0\n")
    with pytest.raises(FileError, match="much less"):
        read_motion(file, expected=STRIKE)
    file.write_text("time_s,depth_velocity_m_s\n0,0\n0.001,0\n")
    with pytest.raises(FileError, match=":1: no column of depth_displacement, lateral_displacement, rotation"):
        read_motion(file)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "the file is empty"),
        (b"\xef\xbb\xbf\n", "the file is empty"),
        (b"# nothing\n", "comments only"),
        (TESTS.encode("utf-16"), "UTF-16"),
        (b"velocity_m_s,depth_m\n\x00\x01", "not a text file"),
        (b"velocity_m_s,depth_m\n\xff,1\n", "not a UTF-8 text file"),
    ],
)
def test_file_that_is_not_text_is_refused(file: Path, content: bytes, reason: str) -> None:
    file.write_bytes(content)
    with pytest.raises(FileError, match=reason):
        read_depth_tests(file)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"nothing\.csv: No such file"):
        read_depth_tests(tmp_path / "nothing.csv")
    with pytest.raises(FileError, match="directory"):
        read_depth_tests(tmp_path)


def test_requested_unit_must_agree_with_the_header(file: Path) -> None:
    file.write_text(HISTORY)
    with pytest.raises(FileError, match=":1: time is in s by the header, not in ms"):
        read_motion(file, units={"time": "ms"})
    assert read_motion(file, units={"time": "s"}).time[-1] == 0.002


def test_requested_column_must_exist(file: Path) -> None:
    file.write_text(HISTORY)
    with pytest.raises(FileError, match=":1: no column 'T'; there are: time_s, depth_displacement_m"):
        read_motion(file, {"time": "T"})


def test_time_and_displacements_count_from_contact(file: Path) -> None:
    file.write_text("time_s,depth_displacement_m,rotation_deg\n-0.001,-0.2,0\n0.001,0.2,0\n0.002,0.35,1\n")
    history = read_motion(file, contact=0.0005)
    assert history.depth_displacement is not None
    assert np.allclose(history.time, [0.0, 0.0005, 0.0015])
    assert np.allclose(history.depth_displacement, [0.0, 0.1, 0.25])
    with pytest.raises(FileError, match=r"the contact, 0\.002 s, must be"):
        read_motion(file, contact=0.002)


def test_obliquity_points_are_read(file: Path) -> None:
    file.write_text("oblique_angle_deg,strength_factor,standard_error\n15,8.25,0.1\n30,7.91,0.2\n")
    points = read_obliquity_points(file)
    assert [point.oblique_angle for point in points] == pytest.approx([math.radians(15.0), math.radians(30.0)])
    assert [(point.strength_factor, point.standard_error) for point in points] == [(8.25, 0.1), (7.91, 0.2)]


@pytest.mark.parametrize(
    ("content", "line", "reason"),
    [
        (
            "oblique_angle,strength_factor\n0,8\n15,8\n",
            3,
            "must be less than 90° from the normal (wrong unit?), got 15 rad",
        ),
        ("oblique_angle_deg,strength_factor\n0,8\n15,0\n", 3, "strength_factor must be greater than 0, got 0"),
        ("oblique_angle_deg,strength_factor,standard_error\n0,8,0.1\n15,8,\n", 3, "standard_error is missing"),
    ],
)
def test_invalid_points_are_refused_with_their_line(file: Path, content: str, line: int, reason: str) -> None:
    file.write_text(content)
    with pytest.raises(FileError) as refused:
        read_obliquity_points(file)
    assert str(refused.value).startswith(f"{file}:{line}: ")
    assert reason in str(refused.value)
