"""The wheel has the same bytes wherever and whenever it is built, and contains nothing but the packages."""

import hashlib
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from service.version import VERSION

ROOT = Path(__file__).parents[2]
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "ricochet_command.py", "service", "solver")
"""Files that the Dockerfile copies to build the wheel."""


def built(folder: Path, *, seconds: int, umask: int, hidden: bool) -> Path:
    """Build the wheel from a copy of the sources with this file date and umask, optionally with bytecode files."""
    source = folder / "source"
    source.mkdir(parents=True)
    for name in SOURCES:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=None if hidden else shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(path, source / name)
    for path in source.rglob("*"):
        path.chmod((0o777 if path.is_dir() else 0o666) & ~umask)
        os.utime(path, (seconds, seconds))
    command = ["wheel", "--no-index", "--no-deps", "--no-build-isolation", "--no-cache-dir", "--wheel-dir", "wheel"]
    subprocess.run(
        [sys.executable, "-m", "pip", *command, "./source"],
        cwd=folder,
        umask=umask,
        env={name: value for name, value in os.environ.items() if name != "SOURCE_DATE_EPOCH"},
        capture_output=True,
        check=True,
    )
    [wheel] = (folder / "wheel").iterdir()
    return wheel


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("wheels")
    old = built(folder / "old", seconds=1_000_000_000, umask=0o022, hidden=False)
    new = built(folder / "elsewhere" / "and" / "new", seconds=1_700_000_000, umask=0o027, hidden=True)
    return old, new


def test_wheels_built_at_other_times_and_places_have_the_same_bytes(
    wheels: tuple[Path, Path],
) -> None:
    old, new = wheels
    assert old.name == new.name
    assert hashlib.sha256(old.read_bytes()).hexdigest() == hashlib.sha256(new.read_bytes()).hexdigest()


def test_source_distribution_builds_the_same_wheel(wheels: tuple[Path, Path], tmp_path: Path) -> None:
    hatchling = Path(sys.executable).with_name("hatchling")
    made = ["build", "--target", "sdist", "--directory", str(tmp_path)]
    subprocess.run([hatchling, *made], cwd=ROOT, capture_output=True, check=True)
    [archive] = tmp_path.iterdir()
    assert archive.name == f"concrete_ricochet-{VERSION}.tar.gz"
    command = ["wheel", "--no-index", "--no-deps", "--no-build-isolation", "--no-cache-dir", "--wheel-dir", "wheel"]
    subprocess.run([sys.executable, "-m", "pip", *command, str(archive)], cwd=tmp_path, capture_output=True, check=True)
    [wheel] = (tmp_path / "wheel").iterdir()
    ours, theirs = (
        {name: file.read(name) for name in file.namelist() if ".dist-info/" not in name}
        for file in (zipfile.ZipFile(wheel), zipfile.ZipFile(wheels[0]))
    )
    assert ours == theirs


def test_wheel_contains_only_the_two_packages_and_the_command(wheels: tuple[Path, Path]) -> None:
    names = {name for name in zipfile.ZipFile(wheels[0]).namelist() if ".dist-info/" not in name}
    tracked = {
        path.relative_to(ROOT).as_posix()
        for package in ("service", "solver")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert names == tracked | {"ricochet_command.py"}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("service/__init__.py", ""),
        ("service/cli/__init__.py", "raise RuntimeError"),
        ("service.py", "raise RuntimeError"),
        ("solver/__init__.py", "raise RuntimeError"),
        ("solver.py", "raise RuntimeError"),
    ],
)
def test_package_of_the_same_name_that_hides_ours_is_reported(tmp_path: Path, name: str, content: str) -> None:
    path = tmp_path / "theirs" / name
    path.parent.mkdir(parents=True)
    path.write_text(content)
    (tmp_path / "theirs" / name.partition("/")[0].removesuffix(".py")).mkdir(exist_ok=True)
    if path.parent.name == "cli":
        (path.parent.parent / "__init__.py").touch()
    command = [sys.executable, "-c", "import sys; from ricochet_command import main; sys.exit(main())", "version"]
    theirs = os.environ | {"PYTHONPATH": os.pathsep.join((str(tmp_path / "theirs"), str(ROOT)))}
    done = subprocess.run(command, cwd=tmp_path, env=theirs, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    [line] = done.stderr.splitlines()
    assert line.startswith(f"ricochet: {tmp_path / 'theirs'}")
    assert "in place of that of ricochet: rename it, or take its folder out of PYTHONPATH" in line
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
