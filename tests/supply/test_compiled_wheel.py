"""The wheel that carries compiled code: for which Python it is, and that nothing is compiled where it is installed."""

import email
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import time
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

from solver.compilation import PORTABLE

ROOT = Path(__file__).parents[2]
BUILT_FROM = ("Makefile", "pyproject.toml", "hatch_build.py", "README.md", "LICENSE", "service", "solver")
GOAL_S = 5.0
ANSWER = """
import json, math, time
from numba.core import event
with event.install_recorder("numba:compile") as recorder:
    import solver
    from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
    found = solver.critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY)
print(json.dumps([solver.__file__, math.degrees(found.angle), len(recorder.buffer), time.monotonic()]))
"""


def source(folder: Path) -> Path:
    """Copy what a wheel is built from, without code that was compiled here."""
    folder.mkdir()
    for name in BUILT_FROM:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "compiled"))
        else:
            shutil.copy(ROOT / name, folder / name)
    return folder


def test_wheel_without_the_code_it_should_carry_is_not_built(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-index",
        "--no-deps",
        "--no-build-isolation",
        "--no-cache-dir",
    ]
    done = subprocess.run(
        [*command, "--wheel-dir", str(tmp_path / "dist"), str(source(tmp_path / "source"))],
        env=os.environ | {"RICOCHET_COMPILED": str(tmp_path / "nothing")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "which holds no compiled code" in done.stdout + done.stderr
    assert not (tmp_path / "dist").exists() or not list((tmp_path / "dist").iterdir())


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.skipif(not any(each.runs_here for each in PORTABLE), reason="this processor has no AVX2")
def test_installed_wheel_answers_without_compiling(tmp_path: Path) -> None:
    make = ["make", "--old-file=setup", f"BIN={Path(sys.executable).parent}", "wheel"]
    made = subprocess.run(make, cwd=source(tmp_path / "source"), capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    assert "compiling the solver, once on a machine: 0 of" in made.stdout
    [wheel] = (tmp_path / "source" / "dist").iterdir()

    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    assert wheel.name.endswith(f"-{python}-{python}-{platform}.whl")
    with zipfile.ZipFile(wheel) as content:
        [metadata] = [name for name in content.namelist() if name.endswith(".dist-info/METADATA")]
        required = email.message_from_bytes(content.read(metadata)).get_all("Requires-Dist")
        carried = {name.split("/")[2] for name in content.namelist() if name.startswith("solver/compiled/")}
    assert required is not None
    assert f"numba=={version('numba')}" in required
    assert carried == {each.name for each in PORTABLE if each.runs_here}

    fresh = tmp_path / "fresh"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(fresh)], check=True)
    install = ["--python", str(fresh / "bin" / "python"), "install", "--no-index", "--no-deps", str(wheel)]
    subprocess.run([sys.executable, "-m", "pip", "--quiet", *install], check=True, capture_output=True)
    [packages] = (fresh / "lib").glob("python*/site-packages")
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")  # the wheel's own come first

    begin = time.monotonic()
    answer = subprocess.run(
        [fresh / "bin" / "python", "-W", "error", "-c", ANSWER],
        env={"HOME": str(tmp_path / "home"), "TMPDIR": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    file, angle, events, at = json.loads(answer.stdout)
    print(f"from the start of the process to the angle: {at - begin:.2f} s")  # noqa: T201 (with -s)
    assert Path(file).is_relative_to(fresh)
    assert angle == pytest.approx(48.63, abs=0.02)
    assert events == 0
    assert at - begin < GOAL_S
