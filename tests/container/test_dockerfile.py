"""The Dockerfile agrees with the service and the Makefile."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import httpx
import pytest

from service.settings import Settings
from tests.conftest import free_port

from .dockerfile import ROOT, Stage, read

STAGES = read()
IMAGE = STAGES[-1]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def test_image_starts_the_command_of_make_serve() -> None:
    [recipe] = [line for line in MAKEFILE.partition("\nserve:")[2].splitlines()[1:] if line.startswith("\t")][:1]
    assert IMAGE.last("CMD").command() == recipe.strip().removeprefix("@$(BIN)/").split()


def test_variables_of_the_image_are_settings_within_their_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    given = {name: value for name, value in IMAGE.environment().items() if name.startswith("RICOCHET_")}
    assert {name.removeprefix("RICOCHET_").lower() for name in given} <= Settings.model_fields.keys()
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    settings = Settings()
    assert str(settings.port) == IMAGE.last("EXPOSE").text
    assert str(settings.data_dir) == IMAGE.last("VOLUME").text


def test_both_stages_start_from_one_image_pinned_by_digest() -> None:
    (base,) = {stage.image for stage in STAGES}
    tag, _, digest = base.partition("@")
    assert re.fullmatch("sha256:[0-9a-f]{64}", digest)
    labels = IMAGE.last("LABEL").assignments()
    assert labels["org.opencontainers.image.base.digest"] == digest
    assert labels["org.opencontainers.image.base.name"] == tag


def test_full_lock_contains_every_extra_and_every_other_lock_of_the_service() -> None:
    def locked(name: str) -> set[str]:
        return set(re.findall(r"(?m)^([\w.-]+==[^\s;]+)", (ROOT / "requirements" / f"{name}.txt").read_text()))

    full = locked("full")
    assert locked("run") | locked("cluster") <= full
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    wanted = {re.split(r"[^\w.-]", requirement)[0] for extra in extras.values() for requirement in extra}
    assert wanted <= {package.partition("==")[0] for package in full}
    assert any("requirements/full.txt" in step.text for step in STAGES[0].steps if step.instruction == "COPY")


def test_image_runs_as_an_unprivileged_user() -> None:
    user = IMAGE.last("USER").text
    assert user.isdigit()
    assert int(user) > 0
    after = IMAGE.steps[[step.instruction for step in IMAGE.steps].index("USER") :]
    assert "COPY" not in {step.instruction for step in after}


def test_packages_are_installed_by_hash_and_only_as_wheels() -> None:
    installs = [part for stage in STAGES for step in stage.steps for part in step.text.split("&&") if "pip " in part]
    assert len(installs) == 4
    for part in installs:
        locked = "--require-hashes" in part and "--only-binary :all:" in part and "--requirement" in part
        assert locked or ("--no-index" in part and "--no-deps" in part), part


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name or "image")
def test_files_copied_into_the_image_exist_and_are_not_ignored(stage: Stage) -> None:
    ignored, *excepted = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()[1:]
    assert ignored == "*"
    for step in stage.steps:
        if step.instruction != "COPY":
            continue
        source, paths, _ = step.paths()
        if source:
            assert source in {other.name for other in STAGES}
            continue
        for path in paths:
            assert (ROOT / path).exists()
            assert f"!{path}" in excepted


def test_health_check_distinguishes_a_live_service_from_a_dead_one(live_url: str) -> None:
    program, *arguments = IMAGE.last("HEALTHCHECK").command()
    assert program == "python"

    def check(port: int | None) -> int:
        environment = {"RICOCHET_PORT": str(port), "http_proxy": "http://127.0.0.1:9"}
        return subprocess.run(
            [sys.executable, *arguments], env=environment, capture_output=True, check=False
        ).returncode

    assert check(httpx.URL(live_url).port) == 0
    assert check(free_port()) != 0


AVX2 = "avx2 bmi1 bmi2 f16c fma abm movbe"
AVX512 = f"{AVX2} avx512f avx512bw avx512cd avx512dq avx512vl"


@pytest.mark.parametrize(
    ("flags", "vendor", "chosen"),
    [
        ("sse4_2", "GenuineIntel", "None"),
        (AVX2, "AuthenticAMD", "x86-64-v3"),
        (AVX512, "AuthenticAMD", "znver4"),
        (AVX512, "GenuineIntel", "skylake-avx512"),
    ],
)
def test_entry_point_chooses_compiled_code_for_the_processor(
    tmp_path: Path, flags: str, vendor: str, chosen: str
) -> None:
    cpu = tmp_path / "cpuinfo"
    cpu.write_text(f"vendor_id\t: {vendor}\nflags\t\t: {flags}\n")
    program = [str(ROOT / "entry-point.sh"), sys.executable, "-c"]
    script = "import os; print(os.environ.get('NUMBA_CPU_NAME'))"
    environment = {"PATH": os.environ["PATH"], "CPUINFO": str(cpu)}
    done = subprocess.run([*program, script], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == chosen
