"""Run the steps of the Dockerfile without a container engine, in a root folder like the one in the base image.

Each command runs in its own mount and process namespaces, with the network and devices of this machine. When it ends,
all processes that it has started are killed.
"""

import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from .dockerfile import ROOT, Stage, Step

RELEASES = {"python:3.13-slim": ("trixie", "3.13")}
"""Debian release and Python version of each supported base image."""
SYSTEM_PATH = "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"
ENTER = """
root=$1 user=$2 folder=$3
shift 3
mount --rbind /dev "$root/dev"
exec chroot --userspec="$user" "$root" /bin/sh -c 'cd "$0" && exec "$@"' "$folder" "$@"
"""
WHEELS = "/wheels"


def skip_unless_possible() -> None:
    """Skip the test if a root folder cannot be made or entered on this machine."""
    if os.geteuid() != 0:
        pytest.skip("only root may enter a separate root folder")
    for program in ("unshare", "chroot", "debootstrap"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    if subprocess.run(["unshare", "--mount", "--pid", "--fork", "true"], check=False, capture_output=True).returncode:  # noqa: S607
        pytest.skip("this machine does not let processes have mounts of their own")


def base_root(image: str, folder: Path) -> Path:
    """Make a root folder like the base image, or copy the one that CLEAN_ROOT names, and add Python in /usr/local."""
    release, version = RELEASES[image]
    root = folder / "base"
    if ready := os.environ.get("CLEAN_ROOT"):
        copy_tree(Path(ready), root)
    else:
        command = ["debootstrap", "--variant=minbase", "--include=python3,python3-venv", release, str(root)]
        made = subprocess.run(command, capture_output=True, text=True, check=False)
        if made.returncode:
            pytest.skip(f"no clean root: {(made.stdout + made.stderr).strip().splitlines()[-1]}")
    base = Container(root)
    base.run(["/usr/bin/python3", "-m", "venv", "/usr/local"])
    printed = base.run(["python", "-c", "import sys; print('%d.%d' % sys.version_info[:2])"])
    assert printed.strip() == version
    return root


@dataclass
class Container:
    """A root folder in which commands are run."""

    root: Path
    environment: dict[str, str] = field(default_factory=lambda: {"PATH": SYSTEM_PATH})
    folder: str = "/"
    user: str = "0:0"

    def run(self, words: Sequence[str], **settings: str) -> str:
        """Run a command to its end; return its output."""
        command, environment = self.entered(words, **settings)
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{words} ended in {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def entered(self, words: Sequence[str], **settings: str) -> tuple[list[str], dict[str, str]]:
        """Return the full command that runs a command in the root folder, and its environment."""
        enter = ["unshare", "--mount", "--pid", "--fork", "--kill-child", f"--mount-proc={self.root / 'proc'}"]
        words = [*enter, "/bin/sh", "-c", ENTER, "sh", str(self.root), self.user, self.folder, *words]
        return words, self.environment | settings

    def take(self, step: Step, others: Mapping[str, "Container"]) -> None:
        """Perform a step of the Dockerfile; steps that only describe how to run the image change nothing."""
        if step.instruction in {"ARG", "ENV"}:
            known = self.environment
            self.environment = known | {
                name: value.replace("$PATH", known["PATH"]) for name, value in step.assignments().items()
            }
        elif step.instruction == "WORKDIR":
            self.folder = step.text
            self.inside(step.text).mkdir(parents=True, exist_ok=True)
        elif step.instruction == "USER":
            self.user = step.text
        elif step.instruction == "RUN":
            self.run(["/bin/sh", "-c", step.text], PIP_NO_INDEX="1", PIP_FIND_LINKS=WHEELS)
        elif step.instruction == "COPY":
            self.copy(step, others)

    def copy(self, step: Step, others: Mapping[str, "Container"]) -> None:
        """Copy from the folder of the project, or from another stage."""
        stage, sources, destination = step.paths()
        for source in sources:
            found = others[stage].inside(source) if stage else ROOT / source
            place = self.inside(destination)
            if found.is_dir():  # COPY copies the content of a folder.
                copy_tree(found, place, but="__pycache__" if not stage else "")
            else:
                place.mkdir(parents=True, exist_ok=True)
                shutil.copy2(found, place)

    def inside(self, path: str) -> Path:
        """Return the path, on this machine, of a path inside the root folder."""
        return self.root / Path(self.folder, path).relative_to("/")


def copy_tree(source: Path, target: Path, but: str = "") -> None:
    """Copy a folder with owners, links and devices."""
    target.mkdir(parents=True, exist_ok=True)
    command = ["tar", "--create", "--file=-", *([f"--exclude={but}"] if but else []), "--directory", str(source), "."]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as packing:
        unpack = ["tar", "--extract", "--same-owner", "--directory", str(target)]
        subprocess.run(unpack, stdin=packing.stdout, check=True)
    assert packing.returncode == 0


def build(stages: Sequence[Stage], folder: Path, wheels: Path) -> Container:
    """Perform the steps of all stages, each in a copy of its base; return the last stage."""
    bases = {tag: base_root(tag, folder) for tag in {stage.tag for stage in stages}}
    built: dict[str, Container] = {}
    for stage in stages:
        container = Container(folder / (stage.name or "image"))
        copy_tree(bases[stage.tag], container.root)
        if any("pip" in step.text for step in stage.steps):
            copy_tree(wheels, container.inside(WHEELS))
        for step in stage.steps:
            container.take(step, built)
        built[stage.name] = container
    return built[stages[-1].name]
