"""The cache of compiled code: damaged files, read-only folders, copies, and processes that compile at the same time.

Most tests use `solver/compilation.py` in a package of two small functions, which compiles in a second. The solver takes
a minute.
"""

import importlib
import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import solver
from solver import compilation

CONSTANTS = """
HALF = 0.5
"""
FUNCTIONS = """
from little.compilation import compiled, lean
from little.constants import (
    HALF,
)

@lean
def half(x):
    return HALF * x

@compiled
def quarter(x):
    return half(half(x))
"""
RUN = """
import json, sys, time
from pathlib import Path
from numba.core import event
with event.install_recorder("numba:compile") as recorder:
    from little.functions import quarter
    if len(sys.argv) > 1:
        Path(sys.argv[1] + ".ready").touch()
        while not Path(sys.argv[1]).exists():
            time.sleep(0.001)
    value = quarter(8.0)
print(json.dumps([value, sum(event.is_start for _, event in recorder.buffer)]))
"""
START_S = 300.0


class SmallPackage:
    """A copy of the small package, run with its own home directory."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.package = folder / "little"
        self.run = RUN
        self.environment = {"PYTHONPATH": str(folder), "HOME": str(folder / "home"), "PATH": os.environ["PATH"]}
        self.environment["TMPDIR"] = str(folder)

    @property
    def code(self) -> Path:
        """Folder with the compiled code, beside the sources."""
        (found,) = (each for each in (self.package / "__pycache__").glob("compiled-*") if each.is_dir())
        return found

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        command = [*bound_by_permissions(), sys.executable, "-W", "error", "-c", self.run, *arguments]
        return subprocess.Popen(
            command, env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=self.folder
        )

    def compiled(self) -> int:
        """Run the package; check its result and return the number of functions that were compiled."""
        return ended(self.start())

    def left(self) -> list[str]:
        """Return the names of the functions that are not compiled yet; numba must not be imported for that."""
        script = (
            "import json, sys; from little import compilation, functions\n"
            "print(json.dumps([compilation.compilation_progress().left, 'numba' in sys.modules]))"
        )
        command = [*bound_by_permissions(), sys.executable, "-c", script]
        done = subprocess.run(
            command, env=self.environment, capture_output=True, text=True, cwd=self.folder, check=True, timeout=START_S
        )
        left, numba = json.loads(done.stdout)
        assert not numba
        return list(left)


def answer(process: subprocess.Popen[str]) -> tuple[float, int]:
    """Wait for a run of the package; return its result, and the number of functions that it compiled."""
    output, errors = process.communicate(timeout=START_S)
    assert process.returncode == 0, errors
    value, count = json.loads(output)
    return float(value), int(count)


def ended(process: subprocess.Popen[str]) -> int:
    value, count = answer(process)
    assert value == 2.0
    return count


def bound_by_permissions() -> list[str]:
    """Return a command prefix with which file permissions apply to root too."""
    if os.geteuid() != 0:
        return []
    program = shutil.which("setpriv")
    if program is None:
        pytest.skip("root may write everywhere, and setpriv is not installed")
    return [program, "--bounding-set=-dac_override,-dac_read_search", "--"]


def set_writable(folder: Path, writable: bool) -> None:
    for each in [folder, *folder.rglob("*")]:
        each.chmod((0o755 if writable else 0o555) if each.is_dir() else (0o644 if writable else 0o444))


def make_package(folder: Path) -> SmallPackage:
    made = SmallPackage(folder)
    made.package.mkdir()
    (made.package / "__init__.py").touch()
    shutil.copy(str(compilation.__file__), made.package)
    (made.package / "constants.py").write_text(CONSTANTS)
    (made.package / "functions.py").write_text(FUNCTIONS)
    return made


@pytest.fixture
def little(tmp_path: Path) -> SmallPackage:
    """The package, not compiled yet."""
    return make_package(tmp_path)


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> SmallPackage:
    """The package with all functions compiled, shared by tests that do not change it."""
    made = make_package(tmp_path_factory.mktemp("started"))
    assert made.compiled() == 2
    return made


@pytest.fixture
def ready(tmp_path: Path, started: SmallPackage) -> SmallPackage:
    """A copy of the compiled package whose files have new dates."""
    shutil.copytree(started.package, tmp_path / "little", copy_function=shutil.copy)
    return SmallPackage(tmp_path)


def test_remaining_functions_are_counted_without_numba(little: SmallPackage, started: SmallPackage) -> None:
    assert little.left() == ["functions.half", "functions.quarter"]
    assert started.left() == []


def test_compiled_code_is_found_in_a_read_only_copy(ready: SmallPackage) -> None:
    set_writable(ready.package, False)
    assert ready.compiled() == 0
    assert not (ready.folder / "home").exists()


@pytest.mark.parametrize("name", ["functions.py", "constants.py"])
def test_changed_source_and_its_importers_are_recompiled(ready: SmallPackage, name: str) -> None:
    with (ready.package / name).open("a") as source:
        source.write("\n# another text\n")
    assert ready.compiled() == 2


def test_answer_changes_with_a_function_in_another_file(little: SmallPackage) -> None:
    """The cache of numba alone would give the old result, because it checks only the file of the function called."""
    (little.package / "functions.py").write_text(
        "from little.compilation import compiled\nfrom little.inner import half\n\n"
        "@compiled\ndef quarter(x):\n    return half(half(x))\n"
    )
    inner = "from little.compilation import lean\n\n@lean\ndef half(x):\n    return {} * x\n"
    (little.package / "inner.py").write_text(inner.format(0.5))
    assert answer(little.start()) == (2.0, 2)
    assert answer(little.start()) == (2.0, 0)
    (little.package / "inner.py").write_text(inner.format(0.25))
    assert answer(little.start()) == (0.5, 2)


def test_read_only_installation_compiles_into_the_cache_of_the_user(little: SmallPackage) -> None:
    set_writable(little.package, False)
    assert little.compiled() == 2
    assert little.compiled() == 0
    assert list((little.folder / "home" / ".cache" / "ricochet").rglob("*.nbc"))


def test_package_without_a_usable_folder_is_compiled_at_each_start(little: SmallPackage) -> None:
    (little.folder / "home").touch()
    set_writable(little.package, False)
    assert [little.compiled() for _ in range(2)] == [2, 2]


def test_cache_folder_in_the_environment_is_used(little: SmallPackage) -> None:
    named = little.folder / "named"
    little.environment["NUMBA_CACHE_DIR"] = str(named)
    assert little.compiled() == 2
    assert list(named.rglob("*.nbc"))
    set_writable(named, False)
    assert little.compiled() == 0


def test_unusable_cache_folder_in_the_environment_is_ignored(little: SmallPackage) -> None:
    closed = little.folder / "closed"
    closed.mkdir(mode=0)
    (little.folder / "file").touch()
    for named in (closed / "inside", little.folder / "file", little.folder / ("long" * 100)):
        little.environment["NUMBA_CACHE_DIR"] = str(named)
        little.compiled()
    closed.chmod(0o755)
    assert list((little.folder / "home" / ".cache" / "ricochet").rglob("*.nbc"))


@pytest.mark.parametrize("settings", ["opt: [", "- opt", "opt: fast", "disable_jit: 1"])
def test_settings_unusable_by_numba_are_named_in_one_sentence(little: SmallPackage, settings: str) -> None:
    (little.folder / ".numba_config.yaml").write_text(settings)
    little.run = "from little.functions import quarter; quarter(8.0)"
    _, errors = little.start().communicate(timeout=START_S)
    last = errors.strip().splitlines()[-1]
    assert last.startswith("little.compilation.NumbaSettingsError: ")
    assert ".numba_config.yaml in the working directory" in last


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "first half": lambda content: content[: len(content) // 2],
    "last byte missing": lambda content: content[:-1],
    "another text": lambda content: b"no pickle",
}


def damages(*first: str) -> list[Any]:
    """Return the ways to corrupt a file as test parameters; all but those in `first` have the mark `system`."""
    return [pytest.param(name, marks=() if name in first else pytest.mark.system) for name in DAMAGES]


@pytest.mark.parametrize("damage", damages("empty", "last byte missing"))
def test_folder_with_a_damaged_file_is_recompiled(ready: SmallPackage, damage: str) -> None:
    damage_file(ready, damage, ".nbc")
    assert ready.compiled() == 2
    assert ready.compiled() == 0


@pytest.mark.parametrize("damage", damages("first half"))
def test_damaged_index_is_rewritten(ready: SmallPackage, damage: str) -> None:
    damage_file(ready, damage, ".nbi")
    assert ready.compiled() == 2
    assert ready.compiled() == 0
    assert not ready.left()


def test_damaged_read_only_folder_is_not_used(ready: SmallPackage) -> None:
    damage_file(ready, "first half", ".nbc")
    set_writable(ready.package, False)
    assert [ready.compiled() for _ in range(2)] == [2, 2]


INTERRUPTED = """
    import signal
    def end(*_):
        raise TimeoutError
    signal.signal(signal.SIGALRM, end)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.001)
        quarter(8.0)
    except TimeoutError:
        pass
"""


def test_signal_handler_that_raises_while_code_is_loaded_does_not_discard_it(ready: SmallPackage) -> None:
    ready.run = RUN.replace("    value = ", f"{INTERRUPTED}    value = ")
    assert ready.compiled() == 0


def damage_file(package: SmallPackage, damage: str, suffix: str) -> None:
    file = next(file for file in package.code.rglob("*quarter*") if file.suffix == suffix)
    file.write_bytes(DAMAGES[damage](file.read_bytes()))


def test_unreadable_code_is_recompiled(ready: SmallPackage) -> None:
    for file in ready.code.rglob("*.nb?"):
        file.chmod(0)
    assert ready.compiled() == 2


def test_two_processes_may_compile_at_the_same_time(little: SmallPackage) -> None:
    begin = [little.folder / name for name in ("first", "second")]
    processes = [little.start(str(name)) for name in begin]
    deadline = time.monotonic() + START_S
    while not all(Path(f"{name}.ready").exists() for name in begin):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    for name in begin:
        name.touch()
    for process in processes:
        assert ended(process) in {0, 2}
    assert little.compiled() == 0


def test_compiled_solver_is_found_in_a_read_only_copy(tmp_path: Path) -> None:
    """An installation by root for other users is such a copy, if all functions were compiled."""
    solver.warm_up()
    progress = compilation.compilation_progress()
    assert progress.functions > 0
    assert not progress.left
    source = Path(str(solver.__file__)).parent
    code = compilation.FOLDER
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(source, tmp_path / "solver", ignore=ignored, copy_function=shutil.copy)
    shutil.copytree(code, tmp_path / "solver" / "__pycache__" / code.name)
    set_writable(tmp_path / "solver", False)
    script = (
        "from numba.core import event\n"
        "with event.install_recorder('numba:compile') as recorder:\n"
        "    import solver; solver.warm_up()\n"
        "print(solver.__file__, len(recorder.buffer))"
    )
    done = subprocess.run(
        [*bound_by_permissions(), sys.executable, "-c", script],
        env={"PYTHONPATH": str(tmp_path), "HOME": "/nonexistent"},
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.stdout.split() == [str(tmp_path / "solver" / "__init__.py"), "0"], done.stderr


def test_warm_up_compiles_in_this_process_if_code_cannot_be_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    solver.warm_up()
    warm_up = importlib.import_module("solver.warm_up")
    monkeypatch.setattr(warm_up, "compilation_progress", lambda: compilation.Progress(1, ["all"]))
    monkeypatch.setattr(warm_up, "can_keep", lambda: False)
    monkeypatch.setattr("subprocess.Popen", lambda *_, **__: pytest.fail("it would be compiled twice"))
    warm_up.warm_up()


def test_process_that_cannot_compile_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    solver.warm_up()
    warm_up = importlib.import_module("solver.warm_up")
    monkeypatch.setattr(warm_up, "compilation_progress", lambda: compilation.Progress(1, ["all"]))
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\necho out of memory >&2\nexit 7\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with pytest.warns(RuntimeWarning, match="ended with code 7: out of memory"):
        warm_up.warm_up()


@pytest.fixture
def compiling(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Function that starts a script with an empty cache, so it compiles the solver. It is killed after the test."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "empty"), "XDG_CACHE_HOME": str(tmp_path / "user")}
    environment |= {"TMPDIR": str(tmp_path)}
    processes: list[subprocess.Popen[str]] = []

    def start(script: str, stderr: int | None = None) -> subprocess.Popen[str]:
        command = [sys.executable, "-u", "-c", script]
        process = subprocess.Popen(
            command, env=environment, text=True, start_new_session=True, stdout=subprocess.PIPE, stderr=stderr
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_progress_states_how_much_is_compiled_and_the_current_function(
    compiling: Callable[..., subprocess.Popen[str]],
) -> None:
    process = compiling("import solver; solver.warm_up(print)")
    assert process.stdout is not None
    form = re.compile(r"compiling the solver, once on a machine: (\d+) of (\d+) functions(, now [a-z_]+\.[a-z_]+)?\n")
    compiled: list[int] = []
    named = False
    while not named or compiled[-1] == 0:
        line = process.stdout.readline()
        match = form.fullmatch(line)
        assert match, line
        compiled.append(int(match[1]))
        named |= bool(match[3])
        assert compiled[-1] < int(match[2])
    assert compiled[0] == 0


FIRST_CALL = (
    "from solver import critical_angle\n"
    "from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY\n"
    "critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY)"
)
NOTEBOOK = "import sys, types; sys.modules['ipykernel'] = types.ModuleType('ipykernel')\n"
"""Code that makes a process look like a Jupyter kernel, whose standard error is not a terminal."""


def test_first_call_in_a_notebook_announces_that_it_compiles(compiling: Callable[..., subprocess.Popen[str]]) -> None:
    process = compiling(NOTEBOOK + FIRST_CALL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    assert process.stderr.readline().startswith("compiling the solver, once on a machine: ")


def test_first_call_on_a_terminal_announces_that_it_compiles(compiling: Callable[..., subprocess.Popen[str]]) -> None:
    ours, theirs = pty.openpty()
    compiling(FIRST_CALL, stderr=theirs)
    os.close(theirs)
    with os.fdopen(ours) as terminal:
        assert re.fullmatch(
            r"compiling the solver, once on a machine: \d+ functions, about a minute\n", terminal.readline()
        )


def test_import_loads_neither_numba_nor_scipy() -> None:
    script = "import sys, solver; print([name for name in ('numba', 'scipy') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_code_for_another_processor_is_not_counted_or_deleted(ready: SmallPackage) -> None:
    ready.environment["NUMBA_CPU_NAME"] = "generic"
    assert len(ready.left()) == 2
    assert ready.compiled() == 2
    del ready.environment["NUMBA_CPU_NAME"]
    assert not ready.left()
    assert ready.compiled() == 0
