"""The service gives the same answers with each executor that its settings offer; test_dask_faults.py tests Dask."""

import copy
from pathlib import Path
from typing import Literal

import httpx
import pytest

from service.api.app import create_app
from service.schemas.strike import PAPER
from service.settings import Settings

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(120)]


@pytest.mark.parametrize("executor", ["in-process", "pool"])
async def test_queries_and_batches_are_answered_by_each_executor(
    executor: Literal["in-process", "pool"], tmp_path: Path
) -> None:
    app = create_app(Settings(data_dir=tmp_path / "data", workers=1, executor=executor, probe_seconds=30.0))
    transport = httpx.ASGITransport(app)
    async with app.router.lifespan_context(app), httpx.AsyncClient(transport=transport, base_url="http://s") as client:
        assert (await client.get("/readyz")).is_success
        alone = (await client.post("/cra", json=PAPER)).raise_for_status().json()
        assert alone["critical_angle_deg"] == pytest.approx(48.635, abs=0.01)
        faster = copy.deepcopy(PAPER)
        faster["impact"]["velocity_m_s"] += 10.0
        batch = (await client.post("/cra/batch", json={"cases": [PAPER, faster]})).raise_for_status().json()
        assert batch["results"][0]["result"] == alone
        assert batch["results"][1]["result"]["status"] == "converged"
        assert 'ricochet_chunk_width{place="pool"} 1.0' in (await client.get("/metrics")).text
