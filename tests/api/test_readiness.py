"""What the service says of itself when something it stands on is gone."""

import os
import signal
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from service.api.app import create_app
from service.schemas import CriticalAngleAnswer
from service.schemas.problems import Problem
from service.schemas.strike import PAPER
from service.settings import Settings

pytestmark = pytest.mark.anyio


@pytest.fixture
async def app(tmp_path: Path) -> AsyncIterator[FastAPI]:
    """A running application whose data folder cannot be made, as a file is in its place."""
    (tmp_path / "data").write_text("a file")
    app = create_app(Settings(data_dir=tmp_path / "data", workers=1, task_seconds=5.0))
    async with app.router.lifespan_context(app):
        yield app


@pytest.fixture
async def client(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://service") as client:
        yield client


def assert_unavailable(response: httpx.Response) -> Problem:
    assert response.status_code == 503
    assert int(response.headers["Retry-After"]) > 0
    return Problem.model_validate_json(response.content)


async def test_without_a_data_folder_it_answers_with_a_warning_and_is_not_ready(client: httpx.AsyncClient) -> None:
    assert "cannot be written" in assert_unavailable(await client.get("/readyz")).detail
    assert (await client.get("/livez")).is_success
    answer = CriticalAngleAnswer.model_validate_json((await client.post("/cra", json=PAPER)).content)
    assert answer.status == "converged"
    assert "result_not_cached" in {warning.code for warning in answer.warnings}


async def test_without_workers_it_is_alive_and_not_ready(app: FastAPI, client: httpx.AsyncClient) -> None:
    await app.state.services.executor.stop(1.0)
    assert "worker" in assert_unavailable(await client.get("/readyz")).detail
    assert assert_unavailable(await client.post("/cra", json=PAPER)).type == "urn:ricochet:problem:unavailable"
    assert (await client.get("/livez")).is_success


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
async def test_query_whose_worker_is_stopped_is_to_be_sent_again(app: FastAPI, client: httpx.AsyncClient) -> None:
    for pid in app.state.services.executor.worker_pids:
        os.kill(pid, signal.SIGSTOP)
    refused = assert_unavailable(await client.post("/cra", json=PAPER))
    assert refused.type == "urn:ricochet:problem:unavailable"
    assert "stopped" in refused.detail
    assert (await client.post("/cra", json=PAPER)).is_success
