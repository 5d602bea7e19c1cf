"""HDF5 files of results: contents, and readability by other programs."""

import io
import shutil
import subprocess
from pathlib import Path

import h5netcdf
import h5py
import numpy as np
import orjson
import pytest

from service.cache.hdf5 import BatchFile, to_hdf5
from service.cache.record import CaseResult, Record
from service.cache.segments import DecodedSegment, to_segment
from service.cache.tables import trial_table_columns
from service.errors import DamagedFileError
from service.operations import OPERATIONS
from service.schemas.answers import Bending, Exit, MotionState, Trial
from service.schemas.perforation import SpeedTrial, ThicknessTrial
from tests.service.records import (
    COLUMNS,
    critical_angle,
    critical_angle_with_motion,
    key_of,
    made,
    read_records,
    same,
    trajectory,
    without_angle,
)

KINDS = [
    pytest.param([trajectory()], id="trajectory"),
    pytest.param([critical_angle()], id="cra"),
    pytest.param([critical_angle_with_motion()], id="cra with motion"),
    pytest.param([without_angle()], id="no angle"),
    pytest.param([trajectory(number, rows=number + 1) for number in range(5)], id="trajectories"),
    pytest.param([critical_angle(2), critical_angle_with_motion(), without_angle()], id="mixed"),
]


def opened(content: bytes) -> h5py.File:
    return h5py.File(io.BytesIO(content))


@pytest.mark.parametrize("records", KINDS)
def test_results_read_back_are_identical(records: list[Record]) -> None:
    content = to_segment(*records)
    assert all(same(read, record) for read, record in zip(read_records(content), records, strict=True))
    assert DecodedSegment(content).keys == [record.key for record in records]
    last = len(records) - 1
    assert same(read_records(content, [last])[0], records[last])
    assert to_segment(*read_records(content)) == content


@pytest.mark.parametrize("records", KINDS)
def test_json_of_a_stored_result_is_returned_unparsed(records: list[Record]) -> None:
    for record in records:
        stored = Record(
            record.key,
            record.operation,
            b"{}",
            record.answer_json,
            record.history,
            engine_version=record.engine_version,
        )
        assert stored.json == record.json


def test_hdf5_file_describes_its_contents() -> None:
    record = critical_angle()
    with opened(to_hdf5(record)) as file:
        assert file.attrs["title"] == "ricochet results"
        assert set(file) == {"summary", "requests", "answers", "iterations"}
        assert all(part.attrs["description"] for part in file.values())
        assert [text.encode() for text in file["answers"].asstr()] == [record.answer_json]
        assert [text.encode() for text in file["requests"].asstr()] == [record.request_json]
        trials, summary = file["iterations"], file["summary"]
        assert set(trials) == {"case", "oblique_angle_deg", "final_position_m", "outcome", "fine"}
        for name in ("final_position_m", "oblique_angle_deg"):
            assert trials[name][()].tolist() == [trial[name] for trial in record.answer["iterations"]]
        assert set(trials["outcome"].asstr()[()]) == {"embedded", "ricochet"}
        assert {name: column.attrs["units"] for name, column in trials.items() if column.attrs["units"]} == {
            "oblique_angle_deg": "deg",
            "final_position_m": "m",
        }
        assert all(column.attrs["description"] for table in (trials, summary) for column in table.values())
        assert summary["key"].asstr()[()].tolist() == [record.key]
        assert summary["status"].asstr()[0] == "converged"
        assert summary["bracket_high_deg"][0] == record.answer["bracket_deg"][1]
        assert summary["warnings"].asstr()[0] == "strength_fit_range second"
        assert summary["engine_version"].asstr()[0] == "1"
    with opened(to_hdf5(without_angle())) as file:
        assert "iterations" not in file
        assert np.isnan(file["summary/critical_angle_deg"][0])
    motion = trajectory()
    with opened(to_hdf5(motion)) as file:
        history = file["history"]
        units = [history[name].attrs["units"] for name in COLUMNS]
        assert units == ["s", "m", "m", "m", "deg", "m/s", "m/s", "rad/s", "N", "N", "N m", "J"]
        assert all(np.array_equal(history[name][()], column) for name, column in (motion.history or {}).items())
        assert file["summary/maximum_depth_m"][()].tolist() == [0.1 + 0.2]


def test_tables_have_the_columns_of_the_contract() -> None:
    assert list(MotionState.model_fields) == COLUMNS
    for operation, model in (("cra", Trial), ("thickness", ThicknessTrial), ("limit-speed", SpeedTrial)):
        trials = trial_table_columns(OPERATIONS[operation].answer)
        assert {column.name for column in trials} == model.model_fields.keys() - {"exit", "protrusion"}
        assert all(column.description for column in trials)
    assert {column.name for column in OPERATIONS["trajectory"].columns} == {
        "outcome",
        "maximum_depth_m",
        "protrusion_final_m",
        "protrusion_greatest_m",
        *(f"bending_{name}" for name in Bending.model_fields if name != "history"),
        "strength_factor",
        *(f"final_{name}" for name in MotionState.model_fields),
        *(f"exit_{name}" for name in Exit.model_fields if name != "flight"),
        *(f"exit_flight_{name}" for name in ("range_m", "impact_speed_m_s", "farthest_range_m")),
    }


def texts_in(group: h5py.Group) -> dict[str, h5py.h5t.TypeID]:
    """Return the types of all texts in a file, in datasets and attributes, by path."""
    found: dict[str, h5py.h5t.TypeID] = {}

    def look(name: str, item: h5py.HLObject) -> None:
        kinds = {f"{name}@{attribute}": item.attrs.get_id(attribute).get_type() for attribute in item.attrs}
        if isinstance(item, h5py.Dataset):
            kinds[name] = item.id.get_type()
        found.update({place: kind for place, kind in kinds.items() if kind.get_class() == h5py.h5t.STRING})

    look("", group)
    group.visititems(look)
    return found


def written(path: Path) -> Path:
    """Write the file of a sweep with non-ASCII names, large enough for several HDF5 chunks; return its path."""
    cases = [CaseResult(number, f"№ {number}", trajectory(number, 40), None, cached=False) for number in range(200)]
    with BatchFile(path, "trajectory", axes=["impact.velocity_m_s"], base='{"note": "Köln"}') as batch:
        for start in range(0, 200, 30):
            batch.write(cases[start : start + 30], [[1.0 * start]] * 30)
    return path


@pytest.mark.parametrize("kind", ["segment", "result", "batch"])
def test_strings_are_utf_8_and_the_format_is_readable_by_old_libraries(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "file.h5"
    if kind == "batch":
        written(path)
    else:
        record = trajectory(rows=1000)
        path.write_bytes(to_segment(record) if kind == "segment" else to_hdf5(record))
    assert path.read_bytes()[:9] == b"\x89HDF\r\n\x1a\n\x00", "superblock 0, from byte 0"
    with h5py.File(path) as file:
        texts = texts_in(file)
        assert len(texts) > 6
        assert {place for place, text in texts.items() if text.get_cset() != h5py.h5t.CSET_UTF8} == set()
        assert all(dataset.dtype.names is None for dataset in file["history"].values()), "plain arrays"
        assert file["history/time_s"].compression == "gzip"
        assert file["history/time_s"].attrs["units"] == "s"


def test_other_programs_can_read_the_file(tmp_path: Path) -> None:
    path = written(tmp_path / "batch.h5")
    with h5netcdf.File(path, phony_dims="sort") as file:
        assert file.attrs["base"] == '{"note": "Köln"}'
        assert list(file["history"].variables) == ["case", *COLUMNS]
        assert "impact.velocity_m_s" in file["summary"].variables
        assert [text.decode() for text in file["summary"].variables["custom_id"][:2]] == ["№ 0", "№ 1"]
        history = file["history"].variables["depth_velocity_m_s"]
        assert history.attrs["units"] == "m/s"
        assert np.array_equal(history[:40], (trajectory(0, 40).history or {})["depth_velocity_m_s"])
    if shutil.which("h5dump"):
        command = ["h5dump", "-d", "/history/time_s", "-s", "0", "-c", "1", str(path)]
        text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        assert "H5T_IEEE_F64LE" in text
        assert "CSET H5T_CSET_UTF8" in text


def test_missing_row_counts_as_damage() -> None:
    with pytest.raises(DamagedFileError):
        read_records(to_segment(critical_angle()), [1])


@pytest.mark.parametrize("content", [b"", b"no HDF5 at all", to_hdf5(critical_angle())], ids=["empty", "text", "other"])
def test_file_that_is_not_a_segment_counts_as_damage(content: bytes) -> None:
    with pytest.raises(DamagedFileError, match="no segment of this version"):
        read_records(content)


def test_string_too_long_for_its_column_is_refused() -> None:
    with pytest.raises(ValueError, match="engine_version"):
        to_hdf5(made(key_of(0), "cra", {}, {}, engine_version="1" * 33))


def test_critical_angle_in_a_segment_takes_less_than_a_kilobyte() -> None:
    assert len(to_segment(*map(critical_angle, range(100)))) < 100 * 900
    assert len(to_segment(critical_angle())) < 10_000


def test_batch_written_in_slices_is_complete(tmp_path: Path) -> None:
    path, problem = tmp_path / "batch.h5", {"type": "/problems/timeout", "title": "Too long", "status": 504}
    cases = [
        CaseResult(number, f"№ {number}" if number % 2 else None, critical_angle(number), None, cached=False)
        for number in range(900)
    ]
    cases[333] = CaseResult(333, None, None, problem, cached=False)
    with BatchFile(path, "cra") as batch:
        for start in range(0, 900, 70):
            batch.write(cases[start : start + 70])
    with h5py.File(path) as file:
        summary, trials = ({name: column[()] for name, column in file[of].items()} for of in ("summary", "iterations"))
        answers, requests = file["answers"][()].tolist(), file["requests"][()].tolist()
        assert file["iterations/case"].chunks[0] < file["iterations/case"].size, "it is in several chunks"
    assert summary["index"].tolist() == list(range(900))
    assert [name.decode() for name in summary["custom_id"].tolist()[:4]] == ["", "№ 1", "", "№ 3"]
    assert (summary["key"][333], summary["problem"][333]) == (b"", b"/problems/timeout")
    assert orjson.loads(answers[333]) == {"problem": problem}
    assert requests[333] == b"null"
    for row in (0, 332, 334, 899):
        record = critical_angle(row)
        assert summary["key"][row].decode() == record.key
        assert (answers[row], requests[row]) == (record.answer_json, record.request_json)
        own = trials["final_position_m"][trials["case"] == row]
        assert own.tolist() == [t["final_position_m"] for t in record.answer["iterations"]]


def test_batch_written_in_slices_has_the_history_of_each_case(tmp_path: Path) -> None:
    path = tmp_path / "batch.h5"
    records = [trajectory(number, rows=997) for number in range(30)]
    with BatchFile(path, "trajectory") as batch:
        for number, record in enumerate(records):
            batch.write([CaseResult(number, None, record, None, cached=False)])
        batch.finish()
    with h5py.File(path) as file:
        history = {name: column[()] for name, column in file["history"].items()}
    assert {len(column) for column in history.values()} == {30 * 997}
    for name in COLUMNS:
        assert np.array_equal(history[name], np.concatenate([(record.history or {})[name] for record in records]))
