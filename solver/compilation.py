"""How the solver's functions are compiled, and where the compiled code is kept.

numba keeps compiled code on disk by the path, date and size of the file a function stands in, and does not see that a
function it calls, in another file, has changed. The solver's code is kept instead by the text of every module that has
compiled functions, and of all that these import: changed code is compiled anew, an installation that is copied, moved
or checked out again is not.

A folder that can only be read will do if the code is in it; what it lacks goes to the user's cache, or is compiled at
each start. Every file ends with its SHA-256, and what does not match is compiled anew: a flipped bit in machine code
would otherwise run. Processes that start together compile each function once, and load what another has compiled.

A wheel for one platform (`make wheel`) and the container image carry code for x86-64-v3, the processors with AVX2, and
for those with AVX-512, which gain a tenth to a fifth: AMD's by registers of 512 bits, Intel's with 256
(`benchmarks/NOTES.md`). It is as fast as code compiled on the machine itself. A processor that it is not for compiles
everything at the first start, as without such a wheel.
"""

import hashlib
import io
import os
import pickle
import platform
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import update_wrapper
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar, cast
from warnings import warn

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name


class Processor(NamedTuple):
    """A level of processors: code compiled for it runs on every processor that has these features."""

    name: str
    """Value of `NUMBA_CPU_NAME`, a processor that LLVM knows."""
    features: str = ""
    """Value of `NUMBA_CPU_FEATURES`, features to switch on (+) or off (-)."""
    needs: tuple[str, ...] = ()
    """Features that a processor must have to run the code."""
    gain: tuple[str, ...] = ("",)
    """First letters of LLVM's names of the processors on which this code is the fastest."""

    @property
    def runs_here(self) -> bool:
        """Whether this machine can run the code."""
        host = get_host_cpu_features()
        return all(host.get(feature) for feature in self.needs)

    @property
    def suits_here(self) -> bool:
        """Whether this is also the fastest code for it."""
        return self.runs_here and get_host_cpu_name().startswith(self.gain)


WITH_512_BITS = ("znver4", "znver5")
"""Processors on which LLVM uses registers of 512 bits."""
WITH_256_BITS = (
    "skylake-avx512",
    "cascadelake",
    "cooperlake",
    "cannonlake",
    "icelake",
    "tigerlake",
    "rocketlake",
    "sapphirerapids",
    "emeraldrapids",
    "graniterapids",
)
"""Processors of Intel with AVX-512, on which 256 bits are faster."""
AVX2 = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
AVX512 = ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl")
PORTABLE = (
    (
        Processor("x86-64-v4", "-prefer-256-bit", AVX2 + AVX512, WITH_512_BITS),
        Processor("skylake-avx512", "", AVX2 + AVX512, WITH_256_BITS),
        Processor("x86-64-v3", "", AVX2),
    )
    if platform.machine() in {"x86_64", "AMD64"}
    else (Processor("generic"),)
)
"""The best first."""


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


def cache_folders() -> list[Path]:
    """Folders of the compiled code: NUMBA_CACHE_DIR if set, else beside the sources; then the user's cache."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    bases = [Path(chosen) if chosen else PACKAGE / "__pycache__"]
    with suppress(RuntimeError):  # a user without a home
        bases.append(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ricochet")
    return [base / f"compiled-{SOURCE_DIGEST}" for base in bases]


def _shipped() -> Processor | None:
    """Return the first processor that this one is like and that there is shipped code for."""
    if os.environ.get("NUMBA_CPU_NAME") or not SHIPPED.is_dir():
        return None
    found = next((each for each in PORTABLE if each.suits_here and (SHIPPED / each.name).is_dir()), None)
    if found is None:
        warn(
            f"this processor is not one that code was shipped for ({', '.join(each.name for each in PORTABLE)}): "
            "the solver is compiled for it now, which takes half a minute or more",
            RuntimeWarning,
            stacklevel=2,
        )
    return found


SOURCE_DIGEST = _source_digest()
FOLDERS = cache_folders()
"""All are read; new code goes to the first that can be written."""
SHIPPED = PACKAGE / "compiled"
"""Where a wheel for this platform has its code, in a folder for each processor."""
SHIPPED_FOR = _shipped()
SHIPPED_FOLDERS = [SHIPPED / SHIPPED_FOR.name / f"compiled-{SOURCE_DIGEST}"] if SHIPPED_FOR else []
CPU = os.environ.get("NUMBA_CPU_NAME") or (SHIPPED_FOR.name if SHIPPED_FOR else get_host_cpu_name())
VECTOR_WIDTH = 8 if CPU.startswith((*WITH_512_BITS, "x86-64-v4")) else 4
"""Numbers that loops take at a time."""

Function = TypeVar("Function", bound=Callable[..., object])

_functions: list["Compiled"] = []
"""All that are compiled, of the modules imported so far."""


class Progress(NamedTuple):
    """How much of the solver is compiled, by this process or another."""

    functions: int
    left: list[str]
    """Functions that no folder has intact code of for this processor."""
    now: str = ""
    """The one of them that is being compiled, the latest if several processes compile; empty if none is."""

    def __str__(self) -> str:
        done = f"{self.functions - len(self.left)} of {self.functions} functions"
        return f"compiling the solver, once on a machine: {done}" + (f", now {self.now}" if self.now else "")


COMPILING = "compiling.txt"
"""File in a folder of compiled code with the name of the function that is being compiled for it."""


def compilation_progress() -> Progress:
    """Return how much is compiled, from the files on disk; numba is not imported."""
    name = os.environ.get("NUMBA_CPU_NAME")
    features = os.environ.get("NUMBA_CPU_FEATURES", "" if name == "generic" else get_host_cpu_features().flatten())
    here = name or get_host_cpu_name(), features
    places = [(folder, here) for folder in FOLDERS]
    if SHIPPED_FOR:
        places += [(folder, (SHIPPED_FOR.name, SHIPPED_FOR.features)) for folder in SHIPPED_FOLDERS]
    left = [each.name for each in _functions if not any(each.is_compiled(*place) for place in places)]
    names = (content.decode() for folder in FOLDERS if (content := _read(folder / COMPILING)) is not None)
    return Progress(len(_functions), left, next((name for name in names if name in left), ""))


def _read(file: Path) -> bytes | None:
    try:
        return file.read_bytes()
    except OSError:
        return None


DIGEST_BYTES = hashlib.sha256().digest_size


def read_intact(file: Path) -> bytes | None:
    """Return the content of a file that ends with its digest, without that; None if it is damaged or cannot be read."""
    whole = _read(file) or b""
    content, digest = whole[:-DIGEST_BYTES], whole[-DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else None


class _Placeholder:
    """Stands for an object of numba in an index, so that numba need not be imported to read it."""

    def __new__(cls, *_: object) -> "_Placeholder":
        return super().__new__(cls)

    def __setstate__(self, _: object) -> None:
        pass


class _IndexReader(pickle.Unpickler):
    """Reads the text and the tuples of an index and nothing else."""

    def find_class(self, _module: str, _name: str) -> type[_Placeholder]:
        return _Placeholder


def _without_avx(features: str) -> list[str]:
    """Return the features that numba does not switch off on some processors."""
    return [each for each in features.split(",") if not each[1:].startswith("avx")]


def can_keep() -> bool:
    """Whether compiled code can be written to one of the folders."""
    for folder in FOLDERS:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
    return any(os.access(folder, os.W_OK) for folder in FOLDERS)


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
        self._made: Any = None

    def __call__(self, *arguments: object) -> object:
        """Compute, in machine code."""
        return self.dispatcher(*arguments)

    def is_compiled(self, folder: Path, processor: tuple[str, str]) -> bool:
        """Return whether a folder has intact code of the function for a processor, by its name and features."""
        code = self.__wrapped__.__code__  # type: ignore[attr-defined]
        version = f"{sys.version_info.major}{sys.version_info.minor}{sys.abiflags}"
        place = folder / Path(code.co_filename).resolve().relative_to(PACKAGE.resolve()).parent
        content = read_intact(place / f"{self.name}-{code.co_firstlineno}.py{version}.nbi")
        if content is None:
            return False
        index = io.BytesIO(content)
        try:
            _IndexReader(index).load()  # the version of numba
            _, overloads = _IndexReader(index).load()
            known = {(name, *_without_avx(features)): data for (_, (_, name, features), _), data in overloads.items()}
        except (pickle.UnpicklingError, TypeError, ValueError):  # of another version of numba
            return False
        name, features = processor
        data = known.get((name, *_without_avx(features)))
        return data is not None and read_intact(place / data) is not None

    @property
    def dispatcher(self) -> Any:
        """numba's object for the function."""
        if self._made is None:
            with _LOCK:
                if self._made is None:
                    self._made = _machine_code().dispatcher(self.__wrapped__, self._options)  # type: ignore[attr-defined]
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
        _functions.append(made)
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
