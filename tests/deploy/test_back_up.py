"""Keys, jobs and results survive a backup by deploy/back-up.sh and a restore with the commands in the manual."""

import os
import pwd
import re
import stat
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from service.schemas.strike import PAPER
from tests.api.owners import holder, key_in
from tests.conftest import ROOT, RunService, until
from tests.docs.blocks import blocks

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

PACKAGED = Path("/var/lib/ricochet")
ME = pwd.getpwuid(os.geteuid()).pw_name
ENVIRONMENT = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
[RESTORE] = [
    block.text for block in blocks(ROOT / "docs" / "how-to" / "back-up.md") if "systemctl stop ricochet" in block.text
]


def run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def back_up(data: Path, backups: Path) -> Path:
    return Path(run("sh", str(ROOT / "deploy" / "back-up.sh"), str(data), str(backups)).strip())


def restore(data: Path, copy: Path) -> None:
    """Run the restore commands of the manual with these paths and the current user, without those for systemd."""
    text = re.sub(r"/var/backups/ricochet/\S+", str(copy), RESTORE).replace(str(PACKAGED), str(data))
    text = (
        text.replace("ricochet:ricochet", ME).replace("runuser -u ricochet -- ", "").replace("/opt/ricochet/bin/", "")
    )
    run("sh", "-ec", "\n".join(line for line in text.splitlines() if not line.startswith("systemctl ")))


def finished(client: httpx.Client, job: str) -> bool:
    return client.get(f"/jobs/{job}").json()["status"] not in {"accepted", "running"}


def test_backup_of_a_running_service_has_its_keys_jobs_and_results(tmp_path: Path, service_on: RunService) -> None:
    data, backups = tmp_path / "data", tmp_path / "backups"
    data.mkdir()
    token, stranger = key_in(data, "anna"), "ricochet_00000000_" + "0" * 43
    cases = {"cases": [PAPER | {"impact": {"velocity_m_s": 230.0 + number}} for number in range(3)]}
    with service_on(tmp_path, access="keys") as service, holder(service.url, token) as client:
        known = client.post("/cra", json=PAPER).raise_for_status().json()
        answer = client.post("/cra/batch", json=cases, headers={"Prefer": "respond-async"})
        job = answer.json()["id"]
        until(lambda: finished(client, job))
        rows = client.get(f"/jobs/{job}/results").json()["results"]
        copy = back_up(data, backups)
        client.post("/cra", json=PAPER | {"impact": {"velocity_m_s": 300.0}}).raise_for_status()  # not in the copy
    assert re.fullmatch(r"20\d\d-\d\d-\d\dT\d{6}Z", copy.name)
    assert [path for path in (copy, *copy.rglob("*")) if path.stat().st_mode & 0o077] == []
    restore(data, copy)
    assert (tmp_path / "data.before").is_dir()
    assert stat.S_IMODE(data.stat().st_mode) == 0o700
    with service_on(tmp_path, access="keys") as service:
        with holder(service.url, stranger) as nobody:
            assert nobody.get("/jobs").status_code == 401
        with holder(service.url, token) as client:
            assert client.get(f"/jobs/{job}/results").json()["results"] == rows
            again = client.post("/cra", json=PAPER).raise_for_status()
            assert again.json()["key"] == known["key"]
            assert client.get(f"/results/{known['key']}").is_success


@pytest.mark.parametrize("missing", ["", "results"])
def test_unused_data_folder_can_be_backed_up(tmp_path: Path, missing: str) -> None:
    data = tmp_path / "data"
    data.mkdir()
    (data / "auth.lock").touch()
    if not missing:
        (data / "results" / "segments").mkdir(parents=True)
    copy = back_up(data, tmp_path / "backups")
    assert (copy / "auth.lock").exists()
    assert not (copy / "auth.sqlite").exists()


def test_failed_backup_is_reported(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "jobs.sqlite").write_text("no database")
    command = ["sh", str(ROOT / "deploy" / "back-up.sh"), str(tmp_path / "data"), str(tmp_path / "backups")]
    done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, check=False)
    assert done.returncode != 0
    assert "not a database" in done.stderr
