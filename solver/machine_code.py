"""numba behind the decorators of `solver.compilation`: its cache in files of our own, and calls by address.

Imported when the first compiled function is called, since numba takes half of the time to import the solver.
"""

import fcntl
import hashlib
import io
import os
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, cast

from numba import njit, typeof
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, _CacheLocator
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import TypingError
from numba.core.registry import cpu_target
from numba.extending import intrinsic
from numba.np import linalg

from solver.compilation import (
    COMPILING,
    FOLDERS,
    PACKAGE,
    SHIPPED_FOLDERS,
    SHIPPED_FOR,
    SOURCE_DIGEST,
    compilation_progress,
    read_intact,
)

LOCK_SECONDS = 900.0
"""How long another process may compile before this one does the same: longer than all of the solver takes."""
LONG = 10
"""Functions that take some seconds to compile."""


def _import_array_functions() -> None:
    """Import those of numba without the check that SciPy is there: it is, and its import takes a fifth of a second."""
    check, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    try:
        import numba.np.arraymath  # noqa: F401, PLC0415 (runs the check)
    finally:
        linalg.ensure_blas = check


_import_array_functions()


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
        return super()._load_index() if read_intact(Path(self._index_path)) is not None else {}

    def _load_data(self, name: str) -> Any:
        if read_intact(Path(self._data_path(name))) is None:
            raise FileNotFoundError(name)
        return super()._load_data(name)

    @contextmanager
    def _open_for_write(self, path: str) -> Iterator[BinaryIO]:
        content = io.BytesIO()
        yield content
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with super()._open_for_write(path) as file:
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())


@lru_cache(1)
def _announce() -> None:
    """Write to a terminal, once in a process, that much has to be compiled before the first result."""
    left = len(compilation_progress().left)
    if left > LONG and sys.stderr is not None and sys.stderr.isatty():
        sys.stderr.write(f"compiling the solver, once on a machine: {left} functions, about half a minute\n")


_begun: list[str] = []
"""Functions that are being compiled in this process, each called by those before it."""


def _write_begun() -> None:
    """Write the last of them where `solver.compilation.compilation_progress` finds it."""
    for folder in FOLDERS:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if _begun:
                (folder / COMPILING).write_text(_begun[-1])
            else:
                (folder / COMPILING).unlink(missing_ok=True)
            return


class _Files:
    """The files of a function in all folders, as numba uses those in one."""

    def __init__(self, folder: str, name: str) -> None:
        self._function = name.rpartition("-")[0]
        self._files = [_CheckedFile(str(base / folder), name, SOURCE_DIGEST) for base in FOLDERS]
        self._shipped = [_CheckedFile(str(base / folder), name, SOURCE_DIGEST) for base in SHIPPED_FOLDERS]

    def load(self, key: Any) -> object:
        sources = [(files, key) for files in self._files]
        if SHIPPED_FOR is not None:
            signature, (triple, _, _), hashes = key  # numba's, with the processor's name and features
            known_as = signature, (triple, SHIPPED_FOR.name, SHIPPED_FOR.features), hashes
            sources = [*((files, known_as) for files in self._shipped), *sources]
        for files, known_as in sources:
            found = cast("tuple[object, object] | None", files.load(known_as))
            if found and found[0] == known_as:
                return found[1]
        _announce()
        _begun.append(self._function)
        _write_begun()
        return None

    def save(self, key: object, data: object) -> None:
        if self._function in _begun:
            _begun.remove(self._function)
            _write_begun()
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


LOCK_FILE = Path(tempfile.gettempdir()) / f"ricochet-{os.getuid()}-{SOURCE_DIGEST}.lock"


@lru_cache(1)
def _lock_file() -> int | None:
    """Return the open file that is locked in parts, one for each function; None if there can be none."""
    with suppress(OSError):
        return os.open(LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    return None


@contextmanager
def _one_process(function: Callable[..., object]) -> Iterator[None]:
    """Let one process compile a function at a time, for `LOCK_SECONDS` at most; others may be compiled beside it.

    Functions are locked after those that call them, so that two processes never wait for each other.
    """
    file, part = _lock_file(), zlib.crc32(f"{function.__module__}.{function.__qualname__}".encode())
    deadline = time.monotonic() + LOCK_SECONDS
    while file is not None and time.monotonic() < deadline:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, part)
        except (BlockingIOError, PermissionError):
            time.sleep(0.02)
        except OSError:  # a file system without locks
            break
        else:
            break
    try:
        yield
    finally:
        if file is not None:
            with suppress(OSError):
                fcntl.lockf(file, fcntl.LOCK_UN, 1, part)


def dispatcher(function: Callable[..., object], options: dict[str, Any]) -> Any:
    """Return numba's object for a function, which compiles or loads it for arguments of new types."""
    made = njit(error_model="numpy", nogil=True, **options)(function)
    made._cache = _Cache(function)  # noqa: SLF001 (there is no other way to give it one)
    compile_here = made.compile

    def compile_alone(signature: object) -> object:
        with global_compiler_lock, _one_process(function):
            return compile_here(signature)

    made.compile = compile_alone
    return made


_addressed: set[tuple[object, ...]] = set()
"""Types of arguments for which there is an address, or will be."""


def expect_address(arguments: tuple[object, ...]) -> tuple[object, ...]:
    """Let functions be compiled that call an address with arguments of these types; return the types."""
    signature = tuple(typeof(argument) for argument in arguments)
    _addressed.add(signature)
    return signature


def address_of(made: Any, arguments: tuple[object, ...]) -> Any:
    """Return the address of the function of a dispatcher for arguments of these types."""
    signature = expect_address(arguments)
    made.compile(signature)
    result = made.overloads[signature]
    return result.library.get_pointer_to_function(result.fndesc.llvm_func_name)


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


def type_of_call() -> Any:
    """Return the type of `solver.compilation.call_address` in compiled code."""
    return cpu_target.typing_context.resolve_value_type(_call)
