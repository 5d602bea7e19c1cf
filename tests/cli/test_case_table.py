"""Batches whose cases are the rows of a CSV table or an Excel workbook."""

import csv
import json
import sys
from pathlib import Path
from typing import Any

import pytest
from openpyxl import Workbook, load_workbook

from service import cli
from tests.cli.commands import case_at, write_cases

CONE = {"shape": "conical", "length_to_diameter": 1.5}
NONE = {"free_surface": {"model": "none"}}
WHOLE = (
    "custom_id,projectile.diameter_m,length_m,mass_kg,caliber_radius_head,compressive_strength_pa,density_kg_m3,velocity_m_s\n"
    "7,0.08,0.53,13,3,39e6,2250,238\n"
)


@pytest.mark.parametrize(
    ("table", "base", "cases"),
    [
        (WHOLE, False, [case_at(238.0, custom_id="7")]),
        ("velocity_m_s\n238\n\n240\n", True, [case_at(238.0), case_at(240.0)]),
        ("impact.velocity_m_s;custom_id\n238;a\n240;\n", True, [case_at(238.0, custom_id="a"), case_at(240.0)]),
        ("\ufeffvelocity_m_s\tfree_surface.model\r\n240\tnone\r\n", True, [case_at(240.0, resistance=NONE)]),
        (
            "length_to_diameter, mass_kg \n1.5, 13.0 \n",
            True,
            [case_at(238.0, projectile={**case_at(238.0)["projectile"], "nose": CONE})],
        ),
        ("upper_deg,search.lower_deg\n70,30\n", True, [case_at(238.0, search={"lower_deg": 30.0, "upper_deg": 70.0})]),
        ("#,velocity\n1,238\n2,240\n", True, [case_at(238.0, custom_id="1"), case_at(240.0, custom_id="2")]),
        ("# ;velocity;free_surface.model\n1;238;None\n", True, [case_at(238.0, custom_id="1", resistance=NONE)]),
        ("No.;velocity\n7;238\n", True, [case_at(238.0, custom_id="7")]),
        (
            "id,velocity,free_surface.model\n#1,238,\n# a note, of two parts\n#2,240,None\n",
            True,
            [case_at(238.0, custom_id="#1"), case_at(240.0, custom_id="#2", resistance=NONE)],
        ),
    ],
)
def test_each_row_is_a_case(
    served: Path, capsys: pytest.CaptureFixture[str], table: str, base: bool, cases: list[dict[str, Any]]
) -> None:
    (served / "cases.csv").write_text(table, newline="")
    write_cases(served / "cases.jsonl", *cases)
    assert cli.main(["batch", "cases.csv", *(["--case", "strike.toml"] if base else []), "--json"]) == 0
    found = capsys.readouterr().out
    assert cli.main(["batch", "cases.jsonl", "--json"]) == 0
    assert [json.loads(line) for line in found.splitlines()] == [
        json.loads(line) for line in capsys.readouterr().out.splitlines()
    ]


def with_speed(header: str, cell: str, *, unit: str = "") -> str:
    """Return a table of one case with this header and cell for its speed, optionally with a line of units."""
    units = f"{unit},,,,,,\n" if unit else ""
    return f"{header},crh,diameter_m,length_m,mass_kg,fc_MPa,rho\n{units}{cell},3,0.08,0.53,13,39,2250\n"


@pytest.mark.parametrize(
    "table",
    [
        with_speed("velocity", "238"),
        with_speed("velocity [m/s]", "238"),
        with_speed("Speed (m/s)", "238"),
        with_speed("v0 [km/s]", "0.238"),
        with_speed("impact speed [mm/ms]", "238"),
        with_speed("velocity_km_s", "0.238"),
        with_speed("Velocity", "0.238", unit="km/s"),
        with_speed("Velocity", "238", unit="[m/s]"),
        "Speed (m/s);CRH;Diameter (mm);Length [cm];Mass (g);f'c [N/mm²];Density [g/cm³]\n238;3;80;53;13000;39;2.25\n",
        "# May\nspeed\tpsi\tcalibre\tlength\tweight\tstrength [GPa]\trho\n238\t3\t0.08\t0.53\t13\t0.039\t2250\n",
        "V [m/s];ψ;D [mm];L [mm];m [kg];f_c [MPa];;ρ [kg/m³]\n238;3;80;530;13;39;;2250\n",
        with_speed("Speed (m/s)", "238").replace("crh", "CRH,Nose").replace(",3,", ",3,Ogive,"),
    ],
)
def test_usual_spellings_of_headers_are_accepted(served: Path, capsys: pytest.CaptureFixture[str], table: str) -> None:
    (served / "cases.csv").write_text(table)
    write_cases(served / "cases.jsonl", case_at(238.0))
    assert cli.main(["batch", "cases.csv", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert cli.main(["batch", "cases.jsonl", "--json"]) == 0
    assert found["result"]["key"] == json.loads(capsys.readouterr().out)["result"]["key"]


@pytest.mark.parametrize(
    ("table", "reasons"),
    [
        (
            "velocty_m_s\n238\n",
            ["cases.csv:1: column 'velocty_m_s': is no field of a case, did you mean impact.velocity_m_s?"],
        ),
        (
            "velocty_m_s,colour,speed (furlong),mass,weight\n238,red,1,13,13\n",
            [
                "'velocty_m_s': is no field of a case, did you mean impact.velocity_m_s?; column 'colour'",
                "column 'speed (furlong)': unknown unit of impact.velocity_m_s, known are m_s, km_s",
                "column 'weight' gives projectile.mass_kg as 'mass' does",
                "--keep HEADER only copies a column to the output",
                "\nfields of a case: custom_id, impact.angle_of_attack_deg, ",
            ],
        ),
        ("angle\n30\n", ["cases.csv:1: column 'angle': is computed by the search; --keep HEADER only copies"]),
        ("velocity,,mass\n238,3,13\n", ["cases.csv:1: column without a name: has cells; --keep"]),
        ("velocity;mass\n238;13\n;13\n", ["cases.csv:3: velocity: the cell is empty\n"]),
        (
            "velocity,mass\n238,0.01\n-1,13\n",
            [
                "cases.csv: /impact/oblique_angle_deg: is missing in every row; add a column for it",
                "cases.csv:3: velocity:",
            ],
        ),
        (WHOLE + "8,0.08,0.53,13,3,39e6,2250,\n", ["cases.csv:3: velocity_m_s: the cell is empty\n"]),
        ("velocity;Nose shape\n238;Cube\n", ["cases.csv:2: Nose shape: must be one of 'ogive', ", "got 'cube'\n"]),
        ("model\nnone\n", ["must be one of resistance.free_surface.model, resistance.strength_factor.model"]),
        ("velocity_m_s\n238,5\n", ["cases.csv:2: the line has 2 cells, the header 1"]),
        (
            "velocity_m_s;mass_kg\n238;13\n238,5;13\n-1;-2\n",
            [
                "cases.csv:3: velocity_m_s: must be a number, got '238,5'; write decimals with a point\n",
                "cases.csv:4: velocity_m_s: must be 0.1 to 10,000 m/s, got -1 m/s\n",
                "cases.csv:4: mass_kg: must be ",
                "\n--skip-bad computes the others\n",
            ],
        ),
        ("velocity_m_s\n\n238\n-1\n", ["cases.csv:4: velocity_m_s: must be "]),
        ("Length (mm)\n50\n", ["cases.csv:2: Length (mm): must be at least the length of the nose"]),
        (
            "nose.shape,caliber_radius_head\nconical,3\n",
            ["cases.csv:2: caliber_radius_head: is of ogive or spherical, not of conical"],
        ),
        ("velocity_m_s\n" + "-1\n" * 60, ["cases.csv:51: velocity_m_s", "\nand 10 more\n"]),
        ("", ["cases.csv: the file is empty"]),
        ("velocity_m_s\n", ["cases.csv:1: there are no rows below the header"]),
    ],
)
def test_errors_in_a_table_name_the_line_and_the_column(
    served: Path, capsys: pytest.CaptureFixture[str], table: str, reasons: list[str]
) -> None:
    (served / "cases.csv").write_text(table)
    operation = ["--operation", "trajectory"] if "oblique_angle" in reasons[0] else []
    assert cli.main(["batch", "cases.csv", "--case", "strike.toml", *operation]) == 2
    error = capsys.readouterr().err
    assert [reason for reason in reasons if reason not in error] == []


MIXED = """id,name,Speed (m/s),Length (mm),remark
a,first,238,530,=1+1
b,second,-238,530,too slow
c,third,238,50,
d,fourth,250,530,fine
"""


def test_valid_rows_are_computed_and_other_rows_have_their_error(
    served: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Outputs in CSV and Excel also contain every cell of the input; JSON lines are in the order of the rows."""
    (served / "cases.csv").write_text(MIXED)
    command = ["batch", "cases.csv", "--case", "strike.toml", "--keep", "remark", "--skip-bad"]
    assert cli.main([*command, "-o", "out.csv"]) == 3
    assert capsys.readouterr().err == "4 cases, 2 of them with a problem\n"
    rows = list(csv.DictReader((served / "out.csv").read_text().splitlines()))
    assert [(row["index"], row["id"], row["name"], row["Speed (m/s)"]) for row in rows] == [
        ("0", "a", "first", "238"),
        ("1", "b", "second", "-238"),
        ("2", "c", "third", "238"),
        ("3", "d", "fourth", "250"),
    ]
    assert [bool(row["critical_angle_deg"]) for row in rows] == [True, False, False, True]
    assert rows[0]["remark"] == "'=1+1"  # The apostrophe keeps spreadsheets from evaluating the cell.
    assert rows[1]["error"] == "Speed (m/s): must be 0.1 to 10,000 m/s, got -238 m/s"
    assert rows[2]["error"].startswith("Length (mm): must be at least the length of the nose")
    assert cli.main([*command, "-o", "out.xlsx"]) == 3
    sheet = load_workbook(served / "out.xlsx").worksheets[0]
    header, *cells = ([cell.value for cell in row] for row in sheet.rows)
    assert header == list(rows[0])
    assert [row[1] for row in cells] == ["a", "b", "c", "d"]
    column = header.index("critical_angle_deg")
    assert [str(row[column] or "") for row in cells] == [row["critical_angle_deg"] for row in rows]
    assert cli.main([*command, "--json"]) == 3
    items = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(item["index"], item["custom_id"], "problem" in item) for item in items] == [
        (0, "a", False),
        (1, "b", True),
        (2, "c", True),
        (3, "d", False),
    ]


def test_workbook_is_read_as_the_table_it_shows(served: Path, capsys: pytest.CaptureFixture[str]) -> None:
    book = Workbook()
    for row in csv.reader(MIXED.splitlines()):
        book.worksheets[0].append([row[0], row[1], float(row[2]) if row[2][-1:].isdigit() else row[2], *row[3:4]])
    book.save(served / "cases.xlsx")
    assert cli.main(["batch", "cases.xlsx", "--case", "strike.toml"]) == 2
    assert "cases.xlsx:3: Speed (m/s): must be 0.1 to 10,000 m/s, got -238 m/s\n" in capsys.readouterr().err
    (served / "cases.xlsx").write_bytes(b"PK no workbook")
    assert cli.main(["batch", "cases.xlsx", "--case", "strike.toml"]) == 2
    assert "cases.xlsx: not an Excel workbook" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "begin"),
    [
        ("batch cases.xlsx", "ricochet batch: cases.xlsx: an Excel workbook needs openpyxl"),
        ("batch cases.jsonl -o angles.xlsx", "ricochet batch: --output angles.xlsx needs openpyxl"),
        ("init --table cases.xlsx", "ricochet init: --table cases.xlsx needs openpyxl"),
    ],
)
def test_missing_package_for_excel_names_the_extra(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: str, begin: str
) -> None:
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    (here / "cases.jsonl").write_text(json.dumps(case_at(238.0)))
    assert cli.main(words.split()) in {1, 2}
    error = capsys.readouterr().err
    assert error.startswith(begin)
    assert "[excel]" in error
    assert not (here / "angles.xlsx").exists()


def test_every_invalid_line_is_named_and_can_be_skipped(served: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = case_at(238.0), json.dumps(case_at(-1.0))
    (served / "cases.jsonl").write_text(f"{bad}\n{json.dumps(good)}\noops\n{bad}\n")
    assert cli.main(["batch", "cases.jsonl"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(": /")[0].partition(": not")[0] for line in lines] == [
        "ricochet batch: cases.jsonl:1",
        "cases.jsonl:3",
        "cases.jsonl:4",
        "--skip-bad computes the others",
    ]
    assert cli.main(["batch", "cases.jsonl", "--skip-bad"]) == 3
    items = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(item["index"], "result" in item) for item in items] == [(0, False), (1, True), (2, False), (3, False)]


@pytest.mark.parametrize(
    ("name", "text", "reasons"),
    [
        ("cases.csv", "v;name\n-1;a\n;b\n", ["cases.csv:2: v: must be 0.1 to ", "cases.csv:3: v: the cell is empty"]),
        ("cases.jsonl", "{}\noops\n", ["cases.jsonl:1: /projectile: is missing", "cases.jsonl:2: not JSON"]),
    ],
)
def test_table_without_a_valid_row_is_refused_although_rows_may_be_skipped(
    served: Path, capsys: pytest.CaptureFixture[str], name: str, text: str, reasons: list[str]
) -> None:
    (served / name).write_text(text)
    case = ["--case", "strike.toml"] if name.endswith(".csv") else []
    assert cli.main(["batch", name, *case, "--skip-bad"]) == 2
    error = capsys.readouterr().err
    assert [reason for reason in reasons if reason not in error] == []


def test_tables_of_walls_omit_the_quantity_searched_for(served: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (served / "cases.csv").write_text("oblique_angle_deg,relative_tolerance\n0,1e-3\n20,1e-3\n")
    words = ["batch", "cases.csv", "--operation", "thickness", "--case", "strike.toml", "--csv"]
    assert cli.main(words) == 0
    assert capsys.readouterr().out.count("converged") == 2


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (
            "a.jsonl --case strike.toml",
            "--case: goes with a table of cases, .csv, .tsv or .xlsx; a.jsonl is read",
        ),
        (
            "cases.txt --keep remark",
            "--keep: goes with a table of cases, .csv, .tsv or .xlsx; cases.txt is read as JSON",
        ),
        ("cases.xls", "cases.xls: is a table of a kind that is not read; save it as .xlsx or .csv"),
        ("cases.ods --case strike.toml", "cases.ods: is a table of a kind that is not read; save it as .xlsx or .csv"),
    ],
)
def test_table_is_recognized_by_its_file_name(
    here: Path, capsys: pytest.CaptureFixture[str], words: str, reason: str
) -> None:
    assert cli.main(["batch", *words.split()]) == 2
    assert capsys.readouterr().err.startswith(f"ricochet batch: {reason}")
