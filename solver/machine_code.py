"""numba behind the decorators of `solver.compilation`: its cache in a folder of ours, and calls by address.

Imported when the first compiled function is called, since numba takes half of the time to import the solver.
"""

import fcntl
import hashlib
import os
import shutil
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from numba import njit, typeof
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, InTreeCacheLocator, NullCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import NumbaError, TypingError
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys
from numba.extending import intrinsic

from solver.compilation import COMPILING, FOLDER, PACKAGE, Compiled, compilation_progress

LONG = 10
"""Functions that take some seconds to compile."""


class Locator(InTreeCacheLocator):
    """Keeps code in the solver's folder, which numba's locators refuse where it can only be read."""

    def __init__(self, function: Callable[..., object], file: str) -> None:
        super().__init__(function, file)
        self._cache_path = str(FOLDER / Path(file).resolve().relative_to(PACKAGE.resolve()).parent)

    @classmethod
    def from_function(cls, function: Callable[..., object], file: str) -> "Locator":
        """Return the place of a function, though nothing may be written there."""
        return cls(function, file)


class CheckedFiles(IndexDataCacheFile):
    """numba's files of a function, code with its digest at the end: changed by one bit it would otherwise run."""

    def _save_data(self, name: str, data: object) -> None:
        pickled = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(pickled + hashlib.sha256(pickled).digest())

    def _load_data(self, name: str) -> Any:
        pickled = Path(self._data_path(name)).read_bytes()
        size = len(pickled) - hashlib.sha256().digest_size
        if hashlib.sha256(pickled[:size]).digest() != pickled[size:]:
            raise ValueError(f"{name} is damaged")
        return super()._load_data(name)


class LocatedCode(CompileResultCacheImpl):
    """Compiled code of a function, with its place."""

    _locator_classes = [Locator]  # noqa: RUF012 (as in its base)


class Cache(FunctionCache):
    """numba's cache of a function, which reads code without first loading all that numba can compile.

    That, a third of the time to the first result, is left to when something is compiled.
    """

    _impl_class = LocatedCode

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        self._cache_file.__class__ = CheckedFiles

    def load_overload(self, sig: object, target_context: Any) -> Any:
        """Return the compiled function for these types of arguments; None if there is none."""
        rtsys.initialize(target_context)
        found = self._load_overload(sig, target_context)
        if found is None:
            _import_array_functions()
        return found


def _import_array_functions() -> None:
    """Import those of numba without the check that SciPy is there: it is, and its import takes a fifth of a second."""
    from numba.np import linalg  # noqa: PLC0415 (see above)

    check, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    try:
        import numba.np.arraymath  # noqa: F401, PLC0415 (runs the check)
    finally:
        linalg.ensure_blas = check


@lru_cache(1)
def _announce() -> None:
    """Write to a terminal, once in a process, that much has to be compiled before the first result."""
    left = len(compilation_progress().left)
    if left > LONG and sys.stderr is not None and sys.stderr.isatty():
        sys.stderr.write(f"compiling the solver, once on a machine: {left} functions, about half a minute\n")


_begun: list[str] = []
"""Functions that are being compiled in this process, each called by those before it."""


@contextmanager
def _shown(name: str) -> Iterator[None]:
    """Name a function where `solver.compilation.compilation_progress` finds it, while it is compiled."""
    _announce()
    _begun.append(name)
    _write_begun()
    try:
        yield
    finally:
        _begun.pop()
        _write_begun()


def _write_begun() -> None:
    with suppress(OSError):
        FOLDER.mkdir(parents=True, exist_ok=True)
        COMPILING.write_text(_begun[-1] if _begun else "")


@lru_cache(1)
def _lock_file() -> int | None:
    """Return the open file that is locked in parts, one for each function; None if there can be none."""
    with suppress(OSError):
        FOLDER.parent.mkdir(parents=True, exist_ok=True)
        return os.open(FOLDER.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    return None


@contextmanager
def _one_process(name: str) -> Iterator[None]:
    """Let one process compile a function at a time; others may be compiled beside it.

    numba numbers the files of a function, and two processes that add one at the same time would take the same number.
    Functions are locked after those that call them, so that two processes never wait for each other.
    """
    file, part = _lock_file(), zlib.crc32(name.encode())
    if file is None:
        yield
        return
    with suppress(OSError):  # a file system without locks
        fcntl.lockf(file, fcntl.LOCK_EX, 1, part)
    try:
        yield
    finally:
        with suppress(OSError):
            fcntl.lockf(file, fcntl.LOCK_UN, 1, part)


def dispatcher(compiled: Compiled, options: dict[str, Any]) -> Any:
    """Return numba's object for a function, which compiles or loads it for arguments of new types."""
    function: Any = compiled.__wrapped__  # type: ignore[attr-defined]
    made = njit(error_model="numpy", nogil=True, **options)(function)
    made._cache = Cache(function)  # noqa: SLF001 (as its own `enable_caching` does)
    compile_here = made.compile

    def compile_alone(signature: object) -> object:
        with global_compiler_lock, _one_process(compiled.name):
            if compiled.is_compiled:
                return load(signature)
            with _shown(compiled.name):
                return load(signature)

    def load(signature: object) -> object:
        try:
            return compile_here(signature)
        except NumbaError:
            raise
        except Exception:  # noqa: BLE001 (unpickling a damaged file raises anything)
            # Either a file is damaged, and with the folder gone the function is compiled; or it is compiled but could
            # not be written, and numba returns what it has. A folder that can only be read stays, and is not used.
            shutil.rmtree(FOLDER, ignore_errors=True)
            if FOLDER.exists():
                made._cache = NullCache()  # noqa: SLF001
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
