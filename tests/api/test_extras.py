"""Without the packages of an extra, messages name the extra, and everything that does not need it works."""

from pathlib import Path

import httpx
import pytest

from service.schemas.strike import PAPER
from tests.cli.commands import run_process
from tests.conftest import ROOT, RunService

from .many import ASYNC, finished

PARQUET = {"Accept": "application/vnd.apache.parquet"}


@pytest.fixture
def bare_path(tmp_path: Path) -> str:
    """Value of PYTHONPATH with which the packages of the extras cannot be imported."""
    text = "import sys\nsys.modules['mcp'] = sys.modules['pyarrow'] = None\n"
    (tmp_path / "sitecustomize.py").write_text(text)
    return f"{tmp_path}:{ROOT}"


def test_service_without_extras_refuses_only_what_needs_them(
    service_on: RunService,
    tmp_path: Path,
    bare_path: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PYTHONPATH", bare_path)
    with (
        service_on(tmp_path, executor="in-process") as service,
        httpx.Client(base_url=service.url, timeout=180.0, trust_env=False) as client,
    ):
        job = finished(client, client.post("/cra/batch", json={"cases": [PAPER]}, headers=ASYNC).json())
        refused = client.get(job["links"]["results"], headers=PARQUET)
        assert refused.status_code == 406
        assert (
            "Parquet needs pyarrow, which is not installed: install the extra parquet from the wheel"
            in refused.json()["detail"]
        )
        either = {"Accept": f"{PARQUET['Accept']}, text/csv;q=0.5"}
        table = client.get(job["links"]["results"], headers=either)
        assert table.headers["Content-Type"].startswith("text/csv")
        assert client.post("/mcp", json={"jsonrpc": "2.0", "id": 1, "method": "ping"}).status_code == 404


def test_command_without_the_sdk_names_the_extra(tmp_path: Path, bare_path: str) -> None:
    done = run_process(tmp_path, "mcp", PYTHONPATH=bare_path)
    assert (done.status, done.out) == (1, "")
    assert "needs the package mcp, which is not installed: install the extra mcp from the wheel" in done.err
    assert "Traceback" not in done.err
