"""Memory that is free, but kept by the C library, given back to the system.

Each thread takes memory from its own heap, where what lives long pins pages of what did not: left alone, a service
under a mixed load grows for hours, though it holds no more than before.
"""

import asyncio
import ctypes
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache

from anyio.to_thread import run_sync

SECONDS = 20.0
"""Between two times that memory is given back, a few milliseconds of a thread each."""
MOST_HEAPS = 2
"""The library would have eight for each core."""
M_ARENA_MAX = -8
"""Name of that option in <malloc.h> of glibc."""


@asynccontextmanager
async def kept_small() -> AsyncIterator[None]:
    """Have few heaps, and give back what is free in them every now and then."""
    if library := _glibc():
        library.mallopt(M_ARENA_MAX, MOST_HEAPS)
    giving = asyncio.create_task(_keep_on())
    try:
        yield
    finally:
        giving.cancel()


def give_back() -> None:
    """Give back what is free now; nothing is done where the C library is not glibc."""
    if library := _glibc():
        library.malloc_trim(0)


async def _keep_on() -> None:
    while True:
        await asyncio.sleep(SECONDS)
        await run_sync(give_back)


@cache
def _glibc() -> ctypes.CDLL | None:
    library = ctypes.CDLL(None)
    return library if hasattr(library, "malloc_trim") else None
