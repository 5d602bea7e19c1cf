"""How the solver's functions are compiled, and where the compiled code is kept.

numba keeps compiled code on disk by the file that a function stands in, and does not see that a function it calls, in
another file, has changed. Here its cache is a folder named by the digest of every module that has compiled functions
and all that these import, of the versions of Python, numba and llvmlite, and of the processor. Changed code goes to
another folder, an installation that is copied or checked out again finds its code, and a folder that numba cannot read
is deleted and filled again (`solver.machine_code`).

The container image carries code for x86-64-v3, the processors with AVX2, and for those with AVX-512 of AMD and of Intel
(`entry-point.sh`): as fast as code compiled on the machine itself (`benchmarks/NOTES.md`).
"""

import hashlib
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import update_wrapper
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar, cast

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

WITH_512_BITS = ("znver4", "znver5")
"""Processors on which LLVM uses registers of 512 bits."""
PACKAGE = Path(__file__).parent
IMPORT = re.compile(rf"^\s*from {__package__}([.\w]*) import (\([^)]*\)|.*)$", re.MULTILINE)
JIT = os.environ.get("NUMBA_DISABLE_JIT", "0") in {"", "0"}
"""Whether anything is compiled."""


def _source_digest() -> str:
    texts = {source.relative_to(PACKAGE).as_posix(): source.read_bytes() for source in PACKAGE.rglob("*.py")}
    imports = {name: set(_imported(text)) & texts.keys() for name, text in texts.items()}
    waiting = [name for name in imports if "compilation.py" in imports[name]]
    wanted: set[str] = set()
    while waiting:
        wanted.add(name := waiting.pop())
        waiting += imports[name] - wanted
    digest = hashlib.sha256()
    for name in sorted(wanted):
        digest.update(name.encode() + b"\0" + texts[name] + b"\0")
    return digest.hexdigest()[:16]


def _imported(text: bytes) -> Iterator[str]:
    """Paths that the imports of a module may stand for: those of modules, or of names in packages."""
    for module, names in IMPORT.findall(text.decode()):
        path = module.replace(".", "/").lstrip("/")
        yield f"{path}.py"
        yield f"{path}/__init__.py".lstrip("/")
        for name in re.findall(r"\w+", names):
            yield f"{path}/{name}.py".lstrip("/")


def _folder_name(cpu: str) -> str:
    """Return the name of a folder of compiled code: a digest of all that the code depends on."""
    features = os.environ.get("NUMBA_CPU_FEATURES", "" if cpu == "generic" else get_host_cpu_features().flatten())
    versions = sys.version, version("numba"), version("llvmlite")
    parts = "\0".join((_source_digest(), cpu, features, *versions))
    return f"compiled-{hashlib.sha256(parts.encode()).hexdigest()[:16]}"


def _can_write(folder: Path) -> bool:
    """Return whether a folder can be written to, or made."""
    existing = next(each for each in (folder, *folder.parents) if each.exists())
    return existing.is_dir() and os.access(existing, os.W_OK)


def _choose_folder() -> Path:
    """Return the folder in NUMBA_CACHE_DIR if that is set, else beside the sources; failing that the user's cache.

    A folder that can only be read is chosen if it holds code. Where none will do, every start compiles.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    bases = [Path(chosen) if chosen else PACKAGE / "__pycache__"]
    with suppress(RuntimeError):  # a user without a home
        bases.append(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ricochet")
    name = _folder_name(CPU)
    folders = [base.absolute() / name for base in bases]
    return next((each for each in folders if _can_write(each) or any(each.rglob("*.nbi"))), folders[0])


CPU = os.environ.get("NUMBA_CPU_NAME") or get_host_cpu_name()
VECTOR_WIDTH = 8 if CPU.startswith((*WITH_512_BITS, "x86-64-v4")) else 4
"""Numbers that loops take at a time."""
FOLDER = _choose_folder()
"""Where compiled code is read and kept."""

Function = TypeVar("Function", bound=Callable[..., object])

FUNCTIONS: list["Compiled"] = []
"""All compiled functions of the modules imported so far."""


class Progress(NamedTuple):
    """How much of the solver is compiled, by this process or another."""

    functions: int
    left: list[str]
    """Functions of which there is no compiled code yet."""
    now: str = ""
    """The one of them that is being compiled, the latest if several processes compile; empty if none is."""

    def __str__(self) -> str:
        done = f"{self.functions - len(self.left)} of {self.functions} functions"
        return f"compiling the solver, once on a machine: {done}" + (f", now {self.now}" if self.now else "")


COMPILING = FOLDER / "compiling.txt"
"""File with the name of the function that is being compiled."""


def compilation_progress() -> Progress:
    """Return how much is compiled, from the files on disk; numba is not imported."""
    left = [each.name for each in FUNCTIONS if not each.is_compiled]
    try:
        now = COMPILING.read_text()
    except OSError:
        now = ""
    return Progress(len(FUNCTIONS), left, now if now in left else "")


def can_keep() -> bool:
    """Whether compiled code can be written to the folder."""
    return _can_write(FOLDER)


class Compiled:
    """A function that numba compiles, or loads, when it is first needed; numba itself is imported then.

    Parameters
    ----------
    function
        In Python.
    options
        Options of `numba.njit`.
    """

    def __init__(self, function: Callable[..., object], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self.name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        """Module and function, as numba names its files."""
        self._options = options
        self.is_entry_point = "no_cpython_wrapper" not in options
        """Whether Python can call it."""
        self._made: Any = None

    def __call__(self, *arguments: object) -> object:
        """Compute, in machine code."""
        return self.dispatcher(*arguments)

    @property
    def subfolder(self) -> Path:
        """Folder of the module in the package."""
        return Path(self.__wrapped__.__code__.co_filename).resolve().relative_to(PACKAGE.resolve()).parent  # type: ignore[attr-defined]

    @property
    def is_compiled(self) -> bool:
        """Whether the folder has code of the function; numba writes its index, a file of this name, at the end."""
        line = self.__wrapped__.__code__.co_firstlineno  # type: ignore[attr-defined]
        python = f"{sys.version_info.major}{sys.version_info.minor}{sys.abiflags}"
        return (FOLDER / self.subfolder / f"{self.name}-{line}.py{python}.nbi").exists()

    @property
    def dispatcher(self) -> Any:
        """numba's object for the function."""
        if self._made is None:
            with _LOCK:
                if self._made is None:
                    self._made = _machine_code().dispatcher(self, self._options)
        return self._made

    @property
    def _numba_type_(self) -> Any:
        """What compiled code that calls the function takes it for."""
        return self.dispatcher._numba_type_


_LOCK = threading.RLock()


def _machine_code() -> ModuleType:
    return import_module(f"{__package__}.machine_code")


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

compiled = _decorator(no_cfunc_wrapper=True)
"""Decorator of compiled functions that Python calls; they release the interpreter lock."""
inner = _decorator(**INNER)
"""Decorator of functions that only compiled code calls, and that allocate."""
lean = _decorator(_nrt=False, **INNER)
"""Decorator of those that allocate nothing: without it every array they are handed is counted in and out."""
inlined = _decorator(_nrt=False, forceinline=True, **INNER)
"""Decorator of a lean function whose many arguments would cost as much to hand over as a tenth of its work."""
exact = _decorator(_nrt=False, fastmath={"contract", "nsz"}, **INNER)
"""Decorator of polynomials and quotients in loops over vectors. Reassociation must not reach them: the compiler would
spread the division over every term."""
vectorised = _decorator(_nrt=False, forceinline=True, fastmath={"contract", "nsz", "arcp", "reassoc"}, **INNER)
"""Decorator of loops over vectors; only sums that may be reordered can use vector registers."""


def address_of(function: Callable[..., object], *arguments: object) -> Any:
    """Return the address of an inner function for arguments of these types, compiled or loaded if need be."""
    return _machine_code().address_of(cast(Any, function).dispatcher, arguments) if JIT else function


def expect_address(*arguments: object) -> None:
    """Let functions be compiled that call the address of a function of these types, before that function is."""
    if JIT:
        _machine_code().expect_address(arguments)


def keep_types(function: Callable[..., object]) -> None:
    """Let a function that calls an address take no other types than so far, for which the address is not made."""
    if JIT:
        cast(Any, function).dispatcher.disable_compile()


class _AddressCall:
    """Calls the function at an address."""

    def __call__(self, address: Callable[..., object], arguments: tuple[object, ...], _: object) -> object:
        return address(*arguments)  # without compiled code, the function itself

    @property
    def _numba_type_(self) -> Any:
        return _machine_code().type_of_call()


call_address: Any = _AddressCall()
"""Call the compiled function at an address with a tuple of arguments, of the types the address was made for; the third
argument is an example of its result. The caller is compiled without the function: else all of the integrator would be
optimised again in each function of a search."""
