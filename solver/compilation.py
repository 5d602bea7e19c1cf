"""How the solver's functions are compiled, and where the compiled code is kept.

numba keeps compiled code on disk by the path, date and size of the file a function stands in, and does not see that a
function it calls, in another file, has changed. The solver's code is kept instead by the text of every module that has
compiled functions, and of all that these import: changed code is compiled anew, an installation that is copied, moved
or checked out again is not.

A folder that can only be read will do if the code is in it; what it lacks goes to the user's cache, or is compiled at
each start. Every file ends with its SHA-256, and what does not match is compiled anew: a flipped bit in machine code
would otherwise run. Processes that start together compile one at a time and load what the others have compiled.

A wheel for one platform (`make wheel`) and the container image carry code for x86-64-v3, the processors with AVX2,
which is as fast as code for the very processor. On an older one everything is compiled at the first start, as without.
"""

import fcntl
import hashlib
import io
import os
import platform
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast
from warnings import warn

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name
from numba import config, njit, typeof
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, _CacheLocator
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import TypingError
from numba.extending import intrinsic

PACKAGE = Path(__file__).parent
IMPORT = re.compile(rf"^\s*from {__package__}([.\w]*) import (\([^)]*\)|.*)$", re.MULTILINE)
LOCK_SECONDS = 900.0
"""How long another process may compile before this one does the same: longer than all of the solver takes."""
DIGEST_BYTES = hashlib.sha256().digest_size
IS_X86 = platform.machine() in {"x86_64", "AMD64"}
PORTABLE_CPU = "x86-64-v3" if IS_X86 else "generic"
"""Processors that shipped code is compiled for, by LLVM's name."""
PORTABLE_FEATURES = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe") if IS_X86 else ()
"""What they have and earlier ones lack."""


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


def _chosen_cpu() -> str:
    """Return the processor to compile for; a chosen one that this machine is not is replaced in numba's settings."""
    chosen: str | None = config.CPU_NAME  # type: ignore[attr-defined]
    if chosen == "x86-64-v3" and not (IS_X86 and IS_PORTABLE):
        if IS_X86:
            warn(
                "this processor lacks AVX2 or others of x86-64-v3: the solver is compiled for it now, "
                "which takes one to three minutes",
                RuntimeWarning,
                stacklevel=2,
            )
        config.CPU_NAME = chosen = "generic"  # type: ignore[attr-defined]
    if not chosen and SHIPPED.is_dir() and IS_PORTABLE:
        return PORTABLE_CPU
    return chosen or get_host_cpu_name()


SOURCE_DIGEST = _source_digest()
FOLDERS = cache_folders()
"""All are read; new code goes to the first that can be written."""
SHIPPED = PACKAGE / "compiled" / f"compiled-{SOURCE_DIGEST}"
"""Code that a wheel for this platform carries."""
IS_PORTABLE = all(get_host_cpu_features().get(feature) for feature in PORTABLE_FEATURES)
CPU = _chosen_cpu()


class _Locator(_CacheLocator):
    """Names the files of a function by its place in the package."""

    def __init__(self, function: Callable[..., object], file: str) -> None:
        self._py_file = file
        self._line = function.__code__.co_firstlineno
        self._folder = Path(file).resolve().relative_to(PACKAGE.resolve()).parent

    @classmethod
    def from_function(cls, function: Callable[..., object], file: str) -> "_Locator":
        return cls(function, file)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return SOURCE_DIGEST

    def get_disambiguator(self) -> str:
        return str(self._line)

    def ensure_cache_path(self) -> None:
        """Do nothing: folders are made when code is written."""


class _CheckedFile(IndexDataCacheFile):
    """numba's files of a function in one folder, each with its digest at the end; a damaged one counts as absent."""

    def _load_index(self) -> dict[Any, str]:
        return super()._load_index() if _is_intact(self._index_path) else {}

    def _load_data(self, name: str) -> Any:
        if not _is_intact(self._data_path(name)):
            raise FileNotFoundError(name)
        return super()._load_data(name)

    @contextmanager
    def _open_for_write(self, path: str) -> Iterator[BinaryIO]:
        content = io.BytesIO()
        yield content
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with super()._open_for_write(path) as file:
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())


def _is_intact(path: str) -> bool:
    try:
        content = Path(path).read_bytes()
    except OSError:
        return False
    return hashlib.sha256(content[:-DIGEST_BYTES]).digest() == content[-DIGEST_BYTES:]


class _Files:
    """The files of a function in all folders, as numba uses those in one."""

    def __init__(self, folder: str, name: str) -> None:
        self._files = [_CheckedFile(str(base / folder), name, SOURCE_DIGEST) for base in FOLDERS]
        self._shipped = _CheckedFile(str(SHIPPED / folder), name, SOURCE_DIGEST) if CPU == PORTABLE_CPU else None

    def load(self, key: Any) -> object:
        sources = [(files, key) for files in self._files]
        if self._shipped is not None:
            signature, (triple, _, _), hashes = key  # numba's, with the processor's name and features
            sources.insert(0, (self._shipped, (signature, (triple, PORTABLE_CPU, ""), hashes)))
        for files, known_as in sources:
            found = cast("tuple[object, object] | None", files.load(known_as))
            if found and found[0] == known_as:
                return found[1]
        return None

    def save(self, key: object, data: object) -> None:
        for files in self._files:
            with suppress(OSError):  # read-only, full or gone
                files.save(key, (key, data))  # the key too: a writer may be killed between index and data
                return

    def flush(self) -> None:
        for files in self._files:
            with suppress(OSError):
                files.flush()


class _LocatedCode(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012 (as in its base)


class _Cache(FunctionCache):
    """numba's cache of a function, over these files."""

    _impl_class = _LocatedCode

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        self._cache_file = _Files(self._cache_path, self._impl.filename_base)  # type: ignore[assignment]


class _ProcessLock:
    """Lets one process compile at a time; held and counted under numba's own lock, which lets one thread."""

    def __init__(self) -> None:
        self._depth = 0
        self._folder: int | None = None

    def __enter__(self) -> None:
        if self._depth == 0:
            self._folder = _lock_folder()
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth == 0 and self._folder is not None:
            os.close(self._folder)


def _lock_folder() -> int | None:
    """Return the open folder that is locked; None if none can be."""
    deadline = time.monotonic() + LOCK_SECONDS
    for folder in FOLDERS:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
        with suppress(OSError):
            opened = os.open(folder, os.O_RDONLY)
            while time.monotonic() < deadline:
                try:
                    fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    time.sleep(0.02)
                except OSError:  # a file system without locks
                    break
                else:
                    return opened
            os.close(opened)
    return None


_LOCK = _ProcessLock()


VECTOR_WIDTH = 8 if CPU.startswith(("znver4", "znver5")) else 4
"""Numbers that loops take at a time. LLVM uses registers of 512 bits on AMD's processors, half of that on Intel's."""

Function = TypeVar("Function", bound=Callable[..., object])

_functions: list[Callable[..., object]] = []
"""All that are compiled, of the modules imported so far."""


def compilation_progress() -> tuple[int, int]:
    """Return how many functions have compiled code on disk, from this process or another, and how many there are."""
    folders = [*FOLDERS, SHIPPED]
    found = {file.relative_to(folder) for folder in folders for file in folder.rglob("*.nbi")}
    return min(len(found), len(_functions)), len(_functions)


def _decorator(**options: Any) -> Callable[[Function], Function]:
    def compile_and_keep(function: Function) -> Function:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return function
        _functions.append(function)
        dispatcher = njit(error_model="numpy", nogil=True, **options)(function)
        dispatcher._cache = _Cache(function)  # noqa: SLF001 (there is no other way to give it one)
        compile_here = dispatcher.compile

        def compile_alone(signature: object) -> object:
            with global_compiler_lock, _LOCK:
                return compile_here(signature)

        dispatcher.compile = compile_alone
        return cast(Function, dispatcher)

    return compile_and_keep


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
vectorised = _decorator(_nrt=False, fastmath={"contract", "nsz", "arcp", "reassoc"}, **INNER)
"""Decorator of loops over vectors; only sums that may be reordered can use vector registers."""


_addressed: set[tuple[object, ...]] = set()
"""Types of arguments for which an address was made."""


def address_of(function: Callable[..., object], *arguments: object) -> Any:
    """Return the address of an inner function for arguments of these types, compiled or loaded if need be."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    signature = tuple(typeof(argument) for argument in arguments)
    _addressed.add(signature)
    dispatcher = cast(Any, function)
    dispatcher.compile(signature)
    result = dispatcher.overloads[signature]
    return result.library.get_pointer_to_function(result.fndesc.llvm_func_name)


def keep_types(function: Callable[..., object]) -> None:
    """Let a function that calls an address take no other types than so far, for which the address is not made."""
    if not config.DISABLE_JIT:  # type: ignore[attr-defined]
        cast(Any, function).disable_compile()


@intrinsic
def _call(_typing: Any, address: Any, arguments: Any, example: Any) -> tuple[Any, Callable[..., Any]]:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        convention, types = context.call_conv, signature.args[1].types
        kind = convention.get_function_type(signature.return_type, types).as_pointer()
        unpacked = [builder.extract_value(values[1], i) for i in range(len(types))]
        status, result = convention.call_function(
            builder, builder.inttoptr(values[0], kind), signature.return_type, types, unpacked
        )
        with builder.if_then(status.is_error, likely=False):
            convention.return_status_propagate(builder, status)
        return result

    if tuple(arguments.types) not in _addressed:  # the function would read them as something else
        raise TypingError(f"no address was made for arguments of the types {arguments.types}")
    return example(address, arguments, example), generate


def _call_in_python(address: Callable[..., object], arguments: tuple[object, ...], _: object) -> object:
    return address(*arguments)


call_address: Any = _call_in_python if config.DISABLE_JIT else _call  # type: ignore[attr-defined]
"""Call the compiled function at an address with a tuple of arguments, of the types the address was made for; the third
argument is an example of its result. The caller is compiled without the function: else all of the integrator would be
optimised again in each function of a search."""
