"""The `ricochet` command as an operator uses it."""

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Protocol

import httpx
import pytest

from service import cli
from service.schemas.examples import PAPER_AT_45
from service.settings import Settings
from solver import ENGINE_VERSION


class Service(Protocol):
    @property
    def url(self) -> str: ...

    @property
    def process(self) -> subprocess.Popen[bytes]: ...


def test_version_names_the_engine(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["version"]) == 0
    assert f"engine {ENGINE_VERSION}" in capsys.readouterr().out


def test_settings_come_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, value in {"HOST": "0.0.0.0", "PORT": "9000", "DATA_DIR": str(tmp_path), "WORKERS": "3"}.items():  # noqa: S104
        monkeypatch.setenv(f"RICOCHET_{name}", value)
    settings = Settings()
    assert (settings.host, settings.port, settings.data_dir, settings.workers) == ("0.0.0.0", 9000, tmp_path, 3)  # noqa: S104


def test_defaults_run_on_this_machine_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HOST", "PORT", "WORKERS"):
        monkeypatch.delenv(f"RICOCHET_{name}", raising=False)
    settings = Settings()
    assert (settings.host, settings.port) == ("127.0.0.1", 8000)
    assert settings.workers >= 1
    assert all(field.description for field in Settings.model_fields.values())


@pytest.mark.parametrize("stop", [signal.SIGTERM, signal.SIGINT])
def test_running_query_is_answered_before_the_service_ends(own_service: Service, stop: signal.Signals) -> None:
    url, process = own_service.url, own_service.process
    body = PAPER_AT_45 | {"numerics": {"method": "panels", "panels": 100_000}}
    answers: list[httpx.Response] = []
    asking = threading.Thread(
        target=lambda: answers.append(httpx.post(f"{url}/trajectory", json=body, timeout=30.0, trust_env=False))
    )
    asking.start()
    time.sleep(0.3)
    process.send_signal(stop)
    assert process.wait(Settings().grace_seconds + 1) == 0
    asking.join()
    assert answers[0].status_code == 200


def test_results_are_looked_after(
    own_service: Service, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The folder of the service is that of the fixture."""
    monkeypatch.setenv("RICOCHET_DATA_DIR", str(tmp_path / "data"))
    for oblique_angle_deg in (45.0, 46.0, 47.0):
        body = PAPER_AT_45 | {"impact": PAPER_AT_45["impact"] | {"oblique_angle_deg": oblique_angle_deg}}
        assert httpx.post(f"{own_service.url}/trajectory", json=body, trust_env=False).is_success
    assert cli.main(["cache", "stat"]) == 0
    assert capsys.readouterr().out.startswith("3 results, 3 files, ")
    assert cli.main(["cache", "verify"]) == 1  # in use
    assert "in use" in capsys.readouterr().err
    own_service.process.terminate()
    own_service.process.wait(20.0)
    (tmp_path / "data" / "results" / "index.sqlite").unlink()
    assert cli.main(["cache", "rebuild"]) == 0
    assert capsys.readouterr().out.startswith("3 results, 3 files, ")
    segment = next((tmp_path / "data" / "results" / "segments").rglob("*.h5"))
    segment.write_bytes(segment.read_bytes()[:-100])
    assert cli.main(["cache", "verify"]) == 1
    assert f"damaged, set aside: {segment.stem}" in capsys.readouterr().out
    assert cli.main(["cache", "verify"]) == 0
    assert capsys.readouterr().out.startswith("2 results, 2 files, ")
    assert cli.main(["cache", "evict", "--bytes", "1"]) == 0
    assert capsys.readouterr().out == "0 results, 0 files, 0 bytes\n"


def test_folder_without_results_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RICOCHET_DATA_DIR", str(tmp_path))
    assert cli.main(["cache", "stat"]) == 1
    assert "there are no results" in capsys.readouterr().err


def test_second_service_on_a_folder_is_refused(own_service: Service, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "service.cli", "serve"],
        env={"RICOCHET_PORT": "0", "RICOCHET_DATA_DIR": str(tmp_path / "data")},
        cwd=Path(cli.__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 3
    assert "in use by another service" in done.stderr


def test_wrong_setting_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("RICOCHET_WORKERS", "none")
    with pytest.raises(SystemExit) as ended:
        cli.main(["serve"])
    assert ended.value.code == 2
    assert "workers" in capsys.readouterr().err


def test_port_in_use_is_told(live_url: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "service.cli", "serve"],
        env={"RICOCHET_PORT": str(httpx.URL(live_url).port), "RICOCHET_DATA_DIR": str(tmp_path)},
        cwd=Path(cli.__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "address already in use" in done.stderr
