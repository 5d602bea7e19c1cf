import csv
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.reports import style
from validation.__main__ import main
from validation.reference import MESHES, finite_element_runs, penetration_tests, table_1
from validation.report import Comparison, Figure, ReportTable, Section, paragraphs, stack, write_report


def comparison(*, ours: float, reference: float | None = 8.5, tolerance: float | None = 0.1) -> Comparison:
    return Comparison(
        what="S", ours=ours, reference=reference, unit="1", tolerance=tolerance, reference_source="somewhere"
    )


def sections() -> Iterator[Section]:
    for number in (1, 2):
        drawing, (left, right) = style.panels(2, height=2.0)
        left.plot([0.0, 1.0], [0.0, number], label="a < b")
        right.plot([0.0, 1.0], [1.0, 0.0])
        left.legend()
        yield Section(
            title=f"Part {number}: S < 9 & more",
            text=["A `flag`, **strong**, and <b>none of it</b>."],
            comparisons=[comparison(ours=8.44), comparison(ours=8.7), comparison(ours=8.4, reference=None)],
            tables=[
                ReportTable(name=f"rows-{number}", caption="Rows", columns=["a", "b"], rows=[["x", 1.5], ["y", None]])
            ],
            figures=[
                Figure(
                    name=f"lines-{number}", caption="Lines", figure=drawing, data={"x": [0.0, 1.0], "y": [0, number]}
                )
            ],
        )


def write(folder: Path) -> Path:
    return write_report(folder, title="A report", introduction=["An introduction."], sections=sections())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("report")).parent


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    return (folder / "index.html").read_text(encoding="utf-8")


def test_validation_page_requests_no_other_file(page: str) -> None:
    assert not re.search(r"https?://|<script|@import|url\(", page)
    assert all(address.startswith("#") for address in re.findall(r'href="([^"]*)"', page))
    assert all(address.startswith("data:image/svg+xml;base64,") for address in re.findall(r'src="([^"]*)"', page))


def test_every_entry_of_the_contents_links_to_a_heading(page: str) -> None:
    targets = re.findall(r'href="#([^"]*)"', page)
    assert targets == re.findall(r'<h2 id="([^"]*)"', page)
    assert len(set(re.findall(r' id="([^"]*)"', page))) == len(re.findall(r' id="', page))


def test_markup_of_texts_is_limited_to_code_and_strong(page: str) -> None:
    assert "A <code>flag</code>, <strong>strong</strong>, and &lt;b&gt;none of it&lt;/b&gt;." in page
    assert "Part 1: S &lt; 9 &amp; more" in page


def test_page_states_how_many_numbers_are_within_their_tolerance(page: str) -> None:
    assert "2 of 4 numbers with a tolerance are within it." in page
    assert page.count(">not printed<") == 2


def test_each_figure_is_written_as_png_svg_and_csv(folder: Path) -> None:
    for number in (1, 2):
        picture = folder / "figures" / f"lines-{number}"
        assert picture.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
        assert b"<svg" in picture.with_suffix(".svg").read_bytes()
        assert picture.with_suffix(".csv").read_text() == f"x,y\n0,0\n1,{number}\n"


def test_each_table_is_written_as_csv(folder: Path) -> None:
    assert (folder / "tables" / "rows-2.csv").read_text() == "a,b\nx,1.5\ny,\n"


def test_comparisons_are_written_with_difference_and_verdict(folder: Path) -> None:
    with (folder / "comparisons.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["holds"] for row in rows] == ["yes", "no", ""] * 2
    assert [row["difference"] for row in rows] == ["-0.06", "0.2", ""] * 2
    assert {row["section"] for row in rows} == {"Part 1: S < 9 & more", "Part 2: S < 9 & more"}


def test_report_written_twice_has_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    write(tmp_path)
    for path in folder.rglob("*.*"):
        assert path.read_bytes() == (tmp_path / path.relative_to(folder)).read_bytes(), path.name


@pytest.mark.parametrize(("ours", "holds"), [(8.4, True), (8.6, True), (8.39, False), (8.61, False)])
def test_tolerance_is_symmetric_and_inclusive(ours: float, holds: bool) -> None:
    assert comparison(ours=ours).holds is holds


def test_row_without_reference_or_tolerance_has_no_verdict() -> None:
    assert comparison(ours=8.4, reference=None).holds is None
    assert comparison(ours=8.4, tolerance=None).holds is None


def test_columns_of_unequal_length_are_refused(tmp_path: Path) -> None:
    drawing, _ = style.panels(1)
    figure = Figure(name="torn", caption="", figure=drawing, data={"x": [1.0, 2.0], "y": [1.0]})
    with pytest.raises(ValueError, match="zip"):
        write_report(tmp_path, title="", introduction=[], sections=[Section(title="", text=[], figures=[figure])])


def test_stacked_series_keep_rows_together_and_leave_missing_columns_empty() -> None:
    stacked = stack("series", {"a": {"x": [1, 2], "y": [3, 4]}, "b": {"x": [5], "z": [6]}})
    assert stacked == {"series": ["a", "a", "b"], "x": [1, 2, 5], "y": [3, 4, ""], "z": ["", "", 6]}


def test_paragraphs_are_split_only_at_blank_lines() -> None:
    assert paragraphs("\n  one\n  two\n\n  three\n") == ["one two", "three"]


def test_reference_data_is_complete() -> None:
    assert [shot.depth for shot in table_1()] == [0.30, 0.38, 0.45, 0.53]
    assert len(penetration_tests()) == 55
    runs = [run for mesh in MESHES for run in finite_element_runs(mesh)]
    assert len(runs) == 11 + 6
    away = ["oblique-50", "oblique-52", "oblique-55", "fine-oblique-48", "fine-oblique-50"]
    assert [run.name for run in runs if run.outcome == "ricochet"] == away
    assert all(run.time[0] == run.depth_displacement[0] == run.rotation[0] == 0.0 for run in runs)


@pytest.mark.parametrize("name", ["reproduce", "validate"])
def test_folder_that_cannot_be_made_is_named(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert main([name, "--output", str(tmp_path / "file" / "report")]) == 1
    assert f"'{tmp_path / 'file' / 'report'}" in capsys.readouterr().err
