"""The files of results: what they hold, and that nothing damaged gets through."""

import io
import random
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import orjson
import pytest

from service.cache.hdf5 import BLOCK, BatchFile, check, read_keys, to_hdf5
from service.cache.record import CaseResult, Record
from service.cache.tables import trial_table_columns
from service.errors import DamagedFileError
from service.operations import OPERATIONS
from service.schemas.answers import Exit, MotionState, Trial
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
def test_what_is_read_is_what_was_written_bit_for_bit(records: list[Record]) -> None:
    content = to_hdf5(*records)
    assert all(same(read, record) for read, record in zip(read_records(content), records, strict=True))
    assert read_keys(content) == [record.key for record in records]
    last = len(records) - 1
    assert same(read_records(content, [last])[0], records[last])
    assert to_hdf5(*read_records(content)) == content


@pytest.mark.parametrize("records", KINDS)
def test_json_of_a_stored_result_needs_no_parsing_and_is_the_same(records: list[Record]) -> None:
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


def test_hdf5_library_reads_what_was_compressed_without_it() -> None:
    records = [trajectory(number, rows=100 * number + 1) for number in range(4)]
    with opened(to_hdf5(*records)) as file:
        history = file["history"][()]
        for row, record in enumerate(records):
            own = history[history["case"] == row]
            assert all(np.array_equal(own[name], column) for name, column in (record.history or {}).items())
        assert [orjson.loads(line) for line in file["requests"][()].tobytes().splitlines()] == [
            record.request for record in records
        ]
        assert file["summary"]["key"].astype(str).tolist() == [record.key for record in records]
        assert file["summary"]["maximum_depth_m"].tolist() == [0.1 + 0.2] * 4
        assert file["summary"]["final_time_s"].tolist() == [record.answer["final"]["time_s"] for record in records]


def test_file_explains_itself_to_someone_who_opens_it() -> None:
    record = critical_angle()
    with opened(to_hdf5(record, without_angle())) as file:
        assert file.attrs["title"] == b"ricochet results"
        assert set(file) == {"summary", "requests", "answers", "iterations"}
        assert all(dataset.attrs["description"] for dataset in file.values())
        assert file["answers"][()].tobytes().splitlines()[0] == record.answer_json
        trials, summary = file["iterations"], file["summary"]
        assert trials.dtype.names == ("case", "oblique_angle_deg", "final_position_m", "outcome", "fine")
        assert trials["final_position_m"].tolist() == [t["final_position_m"] for t in record.answer["iterations"]]
        assert set(trials["outcome"].tolist()) == {b"embedded", b"ricochet"}
        assert trials.attrs["column_units"].tolist() == [b"", b"deg", b"m", b"", b""]
        assert all(trials.attrs["column_descriptions"])
        assert summary["status"].tolist() == [b"converged", b"no_ricochet"]
        assert summary["bracket_high_deg"][0] == record.answer["bracket_deg"][1]
        assert np.isnan(summary["critical_angle_deg"][1])
        assert summary["warnings"].tolist() == [b"strength_fit_range second", b""]
        assert summary["engine_version"].tolist() == [b"1", b"1"]
    with opened(to_hdf5(trajectory())) as file:
        units = file["history"].attrs["column_units"].astype(str).tolist()
        assert units == ["", "s", "m", "m", "m", "deg", "m/s", "m/s", "rad/s", "N", "N", "N m", "J"]
        assert all(file["history"].attrs["column_descriptions"])


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
        "strength_factor",
        *(f"final_{name}" for name in MotionState.model_fields),
        *(f"exit_{name}" for name in Exit.model_fields),
    }


def test_any_damage_is_found() -> None:
    good = to_hdf5(trajectory())
    check(good)
    places = random.Random(0).sample(range(len(good)), 60)  # noqa: S311
    flipped = [
        good[:i] + bytes([good[i] ^ 1 << i % 8]) + good[i + 1 :] for i in [0, BLOCK - 1, BLOCK, *places, len(good) - 1]
    ]
    shortened = [good[:i] for i in (0, 1, BLOCK, len(good) // 2, len(good) - 1)]
    readers: list[Callable[[bytes], object]] = [check, read_keys, read_records]
    for bad in [*flipped, *shortened, good + b"\0", bytes(len(good))]:
        for read in readers:
            with pytest.raises(DamagedFileError):
                read(bad)


def test_row_that_is_not_there_is_damage() -> None:
    with pytest.raises(DamagedFileError):
        read_records(to_hdf5(critical_angle()), [1])


def test_text_too_long_for_its_column_is_refused_rather_than_cut() -> None:
    with pytest.raises(ValueError, match="engine_version"):
        to_hdf5(made(key_of(0), "cra", {}, {}, engine_version="1" * 33))


def test_critical_angles_in_chunks_take_about_a_kilobyte_each() -> None:
    assert len(to_hdf5(*map(critical_angle, range(100)))) < 100 * 1100
    assert len(to_hdf5(critical_angle())) < 8000


def test_batch_written_by_slices_is_whole_and_sealed(tmp_path: Path) -> None:
    path, problem = tmp_path / "batch.h5", {"type": "/problems/timeout", "title": "Too long", "status": 504}
    cases = [
        CaseResult(number, f"№ {number}" if number % 2 else None, critical_angle(number), None, cached=False)
        for number in range(900)
    ]
    cases[333] = CaseResult(333, None, None, problem, cached=False)
    with BatchFile(path, "cra") as batch:
        for start in range(0, 900, 70):
            batch.write(cases[start : start + 70])
    check(path.read_bytes())
    with h5py.File(path) as file:
        summary, trials = file["summary"][()], file["iterations"][()]
        answers = file["answers"][()].tobytes().splitlines()
        requests = file["requests"][()].tobytes().splitlines()
        assert file["answers"].chunks[0] < file["answers"].size, "it is in several chunks"
    assert summary["index"].tolist() == list(range(900))
    assert [name.decode() for name in summary["custom_id"].tolist()[:4]] == ["", "№ 1", "", "№ 3"]
    assert (summary["key"][333], summary["problem"][333]) == (b"", b"/problems/timeout")
    assert orjson.loads(answers[333]) == {"problem": problem}
    assert requests[333] == b"null"
    for row in (0, 332, 334, 899):
        record = critical_angle(row)
        assert summary["key"][row].decode() == record.key
        assert (answers[row], requests[row]) == (record.answer_json, record.request_json)
        own = trials[trials["case"] == row]
        assert own["final_position_m"].tolist() == [t["final_position_m"] for t in record.answer["iterations"]]


def test_histories_of_a_batch_written_by_slices_are_those_of_its_cases(tmp_path: Path) -> None:
    path = tmp_path / "batch.h5"
    records = [trajectory(number, rows=997) for number in range(30)]
    with BatchFile(path, "trajectory") as batch:
        for number, record in enumerate(records):
            batch.write([CaseResult(number, None, record, None, cached=False)])
        batch.finish()
    check(path.read_bytes())
    with h5py.File(path) as file:
        history = file["history"][()]
    assert len(history) == 30 * 997
    for name in COLUMNS:
        assert np.array_equal(history[name], np.concatenate([(record.history or {})[name] for record in records]))


def test_batch_given_up_leaves_a_file_that_nobody_takes_for_whole(tmp_path: Path) -> None:
    path = tmp_path / "batch.h5"
    with suppress(KeyboardInterrupt), BatchFile(path, "cra") as batch:
        batch.write([CaseResult(0, None, critical_angle(), None, cached=False)])
        raise KeyboardInterrupt
    with pytest.raises(DamagedFileError):
        check(path.read_bytes())
