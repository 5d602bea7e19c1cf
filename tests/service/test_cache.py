"""Results on disk and in memory, with real files and real trouble."""

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import orjson
import pytest

from service.cache import NOT_CACHED, ResultCache
from service.hdf5 import BLOCK, DESCRIPTIONS, from_hdf5, to_hdf5
from service.record import Record
from service.schemas.answers import MotionState, Trial

pytestmark = pytest.mark.timeout(60)

WRITER = Path(__file__).with_name("cache_writer.py")
COLUMNS = list(DESCRIPTIONS)[:12]
MEGABYTE = 1_000_000


def trajectory(number: int = 0, rows: int = 313) -> Record:
    values = np.random.default_rng(number)
    return Record(
        key=f"{number:064x}",
        operation="trajectory",
        request={"projectile": {"nose": {"shape": "ogive"}, "diameter_m": 0.08}, "impact": {"velocity_m_s": 238.0}},
        answer={
            "outcome": "ricochet",
            "maximum_depth_m": 0.1 + 0.2,
            "final": dict(zip(COLUMNS, values.normal(size=12).tolist(), strict=True)),
            "warnings": [{"code": "strength_fit_range", "detail": "used at 55°"}],
        },
        history={name: values.normal(size=rows) for name in COLUMNS},
        engine_version="1",
        schema_version="2",
    )


def critical_angle() -> Record:
    trial = {"oblique_angle_deg": 45.0, "final_position_m": 0.3, "outcome": "embedded"}
    return Record(
        key="c" * 64,
        operation="cra",
        request={"search": {"method": "outcome"}},
        answer={
            "status": "converged",
            "critical_angle_deg": 48.57,
            "iterations": [trial, {**trial, "oblique_angle_deg": 50.0, "outcome": "ricochet"}],
            "trajectory": {"outcome": "ricochet", "final": {"time_s": 0.004}},
            "warnings": [],
        },
        history={"time_s": np.linspace(0.0, 0.004, 5)},
        engine_version="1",
        schema_version="2",
    )


def cache_in(folder: Path) -> ResultCache:
    return ResultCache(folder, memory_bytes=50 * MEGABYTE)


def path_of(record: Record, folder: Path) -> Path:
    return folder / "results" / record.key[:2] / f"{record.key}.h5"


def files_in(folder: Path) -> list[str]:
    """Names of all files; a folder may vanish meanwhile, which `Path.rglob` does not take."""
    return sorted(name for _, _, names in os.walk(folder) for name in names)


@pytest.mark.parametrize("record", [trajectory(), critical_angle()], ids=["trajectory", "cra"])
def test_record_read_from_disk_is_the_one_written_bit_for_bit(record: Record, tmp_path: Path) -> None:
    cache_in(tmp_path).put(record)
    found = cache_in(tmp_path).get(record.key)
    assert found is not None
    assert found.json == record.json
    assert found.request == record.request
    assert found.history is not None
    assert record.history is not None
    assert all(np.array_equal(found.history[name], column) for name, column in record.history.items())
    assert files_in(tmp_path) == [f"{record.key}.h5"]
    assert to_hdf5(found) == path_of(record, tmp_path).read_bytes()


def test_json_holds_the_history_where_the_contract_has_it() -> None:
    run, search = trajectory(), critical_angle()
    assert run.history is not None
    assert orjson.loads(run.json)["history"]["time_s"] == run.history["time_s"].tolist()
    assert orjson.loads(run.json)["key"] == run.key
    assert orjson.loads(search.json)["trajectory"]["history"]["time_s"] == [0.0, 0.001, 0.002, 0.003, 0.004]


def test_file_explains_itself_to_someone_who_opens_it(tmp_path: Path) -> None:
    record = critical_angle()
    cache_in(tmp_path).put(record)
    with h5py.File(path_of(record, tmp_path)) as file:
        assert file.attrs["operation"] == "cra"
        assert file.attrs["engine_version"] == "1"
        assert orjson.loads(file["request"][()]) == record.request
        assert all(dataset.attrs["description"] for dataset in file.values())
        assert set(file) == {"request", "answer", "summary", "final", "iterations", "history"}
        trials = file["iterations"]
        assert trials["oblique_angle_deg"].tolist() == [45.0, 50.0]
        assert trials["outcome"].tolist() == [b"embedded", b"ricochet"]
        assert trials.dtype.names == ("oblique_angle_deg", "final_position_m", "outcome")
        assert trials.attrs["column_units"].tolist() == [b"deg", b"m", b""]
    run = trajectory()
    cache_in(tmp_path).put(run)
    with h5py.File(path_of(run, tmp_path)) as file:
        units = [unit.decode() for unit in file["history"].attrs["column_units"]]
        assert units == ["s", "m", "m", "m", "deg", "m/s", "m/s", "rad/s", "N", "N", "N m", "J"]
        assert all(file["history"].attrs["column_descriptions"])


def test_every_column_the_contract_knows_has_its_description() -> None:
    named = {
        *MotionState.model_fields,
        *Trial.model_fields,
        "outcome",
        "maximum_depth_m",
        "status",
        "critical_angle_deg",
    }
    assert named == set(DESCRIPTIONS)


def test_any_damage_is_a_miss_set_aside_and_written_anew(tmp_path: Path) -> None:
    record = trajectory()
    cache_in(tmp_path).put(record)
    path, good = path_of(record, tmp_path), to_hdf5(record)
    places = random.Random(0).sample(range(len(good)), 60)  # noqa: S311
    flipped = [
        good[:i] + bytes([good[i] ^ 1 << i % 8]) + good[i + 1 :] for i in [0, BLOCK - 1, BLOCK, *places, len(good) - 1]
    ]
    shortened = [good[:i] for i in (0, 1, BLOCK, len(good) // 2, len(good) - 1)]
    for bad in [*flipped, *shortened, good + b"\0", bytes(len(good))]:
        path.write_bytes(bad)
        cache = cache_in(tmp_path)
        assert cache.get(record.key) is None
        assert not path.exists()
        assert (tmp_path / "damaged" / path.name).read_bytes() == bad
        cache.put(record)
        assert cache_in(tmp_path).get(record.key) is not None


def test_result_under_the_name_of_another_is_a_miss(tmp_path: Path) -> None:
    cache_in(tmp_path).put(trajectory(1))
    wrong = path_of(trajectory(2), tmp_path)
    path_of(trajectory(1), tmp_path).rename(wrong)
    assert cache_in(tmp_path).get(trajectory(2).key) is None
    assert not wrong.exists()


@pytest.mark.parametrize("key", ["", "../../../etc/passwd", "A" * 64, "0" * 63, "0" * 64 + "\n", "f" * 64])
def test_unknown_or_malformed_key_is_a_miss(key: str, tmp_path: Path) -> None:
    assert cache_in(tmp_path).get(key) is None


def test_folder_that_cannot_be_written_costs_the_store_but_no_answer(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("a file where the folder should be")
    cache = cache_in(tmp_path)
    assert not cache.writable()
    assert cache.trouble
    answered = cache.put(trajectory())
    assert [warning["code"] for warning in answered.answer["warnings"]] == ["strength_fit_range", NOT_CACHED]
    assert str(tmp_path) not in answered.json.decode()
    assert cache.recall(answered.key) is answered
    (tmp_path / "results").unlink()
    assert cache.writable()
    assert cache.trouble is None
    assert cache.put(trajectory(1)).answer["warnings"] == trajectory(1).answer["warnings"]


def test_write_that_the_system_cuts_short_leaves_nothing_and_what_was_there(tmp_path: Path) -> None:
    cache = cache_in(tmp_path)
    old, new = cache.put(trajectory(1)), trajectory(2)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        answers = [cache.put(old), cache.put(new)]
        assert not cache.writable()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [answer.answer["warnings"][-1]["code"] for answer in answers] == [NOT_CACHED, NOT_CACHED]
    assert files_in(tmp_path) == [f"{old.key}.h5"]
    assert cache_in(tmp_path).get(old.key) is not None
    assert cache.get(new.key) is answers[1]


def test_writer_killed_at_any_instant_leaves_whole_files_only(tmp_path: Path) -> None:
    for _ in range(5):
        written = len(files_in(tmp_path))
        with subprocess.Popen([sys.executable, str(WRITER), str(tmp_path)]) as writer:
            while len(files_in(tmp_path / "results")) < written + 20:
                time.sleep(0.005)
            writer.send_signal(signal.SIGKILL)
    cache_in(tmp_path)  # sweeps
    paths = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(paths) >= 100
    assert all(from_hdf5(path.read_bytes()).key == path.stem for path in paths)


def test_start_sweeps_what_a_crash_left(tmp_path: Path) -> None:
    cache_in(tmp_path).put(trajectory())
    (tmp_path / "results" / ".partial" / "left-over").write_bytes(b"half a result")
    cache = cache_in(tmp_path)
    assert files_in(tmp_path) == [f"{trajectory().key}.h5"]
    assert cache.get(trajectory().key) is not None


def test_memory_is_bounded_and_holds_the_latest(tmp_path: Path) -> None:
    one = trajectory(rows=1000)
    cache = ResultCache(tmp_path, memory_bytes=10 * one.nbytes + one.nbytes // 2)
    for number in range(50):
        cache.put(trajectory(number, rows=1000))
        cache.recall(trajectory(0).key)  # in use all the time
    kept = [number for number in range(50) if cache.recall(trajectory(number).key)]
    assert kept == [0, *range(41, 50)]
    cache.put(trajectory(99, rows=20_000))  # does not fit at all, and pushes nothing out
    assert len([number for number in range(50) if cache.recall(trajectory(number).key)]) == 10


def test_memory_said_to_be_used_is_about_what_is_used() -> None:
    record = trajectory(rows=5000)
    assert record.history is not None
    arrays = sum(column.nbytes for column in record.history.values())
    assert len(record.json) + arrays <= record.nbytes < 1.05 * (len(record.json) + arrays) + 20_000


def test_hot_result_needs_no_disk(tmp_path: Path) -> None:
    cache = cache_in(tmp_path)
    record = cache.put(trajectory())
    shutil.rmtree(tmp_path)
    assert cache.recall(record.key) is record
    assert cache.get(record.key) is record


def test_many_threads_may_read_and_write_at_once(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path, memory_bytes=MEGABYTE)

    def put_and_get(number: int) -> bool:
        cache.put(trajectory(number % 20))
        found = cache.get(trajectory((number * 7) % 20).key)
        return found is None or found.json == trajectory((number * 7) % 20).json

    with ThreadPoolExecutor(8) as threads:
        assert all(threads.map(put_and_get, range(200)))
    assert cache.trouble is None
    assert len(files_in(tmp_path)) == 20
