"""How the solver's functions are compiled, and where the compiled code is kept.

numba keeps compiled code on disk by the file a function stands in, and does not see that a function it calls, in
another file, has changed. All of the solver's code therefore goes to a folder named after the text of the whole
package: changed code is compiled anew, never served stale.
"""

import hashlib
import os
from pathlib import Path

from numba import config, njit

PACKAGE = Path(__file__).parent


def _source_digest() -> str:
    digest = hashlib.sha256()
    for source in sorted(PACKAGE.glob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
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


config.CACHE_DIR = str(cache_folder())  # type: ignore[attr-defined] # set from the environment

compiled = njit(cache=True, error_model="numpy")
"""Decorator of every compiled function."""
