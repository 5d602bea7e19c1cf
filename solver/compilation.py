"""How the solver's functions are compiled, and where the compiled code is kept.

numba keeps compiled code on disk by the file a function stands in, and does not see that a function it calls, in
another file, has changed. All of the solver's code therefore goes to a folder named after the text of the whole
package: changed code is compiled anew, never served stale.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from llvmlite.binding import get_host_cpu_name
from numba import config, njit

PACKAGE = Path(__file__).parent


def _source_digest() -> str:
    digest = hashlib.sha256()
    for source in sorted(PACKAGE.rglob("*.py")):
        digest.update(source.relative_to(PACKAGE).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Folder of the compiled code: below NUMBA_CACHE_DIR if set, else beside the sources, else the user's cache."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    beside = PACKAGE / "__pycache__"
    if chosen:
        base = Path(chosen)
    elif os.access(beside if beside.exists() else PACKAGE, os.W_OK):
        base = beside
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "ricochet"
    return base / f"compiled-{_source_digest()}"


VECTOR_WIDTH = 8 if (config.CPU_NAME or get_host_cpu_name()).startswith(("znver4", "znver5")) else 4  # type: ignore[attr-defined]
"""Numbers that loops take at a time. LLVM uses registers of 512 bits on AMD's processors, half of that on Intel's."""

config.CACHE_DIR = str(cache_folder())  # type: ignore[attr-defined] # set from the environment

Function = TypeVar("Function", bound=Callable[..., object])


def _decorator(**options: Any) -> Callable[[Function], Function]:
    return cast(Callable[[Function], Function], njit(cache=True, error_model="numpy", nogil=True, **options))


compiled = _decorator()
"""Decorator of compiled functions that Python calls or that allocate; they release the interpreter lock."""
lean = _decorator(_nrt=False)
"""Of the inner functions, which allocate nothing: without it every array they are handed is counted in and out."""
inlined = _decorator(_nrt=False, forceinline=True)
"""Of an inner function whose many arguments, flattened, would cost as much to hand over as a tenth of its work."""
exact = _decorator(_nrt=False, fastmath={"contract", "nsz"})
"""Of polynomials and quotients inside loops over vectors. Reassociation must not reach them: the compiler would spread
the division over every term."""
vectorised = _decorator(_nrt=False, fastmath={"contract", "nsz", "arcp", "reassoc"})
"""Of loops over vectors; only sums that may be reordered can use vector registers."""
