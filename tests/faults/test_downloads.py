"""Many clients download the results of a job at once, or disconnect: the service needs little memory, and stops a
download when its clients have left."""

import shutil
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.schemas.strike import PAPER_AT_45

from .cases import STEP_M_S, jsonl, searches
from .data_folder import SEGMENTS, keys_of, segments
from .server import JSONL, RestartableServer

HDF5, PARQUET = "application/x-hdf5", "application/vnd.apache.parquet"
CLIENTS = 24
MOST_GROWTH = 80 * 1024 * 1024
"""Largest growth of memory, enough for two readers and the data being sent. [bytes]"""
ALLOCATOR = {"MALLOC_ARENA_MAX": "2", "MALLOC_TRIM_THRESHOLD_": "131072"}
"""Settings of glibc in the image and the systemd unit. Without them, glibc keeps free memory in the heap of each
thread: a download of JSON lines took 53 to 83 MiB in six runs without them, and 24 MiB with them."""


def motions(count: int) -> bytes:
    """Return requests for trajectories with their histories as JSON lines; a result takes 32 kB in HDF5."""
    impacts = ({"velocity_m_s": 240.0 + STEP_M_S * number, "oblique_angle_deg": 50.0} for number in range(count))
    return jsonl([PAPER_AT_45 | {"impact": impact, "output": {"history": True}} for impact in impacts])


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RestartableServer]:
    with RestartableServer(tmp_path_factory.mktemp("downloads")) as server:
        server.environment |= ALLOCATOR
        server.start()
        yield server


def memory(server: RestartableServer, line: str) -> int:
    """Return a value of /proc/PID/status of the server process, e.g. for `line` "VmRSS". [bytes]"""
    status = Path(f"/proc/{server.pid}/status").read_text().splitlines()
    return next(int(text.split()[1]) * 1024 for text in status if text.startswith(line))


def download(server: RestartableServer, job: dict[str, Any], form: str) -> bytes:
    """Download the results of a job on a new connection; return them."""
    with httpx.Client(base_url=server.client.base_url, timeout=120.0, trust_env=False) as client:
        return client.get(job["links"]["results"], headers={"Accept": form}).raise_for_status().content


@pytest.mark.parametrize("form", [HDF5, PARQUET, "text/csv", JSONL])
def test_many_downloads_at_once_need_little_memory(form: str, server: RestartableServer) -> None:
    job = server.finished(server.submit(motions(300), path="/trajectory/batch"))
    server.stop()
    server.start()
    other = server.finished(server.submit(motions(1), path="/trajectory/batch"))
    download(server, other, form)  # The first download imports libraries.
    before = memory(server, "VmRSS")
    with ThreadPoolExecutor(CLIENTS) as clients:
        found = list(clients.map(lambda _: len(download(server, job, form)), range(CLIENTS)))
    assert found == [len(download(server, job, form))] * CLIENTS
    assert memory(server, "VmHWM") - before < MOST_GROWTH


@pytest.mark.parametrize("form", [HDF5, PARQUET])
def test_second_download_of_a_finished_job_reuses_the_first_file(form: str, server: RestartableServer) -> None:
    job = server.finished(server.submit(motions(20), path="/trajectory/batch"))
    first = download(server, job, form)
    shutil.rmtree(server.data / SEGMENTS)
    assert download(server, job, form) == first
    assert segments(server.data) == {}  # Nothing was computed again.
    server.client.delete(job["links"]["self"]).raise_for_status()
    assert not [path for path in (server.data / "downloads").iterdir() if job["id"] in path.name]


def test_writing_of_a_download_stops_when_its_clients_disconnect(server: RestartableServer) -> None:
    job = server.finished(server.submit(jsonl(searches(2000))))
    assert job["status"] == "successful"
    server.stop()
    server.start()
    shutil.rmtree(server.data / SEGMENTS)  # Without them the results are computed again while the file is written.
    with (
        httpx.Client(base_url=server.client.base_url, timeout=0.2, trust_env=False) as client,
        pytest.raises(httpx.ReadTimeout),
    ):
        client.get(job["links"]["results"], headers={"Accept": HDF5})
    before, computed = -1, 0
    while before < computed:
        time.sleep(1.0)
        before, computed = computed, keys_of(segments(server.data)).total()
    assert computed < 2000
    assert list((server.data / "downloads").glob("*.partial")) == []
