"""How the solver's functions are compiled, and where the compiled code is kept.

`compiled` and the other decorators are `numba.njit`, but numba is imported only when the first function is called.
Functions that Python calls are kept on disk, each with the code of all functions that it calls. numba does not see that
one of those has changed, so the folder is named by a digest of every source of the package, of the versions of Python,
numba and llvmlite, and of the processor: changed code goes to another folder, and a copy of an installation finds its
code.

The container image carries code for x86-64-v3, the processors with AVX2, and for those with AVX-512 of AMD and of Intel
(`entry-point.sh`): as fast as code compiled on the machine itself (`benchmarks/NOTES.md`).
"""

import hashlib
import os
import pickle
import shutil
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, update_wrapper
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, NamedTuple, TypeVar, cast

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

WITH_512_BITS = ("znver4", "znver5")
"""Processors on which LLVM uses registers of 512 bits."""
PACKAGE = Path(__file__).parent
JIT = os.environ.get("NUMBA_DISABLE_JIT", "0") in {"", "0"}
"""Whether anything is compiled."""
CPU = os.environ.get("NUMBA_CPU_NAME") or get_host_cpu_name()
VECTOR_WIDTH = 8 if CPU.startswith((*WITH_512_BITS, "x86-64-v4")) else 4
"""Numbers that loops take at a time."""
LONG = 10
"""Number of functions that take some seconds to compile."""


def _folder_name() -> str:
    """Return the name of a folder of compiled code: a digest of all that the code depends on."""
    digest = hashlib.sha256()
    for source in sorted(PACKAGE.rglob("*.py")):
        digest.update(source.relative_to(PACKAGE).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    features = os.environ.get("NUMBA_CPU_FEATURES", "" if CPU == "generic" else get_host_cpu_features().flatten())
    for part in (CPU, features, sys.version, version("numba"), version("llvmlite")):
        digest.update(part.encode() + b"\0")
    return f"compiled-{digest.hexdigest()[:16]}"


def _can_write(folder: Path) -> bool:
    """Return whether a folder can be written to, or made."""
    try:
        folder.stat()
    except FileNotFoundError:  # may be made
        pass
    except OSError:  # may not be entered, has a name that is too long, or a file for a parent
        return False
    existing = next(each for each in (folder, *folder.parents) if os.path.exists(each))  # noqa: PTH110 (never raises)
    return existing.is_dir() and os.access(existing, os.W_OK)


def _has_code(folder: Path) -> bool:
    """Return whether a folder can be read and holds code."""
    try:
        return any(folder.glob("*.nbi"))
    except OSError:  # may not be entered, or has a name that is too long
        return False


def _choose_folder() -> Path:
    """Return the folder in NUMBA_CACHE_DIR if that is set, else beside the sources; failing that the user's cache.

    A folder that can only be read is chosen if it holds code. Where none will do, every start compiles.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    bases = [Path(chosen) if chosen else PACKAGE / "__pycache__"]
    with suppress(RuntimeError):  # a user without a home
        bases.append(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ricochet")
    name = _folder_name()
    folders = [base.absolute() / name for base in bases]
    return next((each for each in folders if _can_write(each) or _has_code(each)), folders[0])


FOLDER = _choose_folder()
"""Where compiled code is read and kept."""
BEGUN = FOLDER / "begun.txt"
"""File with the names of the functions whose compilation has begun, in a process that may still run, a line each."""

Function = TypeVar("Function", bound=Callable[..., object])

FUNCTIONS: list["Compiled"] = []
"""All compiled functions of the modules imported so far."""


class Progress(NamedTuple):
    """How much of the solver is compiled, by this process or another."""

    functions: int
    left: list[str]
    """Functions that are neither compiled nor being compiled."""
    now: str = ""
    """The function whose compilation began last; empty if none is left."""

    def __str__(self) -> str:
        done = f"{self.functions - len(self.left)} of {self.functions} functions"
        return f"compiling the solver, once on a machine: {done}" + (f", now {self.now}" if self.now else "")


def compilation_progress() -> Progress:
    """Return how much is compiled, from the files on disk; numba is not imported."""
    if all(each.is_kept for each in FUNCTIONS if each.is_entry_point):
        return Progress(len(FUNCTIONS), [])
    try:
        begun = BEGUN.read_text().split()
    except OSError:
        begun = []
    left = [each.name for each in FUNCTIONS if not each.is_kept and (each.is_entry_point or each.name not in begun)]
    return Progress(len(FUNCTIONS), left, begun[-1] if begun else "")


def can_keep() -> bool:
    """Whether compiled code can be written to the folder."""
    return _can_write(FOLDER)


class NumbaSettingsError(OSError):
    """numba cannot be used with the settings that it finds in the working directory or in the environment."""


SETTINGS = ".numba_config.yaml in the working directory, NUMBA_... in the environment"


class Locator:
    """Place of the compiled code of a function, for numba (its setting `NUMBA_CACHE_LOCATOR_CLASSES`).

    numba's own locators refuse a folder that can only be read, and name folders by the path of the package, so that a
    copy of it would not find its code.
    """

    def __init__(self, function: Any) -> None:
        self._line = str(function.__code__.co_firstlineno)

    @classmethod
    def from_function(cls, function: Callable[..., object], _: str) -> "Locator":
        """Return the place of a function."""
        return cls(function)

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(FOLDER)

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        FOLDER.mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        """Return what changes with the sources: the name of the folder does."""
        return FOLDER.name

    def get_disambiguator(self) -> str:
        """Return what tells functions of the same name in a file apart."""
        return self._line


class Compiled:
    """A function that numba compiles, or loads, when it is first called; numba itself is imported then.

    It takes arguments of the types that it is first called with, and no others: two processes that add code for other
    types to the same files at the same time could each overwrite that of the other.

    Parameters
    ----------
    function
        In Python.
    options
        Options of `numba.njit`.
    """

    keeping: ClassVar[bool] = True
    """Whether code is kept in the folder and taken from there."""

    def __init__(self, function: Callable[..., object], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self.name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        """Module and function, as numba names its files."""
        self.is_entry_point = "no_cpython_wrapper" not in options
        """Whether Python can call it."""
        self.py_func: Any = function
        self.targetoptions = options
        """Under these names numba looks for the options of a function that it may inline."""
        self._dispatcher: Any = None
        self._ready: Any = None

    def __call__(self, *arguments: object) -> object:
        """Compute, in machine code."""
        if self._ready is None:
            self._prepare(arguments)
        return self._ready(*arguments)

    @property
    def is_kept(self) -> bool:
        """Whether the folder has code of the function; numba writes its index, a file of this name, at the end."""
        line = self.py_func.__code__.co_firstlineno
        python = f"{sys.version_info.major}{sys.version_info.minor}{sys.abiflags}"
        return (FOLDER / f"{self.name}-{line}.py{python}.nbi").exists()

    @property
    def dispatcher(self) -> Any:
        """numba's object for the function."""
        if self._dispatcher is None:
            numba = _numba()
            settings = numba.config
            keep = self.is_entry_point and self.keeping and (self.is_kept or can_keep())
            before, settings.CACHE_LOCATOR_CLASSES = settings.CACHE_LOCATOR_CLASSES, f"{__name__}.Locator"
            try:
                decorate = numba.njit(error_model="numpy", nogil=True, cache=keep, **self.targetoptions)
                self._dispatcher = decorate(self.py_func)
            finally:
                settings.CACHE_LOCATOR_CLASSES = before
        return self._dispatcher

    def forget(self) -> None:
        """Have it compiled, or loaded, again."""
        self._dispatcher = self._ready = None

    def _prepare(self, arguments: tuple[object, ...]) -> None:
        with _LOCK:
            if self._ready is None:
                with _no_exception_ignored():
                    types = tuple(map(_numba().typeof, arguments))
                    try:
                        self.dispatcher.compile(types)
                    except Exception as error:
                        if not _can_repair(error):
                            raise
                        self.dispatcher.compile(types)
                self.dispatcher.disable_compile()
                self._ready = self.dispatcher


_LOCK = threading.RLock()


@contextmanager
def _no_exception_ignored() -> Iterator[None]:
    """Raise, at the end of this block, what the handler of a signal raised where Python ignores it.

    LLVM calls back into Python for each module that it compiles or loads, and Python can only report what is raised
    there: Ctrl-C at that instant would be lost.
    """
    ignored: list[BaseException] = []

    def keep(unraisable: "sys.UnraisableHookArgs") -> None:
        error = unraisable.exc_value
        called = getattr(unraisable.object, "__module__", None) or ""
        if error is not None and (not isinstance(error, Exception) or called.startswith("llvmlite")):
            ignored.append(error)
        else:
            before(unraisable)

    before, sys.unraisablehook = sys.unraisablehook, keep
    try:
        yield
    except Exception:
        if not ignored:  # Else it may come of what was not done there.
            raise
    finally:
        sys.unraisablehook = before
    if ignored:
        raise ignored[0]


def _can_repair(error: Exception) -> bool:
    """Return whether functions can be compiled again after an error: with the folder deleted, or without one.

    A handler of a signal may raise here as anywhere; that is not an error of ours.
    """
    if _is_damaged():
        shutil.rmtree(FOLDER, ignore_errors=True)
        Compiled.keeping = not os.path.exists(FOLDER)  # noqa: PTH110 (never raises)
    elif isinstance(error, OSError) and error.errno is not None:  # a full disk, or a folder that can only be read
        Compiled.keeping = False
    else:
        return False
    for each in FUNCTIONS:
        each.forget()
    return True


def _is_damaged() -> bool:
    """Return whether a file of the folder cannot be read; one that was cut short cannot be unpickled."""
    try:
        for path in FOLDER.glob("*.nb?"):
            content = path.read_bytes()
            with path.open("rb") as file:
                while file.tell() < len(content) or not content:
                    pickle.load(file)  # noqa: S301 (as numba does)
    except Exception:  # noqa: BLE001 (unpickling a damaged file raises anything)
        return True
    return False


@lru_cache(1)
def _numba() -> ModuleType:
    """Import numba, and tell it what a `Compiled` is.

    Raises
    ------
    NumbaSettingsError
        If settings of the user keep it from being imported, or from compiling.
    """
    try:  # Here, since importing numba takes longer than importing the solver.
        numba, event = import_module("numba"), import_module("numba.core.event")
        typeof_impl: Any = import_module("numba.extending").typeof_impl
    except Exception as error:
        files = (Path(frame.filename).parts[-3:] for frame in traceback.extract_tb(error.__traceback__))
        if ("numba", "core", "config.py") not in files:
            raise  # It is not about the settings, which numba reads there.
        cause = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise NumbaSettingsError(f"numba cannot be used with the settings found ({SETTINGS}): {cause}") from error
    if numba.config.DISABLE_JIT:
        raise NumbaSettingsError(f"the settings of numba ({SETTINGS}) forbid it to compile")

    @typeof_impl.register(Compiled)  # type: ignore[untyped-decorator] # numba declares no types
    def type_of_compiled(function: Compiled, _: object) -> Any:
        return numba.typeof(function.dispatcher)

    class Announcement(event.Listener):  # type: ignore[name-defined,misc]
        """Announces each compilation of ours as it begins."""

        def on_start(self, event: Any) -> None:
            function = event.data["dispatcher"].py_func
            for each in FUNCTIONS:
                if each.py_func is function:
                    _announce(each)

        def on_end(self, event: Any) -> None:
            """Nothing has to be said."""

    event.register("numba:compile", Announcement())
    return numba


def _announce(function: Compiled) -> None:
    """Name a function where `compilation_progress` finds it; the first time, write to a terminal what is to come."""
    _announce_all()
    with suppress(OSError):
        FOLDER.mkdir(parents=True, exist_ok=True)
        with BEGUN.open("a") as file:
            file.write(f"{function.name}\n")


@lru_cache(1)
def _announce_all() -> None:
    with suppress(OSError):
        BEGUN.unlink(missing_ok=True)
    left = len(compilation_progress().left)
    # The cell of a notebook shows what is written there, though it is no terminal.
    read = sys.stderr is not None and (sys.stderr.isatty() or "ipykernel" in sys.modules)
    if left > LONG and read:
        sys.stderr.write(f"compiling the solver, once on a machine: {left} functions, about a minute\n")


def _decorator(**options: Any) -> Callable[[Function], Function]:
    def decorate(function: Function) -> Function:
        if not JIT:
            return function
        made = Compiled(function, options)
        FUNCTIONS.append(made)
        return cast(Function, made)

    return decorate


INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Without code that converts arguments from Python: for nested tuples of arrays it takes longer to compile than the
function, in each of its callers again."""
LEAN = {"_nrt": False, **INNER}
"""These functions allocate nothing. With memory management, every array that they are handed would be counted in and
out. It is an option of numba without documentation."""

compiled = _decorator(no_cfunc_wrapper=True)
"""Decorator of compiled functions that Python calls; they release the interpreter lock."""
lean = _decorator(**LEAN)
"""Decorator of functions that only compiled code calls."""
once = _decorator(inline="always", **LEAN)
"""Decorator of functions that are called in one place, and become part of the function there. numba would make machine
code for them as for any other, together with all that they call, and nothing would ever use it."""
inlined = _decorator(forceinline=True, **LEAN)
"""Decorator of a function whose many arguments would cost as much to hand over as a tenth of its work."""
exact = _decorator(fastmath={"contract", "nsz"}, **LEAN)
"""Decorator of polynomials and quotients in loops over vectors. Reassociation must not reach them: the compiler would
spread the division over every term."""
vectorised = _decorator(forceinline=True, fastmath={"contract", "nsz", "arcp", "reassoc"}, **LEAN)
"""Decorator of loops over vectors; only sums that may be reordered can use vector registers."""
