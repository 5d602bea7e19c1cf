"""Compilation of the solver by numba, and the cache of compiled code on disk.

`compiled` and the other decorators wrap `numba.njit`, but import numba only when the first function is called.
Functions that Python calls are cached, each together with all functions that it calls. numba does not notice a change
in a called function, so the name of the cache folder contains a digest of all sources of the package, the versions of
Python, numba and llvmlite, and the processor. Changed sources therefore use a new folder, and a copied installation
finds its code.

The container image includes compiled code for x86-64-v3 (processors with AVX2 and FMA), and for AMD and Intel
processors with AVX-512 (`entry-point.sh`). In measurements the code for AVX-512 took at most 2 % longer than code
compiled on the machine itself (`benchmarks/results.md`).
"""

import hashlib
import os
import pickle
import shutil
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, update_wrapper
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, ClassVar, NamedTuple, TypeVar, cast

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

# LLVM prefers 256-bit registers on Intel processors that also have 512-bit ones. There the wider registers gained
# nothing, or made loops up to 50 % slower.
WITH_512_BITS = ("znver4", "znver5")
"""Processors on which LLVM uses 512-bit registers."""
PACKAGE = Path(__file__).parent
JIT = os.environ.get("NUMBA_DISABLE_JIT", "0") in {"", "0"}
"""False if the environment variable NUMBA_DISABLE_JIT turns compilation off."""
CPU = os.environ.get("NUMBA_CPU_NAME") or get_host_cpu_name()
# Filling batches of rings to a multiple of this width made searches 5 % faster on Intel, and 9 to 12 % on Zen 4 and 5.
VECTOR_WIDTH = 8 if CPU.startswith((*WITH_512_BITS, "x86-64-v4")) else 4
"""Number of 64-bit numbers in a vector register."""
# Compiling the whole solver takes about a minute. A few functions take seconds, and a message about them would be
# noise.
LONG = 10
"""Number of functions to compile, above which a message is written to the terminal."""


def _folder_name() -> str:
    """Return the name of the cache folder, which contains a digest of everything that compiled code depends on."""
    digest = hashlib.sha256()
    for source in sorted(PACKAGE.rglob("*.py")):
        digest.update(source.relative_to(PACKAGE).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    features = os.environ.get("NUMBA_CPU_FEATURES", "" if CPU == "generic" else get_host_cpu_features().flatten())
    for part in (CPU, features, sys.version, version("numba"), version("llvmlite")):
        digest.update(part.encode() + b"\0")
    return f"compiled-{digest.hexdigest()[:16]}"


def _can_write(folder: Path) -> bool:
    """Return whether a folder is writable or can be created."""
    try:
        folder.stat()
    except FileNotFoundError:  # it can perhaps be created
        pass
    except OSError:  # no permission, a name that is too long, or a parent that is a file
        return False
    existing = next(each for each in (folder, *folder.parents) if os.path.exists(each))  # noqa: PTH110 (never raises)
    return existing.is_dir() and os.access(existing, os.W_OK)


def _has_code(folder: Path) -> bool:
    try:
        return any(folder.glob("*.nbi"))
    except OSError:  # no permission, or a name that is too long
        return False


def _choose_folder() -> Path:
    """Choose the cache folder: in NUMBA_CACHE_DIR or, if that is not set, beside the sources; else in the user's cache.

    The first folder that is writable or holds compiled code is chosen. If there is none, every process compiles anew.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    bases = [Path(chosen) if chosen else PACKAGE / "__pycache__"]
    with suppress(RuntimeError):  # a user without a home
        bases.append(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ricochet")
    name = _folder_name()
    folders = [base.absolute() / name for base in bases]
    return next((each for each in folders if _can_write(each) or _has_code(each)), folders[0])


FOLDER = _choose_folder()
"""Cache folder of compiled code."""
BEGUN = FOLDER / "begun.txt"
"""File with the names of the functions whose compilation has begun, one per line; the last may be in progress."""

Function = TypeVar("Function", bound=Callable[..., object])

FUNCTIONS: list["Compiled"] = []
"""All compiled functions of the modules imported so far."""


class Progress(NamedTuple):
    """Progress of compiling the solver, in this process or another."""

    functions: int
    """Total number of functions."""
    left: list[str]
    """Entry points that are not in the cache, and inner functions whose compilation has not begun."""
    now: str = ""
    """Function whose compilation began last; empty if none has begun or the cache is complete."""

    def __str__(self) -> str:
        done = f"{self.functions - len(self.left)} of {self.functions} functions"
        return f"compiling the solver, once on a machine: {done}" + (f", now {self.now}" if self.now else "")


def compilation_progress() -> Progress:
    """Read the progress of compilation from the cache folder, without importing numba."""
    if all(each.is_kept for each in FUNCTIONS if each.is_entry_point):
        return Progress(len(FUNCTIONS), [])
    try:
        begun = BEGUN.read_text().split()
    except OSError:
        begun = []
    left = [each.name for each in FUNCTIONS if not each.is_kept and (each.is_entry_point or each.name not in begun)]
    return Progress(len(FUNCTIONS), left, begun[-1] if begun else "")


def can_keep() -> bool:
    """Return whether compiled code can be written to the cache folder."""
    return _can_write(FOLDER)


class NumbaSettingsError(OSError):
    """Raised if numba's settings in the working directory or the environment prevent its use."""


SETTINGS = ".numba_config.yaml in the working directory, NUMBA_... in the environment"
"""Sources of numba's settings, for error messages."""


class Locator:
    """Cache locator for numba's setting `NUMBA_CACHE_LOCATOR_CLASSES`.

    numba's own locators refuse a read-only folder. They also name folders after the path of the package, so a copy of
    the package would not find its code.
    """

    def __init__(self, function: Any) -> None:
        self._line = str(function.__code__.co_firstlineno)

    @classmethod
    def from_function(cls, function: Callable[..., object], _: str) -> "Locator":
        """Create the locator of a function; numba's registry calls this method."""
        return cls(function)

    def get_cache_path(self) -> str:
        """Return the path of the cache folder, the same for all functions."""
        return str(FOLDER)

    def ensure_cache_path(self) -> None:
        """Create the cache folder if it is missing."""
        FOLDER.mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        """Return a string that changes with the sources: the name of the folder, which contains their digest."""
        return FOLDER.name

    def get_disambiguator(self) -> str:
        """Return the line number of the function, which distinguishes functions of the same name."""
        return self._line


class Compiled:
    """Function that numba compiles, or loads from the cache, at the first call.

    It accepts only the argument types of the first call: if two processes added code for other types to the same cache
    files at once, they could overwrite each other's code.

    Parameters
    ----------
    function
        Python function to compile.
    options
        Options of `numba.njit`.
    """

    keeping: ClassVar[bool] = True
    """False if the cache is neither read nor written."""

    def __init__(self, function: Callable[..., object], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self.name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        """Module and function, as in the names of numba's cache files."""
        self.is_entry_point = "no_cpython_wrapper" not in options
        """True if Python can call the function."""
        # numba reads these two attributes by name from a function that it may inline.
        self.py_func: Any = function
        self.targetoptions = options
        self._dispatcher: Any = None
        self._ready: Any = None

    def __call__(self, *arguments: object) -> object:
        """Call the compiled function; the first call compiles or loads it."""
        if self._ready is None:
            self._prepare(arguments)
        return self._ready(*arguments)

    @property
    def is_kept(self) -> bool:
        """True if the cache has code for the function."""
        # numba writes the code of a function first, and then its index, a file of this name.
        line = self.py_func.__code__.co_firstlineno
        python = f"{sys.version_info.major}{sys.version_info.minor}{sys.abiflags}"
        return (FOLDER / f"{self.name}-{line}.py{python}.nbi").exists()

    @property
    def dispatcher(self) -> Any:
        """numba dispatcher of the function, created at first use."""
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
        """Drop the compiled code, so that the next call compiles or loads it again."""
        self._dispatcher = self._ready = None

    def _prepare(self, arguments: tuple[object, ...]) -> None:
        with _LOCK:
            if self._ready is None:
                types = tuple(map(_numba().typeof, arguments))
                try:
                    with _handlers_deferred() if self.keeping and self.is_kept else _no_exception_ignored():
                        self.dispatcher.compile(types)
                except Exception as error:
                    if not _can_repair(error):
                        raise
                    with _no_exception_ignored():
                        self.dispatcher.compile(types)
                self.dispatcher.disable_compile()
                self._ready = self.dispatcher


_LOCK = threading.RLock()


@contextmanager
def _handlers_deferred() -> Iterator[None]:
    """Call Python's signal handlers at the end of the block instead of within it.

    If a handler raises an exception, as on Ctrl-C, while llvmlite frees memory, llvmlite frees it again and the process
    crashes. Loading a function takes milliseconds, so nobody notices the delay.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # handlers run in the main thread only
        return
    arrived: list[int] = []
    is_deferring = True
    handlers: dict[int, Callable[..., object]] = {
        each: found for each in signal.valid_signals() if callable(found := signal.getsignal(each))
    }

    def handle(number: int, frame: FrameType | None) -> None:
        if is_deferring:
            arrived.append(number)
        else:  # another handler raised an exception before this one was restored
            handlers[number](number, frame)

    try:
        for each in handlers:
            signal.signal(each, handle)
        yield
    finally:
        is_deferring = False
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in arrived:
            handlers[number](number, None)


@contextmanager
def _no_exception_ignored() -> Iterator[None]:
    """Raise, at the end of the block, exceptions of signal handlers that Python would otherwise ignore.

    LLVM calls back into Python for each module that it compiles or loads. Python prints an exception raised in such a
    callback and continues, so Ctrl-C at that instant would be lost.
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
        if not ignored:  # else this error may be a consequence of the interrupted callback
            raise
    finally:
        sys.unraisablehook = before
    if ignored:
        raise ignored[0]


def _can_repair(error: Exception) -> bool:
    """Return whether compilation can be repeated after an error; if so, prepare for it.

    A damaged cache is deleted. If that fails, or the cache cannot be written, it is no longer used. After other errors,
    such as exceptions of signal handlers, compilation is not repeated.
    """
    if _is_damaged():
        shutil.rmtree(FOLDER, ignore_errors=True)
        Compiled.keeping = not os.path.exists(FOLDER)  # noqa: PTH110 (never raises)
    elif isinstance(error, OSError) and error.errno is not None:  # a full disk, or a read-only folder
        Compiled.keeping = False
    else:
        return False
    for each in FUNCTIONS:
        each.forget()
    return True


def _is_damaged() -> bool:
    """Return whether a file of the cache cannot be read or unpickled, for instance because it is truncated."""
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
    """Import numba and register `Compiled` with it.

    Raises
    ------
    NumbaSettingsError
        If settings of the user prevent the import or the compilation.
    """
    try:  # importing numba takes longer than importing the rest of the solver
        numba, event = import_module("numba"), import_module("numba.core.event")
        typeof_impl: Any = import_module("numba.extending").typeof_impl
    except Exception as error:
        files = (Path(frame.filename).parts[-3:] for frame in traceback.extract_tb(error.__traceback__))
        if ("numba", "core", "config.py") not in files:
            raise  # numba reads its settings in that file; errors elsewhere have other causes
        cause = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise NumbaSettingsError(f"numba cannot be used with the settings found ({SETTINGS}): {cause}") from error
    if numba.config.DISABLE_JIT:
        raise NumbaSettingsError(f"the settings of numba ({SETTINGS}) forbid it to compile")

    @typeof_impl.register(Compiled)  # type: ignore[untyped-decorator] # numba declares no types
    def type_of_compiled(function: Compiled, _: object) -> Any:
        return numba.typeof(function.dispatcher)

    class Announcement(event.Listener):  # type: ignore[name-defined,misc]
        def on_start(self, event: Any) -> None:
            function = event.data["dispatcher"].py_func
            for each in FUNCTIONS:
                if each.py_func is function:
                    _announce(each)

        def on_end(self, event: Any) -> None:
            """Do nothing; numba calls this method at the end of each compilation."""

    event.register("numba:compile", Announcement())
    return numba


def _announce(function: Compiled) -> None:
    """Record the beginning of a compilation for `compilation_progress`; the first call may also print a message."""
    _announce_first()
    with suppress(OSError):
        FOLDER.mkdir(parents=True, exist_ok=True)
        with BEGUN.open("a") as file:
            file.write(f"{function.name}\n")


@lru_cache(1)
def _announce_first() -> None:
    with suppress(OSError):
        BEGUN.unlink(missing_ok=True)
    left = len(compilation_progress().left)
    # A notebook shows the error stream below the cell, although the stream is not a terminal.
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


# For nested tuples of arrays, the code that converts Python arguments takes longer to compile than the function itself,
# and would be compiled again in each caller.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of functions that Python does not call."""
# These functions allocate nothing. With memory management, each call would increment and decrement the reference count
# of every array argument. numba does not document the option `_nrt`.
LEAN = {"_nrt": False, **INNER}
"""Options of functions that Python does not call and that allocate nothing."""

compiled = _decorator(no_cfunc_wrapper=True)
"""Decorator of compiled functions that Python calls; they release the interpreter lock."""
lean = _decorator(**LEAN)
"""Decorator of functions that only compiled code calls."""
# Without inlining, numba also generates separate machine code for these functions and for everything that they call,
# which is never used. Inlining saves seconds of compilation, but slowed a search by 8 % where a function ran in every
# time step.
once = _decorator(inline="always", **LEAN)
"""Decorator of functions that are inlined into the one or two functions that call them."""
# The hundred arguments of a force evaluation took 7 % of the time of a search to pass, and another 7 % to read.
inlined = _decorator(forceinline=True, **LEAN)
"""Decorator of a function with many arguments that is inlined for speed."""
# Reassociation is not allowed here, since the compiler would use it to distribute a division over every term.
exact = _decorator(fastmath={"contract", "nsz"}, **LEAN)
"""Decorator of functions that compute polynomials or quotients in vectorised loops: fused operations are allowed, and
reassociation is not."""
# A sum in vector registers adds its terms in another order, which these flags allow. Inlining is forced because LLVM
# stopped inlining the loops once the code for walls also called them, which made runs 5 to 8 % slower.
vectorised = _decorator(forceinline=True, fastmath={"contract", "nsz", "arcp", "reassoc"}, **LEAN)
"""Decorator of loops over vectors."""
