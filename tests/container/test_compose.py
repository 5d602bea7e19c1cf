"""compose.yaml runs the image of this project, reachable from this machine only and, by default, without keys."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.auth.api_keys import ApiKeyStore
from service.cli.arguments import CommandError
from service.cli.serve import check_access
from service.schemas.strike import PAPER
from service.settings import Settings
from solver import warm_up
from tests.conftest import START_LIMIT_S, RunService, free_port, until

from .dockerfile import ROOT, read

TEXT = (ROOT / "compose.yaml").read_text(encoding="utf-8")


def services(**variables: str) -> dict[str, dict[str, Any]]:
    """Return the services in compose.yaml, with these variables substituted."""

    def value(match: re.Match[str]) -> str:
        return variables.get(match[1]) or match[2]

    found: dict[str, dict[str, Any]] = yaml.safe_load(re.sub(r"\$\{(\w+):-([^}]*)\}", value, TEXT))["services"]
    return found


def settings_of(service: dict[str, Any], monkeypatch: pytest.MonkeyPatch, folder: Path) -> Settings:
    """Return the settings that the service reads in its container, with another data folder."""
    environment = read()[-1].environment() | service["environment"] | {"RICOCHET_DATA_DIR": str(folder)}
    for name, value in environment.items():
        if name.startswith("RICOCHET_"):
            assert name.removeprefix("RICOCHET_").lower() in Settings.model_fields
            monkeypatch.setenv(name, value)
    return Settings()


def test_service_starts_on_an_empty_volume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = settings_of(services()["service"], monkeypatch, tmp_path)
    assert not settings.on_loopback
    check_access(settings, ApiKeyStore(tmp_path, print))


def test_service_requires_keys_if_configured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "RICOCHET_ACCESS=keys docker compose up" in TEXT
    settings = settings_of(services(RICOCHET_ACCESS="keys")["service"], monkeypatch, tmp_path)
    with pytest.raises(CommandError):
        check_access(settings, ApiKeyStore(tmp_path, print))


def test_ports_are_published_only_on_this_machine() -> None:
    published = [port for service in services().values() for port in service.get("ports", [])]
    assert published == ["127.0.0.1:8000:8000"]
    assert read()[-1].last("EXPOSE").text == "8000"


def test_pages_under_other_host_names_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = settings_of(services()["service"], monkeypatch, tmp_path)
    with TestClient(create_app(settings.model_copy(update={"executor": "in-process"}))) as client:
        statuses = [
            client.get("/jobs", headers={"Host": host}).status_code
            for host in ("localhost:8000", "127.0.0.1:8000", "evil.example")
        ]
    assert statuses == [200, 200, 421]


def test_every_container_runs_the_image_built_here() -> None:
    assert {service["image"] for service in services().values()} == {"ricochet:cluster"}
    assert {service["pull_policy"] for service in services().values()} == {"never"}
    (built,) = [service["build"] for service in services().values() if "build" in service]
    assert (ROOT / built["context"] / "requirements" / f"{built['args']['REQUIREMENTS']}.txt").exists()


def test_scheduler_and_workers_are_in_a_network_without_outside_access() -> None:
    networks = yaml.safe_load(TEXT)["networks"]
    assert networks["cluster"]["internal"] is True
    assert services()["scheduler"]["networks"] == services()["worker"]["networks"] == ["cluster"]


@pytest.mark.parametrize("name", services())
def test_container_has_limits_no_capabilities_and_a_read_only_root(name: str) -> None:
    service, image = services()[name], read()[-1]
    compiled_code, user = image.environment()["XDG_CACHE_HOME"], image.last("USER").text
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    folders = dict(entry.split(":") for entry in service["tmpfs"])
    assert folders.keys() == {"/tmp", compiled_code}  # noqa: S108
    assert f"uid={user},gid={user}" in folders[compiled_code]
    assert service.get("volumes", []) == (["data:/data"] if name == "service" else [])
    assert service["pids_limit"] > 0
    assert re.fullmatch(r"\d+[gm]", service["mem_limit"])


def test_stop_timeout_exceeds_the_grace_time_of_the_service() -> None:
    assert {service["stop_grace_period"] for service in services().values()} == {"15s"}
    assert Settings().grace_seconds < 15


@pytest.fixture
def short_path() -> Iterator[Path]:
    """Folder whose path is short enough for a socket in it; `tmp_path` may be too long."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@pytest.mark.system
def test_service_works_with_only_its_data_and_tmp_writable(short_path: Path) -> None:
    """The namespace has the restrictions of `read_only`, `tmpfs` and `cap_drop` in compose.yaml."""
    if os.geteuid() != 0 or not all(map(shutil.which, ("unshare", "setpriv"))):
        pytest.skip("only root may take the right to write away")
    warm_up()  # In the namespace, compiled code cannot be written.
    port = str(free_port())
    data, temporary = short_path / "data", short_path / "tmp"
    temporary.mkdir()
    enter = f"""
        mount --make-rprivate / && mount --bind {short_path} {short_path} && mount -o remount,bind,ro / || exit 77
        mount -t tmpfs -o mode=1777 tmpfs /dev/shm
        if touch /var/written 2>/dev/null; then exit 77; fi
        exec setpriv --no-new-privs --bounding-set=-all --inh-caps=-all {sys.executable} -m service.cli serve
    """
    environment = os.environ | {"RICOCHET_DATA_DIR": str(data), "RICOCHET_PORT": port, "RICOCHET_WORKERS": "1"}
    environment |= {"TMPDIR": str(temporary)}
    with (short_path / "log").open("wb") as log:
        process = subprocess.Popen(
            ["unshare", "--mount", "sh", "-c", enter],  # noqa: S607
            cwd=ROOT,
            env=environment,
            stderr=log,
        )
    try:
        url, deadline = f"http://127.0.0.1:{port}", time.monotonic() + START_LIMIT_S
        while True:
            if process.poll() == 77:
                pytest.skip("this machine does not let processes have mounts of their own")
            assert process.poll() is None, (short_path / "log").read_text()
            assert time.monotonic() < deadline
            with suppress(httpx.TransportError):
                if httpx.get(f"{url}/readyz", trust_env=False).is_success:
                    break
            time.sleep(0.2)
        answer = httpx.post(f"{url}/cra", json=PAPER, timeout=60.0, trust_env=False)
        assert answer.json()["status"] == "converged"
        assert "not_cached" not in answer.text
        headers = {"Prefer": "respond-async"}
        job = httpx.post(f"{url}/cra/batch", json={"cases": [PAPER]}, headers=headers, trust_env=False).json()
        table = httpx.get(f"{url}{job['links']['results']}", headers={"Accept": "application/x-hdf5"}, trust_env=False)
        assert table.is_success
    finally:
        process.terminate()
        process.wait()
    assert "Traceback" not in (short_path / "log").read_text()


@pytest.mark.system
def test_commands_of_compose_start_a_working_cluster(short_path: Path, service_on: RunService) -> None:
    port = str(free_port())

    def here(text: str) -> str:
        replaced = text.replace("scheduler:8786", f"127.0.0.1:{port}").replace("8786", port)
        return str(short_path) if replaced == "/tmp" else replaced  # noqa: S108

    with ExitStack() as running:
        for name in ("scheduler", "worker"):
            program, *words = services()[name]["command"]
            command = [str(Path(sys.executable).parent / program), *map(here, words)]
            process = running.enter_context(subprocess.Popen(command, env=os.environ, stderr=subprocess.DEVNULL))
            running.callback(process.wait)
            running.callback(process.terminate)
        given = services()["service"]["environment"]
        settings = {name.removeprefix("RICOCHET_").lower(): here(value) for name, value in given.items()}
        service = running.enter_context(service_on(short_path, **settings))
        cases = [PAPER | {"impact": {"velocity_m_s": 200.0 + number}} for number in range(3)]
        answer = httpx.post(f"{service.url}/cra/batch", json={"cases": cases}, timeout=60.0, trust_env=False)
        assert [item["result"]["status"] for item in answer.json()["results"]] == ["converged"] * 3
        width = 'ricochet_chunk_width{place="cluster"} 1.0'
        until(lambda: width in httpx.get(f"{service.url}/metrics", trust_env=False).text)
