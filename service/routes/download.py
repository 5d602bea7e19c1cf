"""Results of a whole job as one file: a table of the summaries, or everything as HDF5."""

import os
from collections.abc import AsyncGenerator, AsyncIterator
from io import BufferedReader
from pathlib import Path
from secrets import token_hex

from anyio import CancelScope
from anyio.to_thread import run_sync
from fastapi.responses import StreamingResponse

from service.batches.small import CaseResult
from service.errors import StorageError
from service.jobs.store import JobState
from service.results.hdf5 import BatchFile
from service.routes.items import header, to_rows

CSV = "text/csv"
HDF5 = "application/x-hdf5"
FOLDER = "downloads"
"""Of the data folder: files being written to be sent. Swept at the start of the service."""
PIECE = 256 * 1024
"""Sent at once. [bytes]"""


async def to_csv(slices: AsyncIterator[list[CaseResult]], operation: str) -> AsyncIterator[bytes]:
    """Yield the table of the summaries."""
    yield header(operation)
    async for results in slices:
        yield await run_sync(to_rows, results, operation)


async def send_hdf5(data_dir: Path, job: JobState, slices: AsyncGenerator[list[CaseResult], None]) -> StreamingResponse:
    """Return a file with all the results, which is gone from the disk before it is sent."""
    file = await write_hdf5(data_dir / FOLDER / token_hex(16), job.operation, slices)
    length = await run_sync(file.seek, 0, 2)
    headers = {
        "Content-Length": str(length),
        "Content-Disposition": f'attachment; filename="{job.id}.h5"',
        "Vary": "Accept",
    }
    return StreamingResponse(pieces(file), media_type=HDF5, headers=headers)


async def write_hdf5(path: Path, operation: str, slices: AsyncGenerator[list[CaseResult], None]) -> BufferedReader:
    """Write the results, slice by slice; return the file, open, without a name on the disk any more.

    Raises
    ------
    StorageError
        If the disk has no room for it.
    """
    try:
        await run_sync(lambda: path.parent.mkdir(parents=True, exist_ok=True))
        with await run_sync(BatchFile, path, operation) as batch:
            async for results in slices:
                await run_sync(batch.write, results)
            await run_sync(batch.finish)  # compresses what is left and reads the whole file for its hash
        return await run_sync(path.open, "rb")
    except OSError as error:  # what HDF5 says of it holds the path
        why = os.strerror(error.errno) if error.errno else "the disk refuses it"
        raise StorageError(f"the file cannot be written: {why}") from error
    finally:
        with CancelScope(shield=True):
            await slices.aclose()
            await run_sync(lambda: path.unlink(missing_ok=True))


async def pieces(file: BufferedReader) -> AsyncIterator[bytes]:
    """Yield the content of a file."""
    try:
        await run_sync(file.seek, 0)
        while piece := await run_sync(file.read, PIECE):
            yield piece
    finally:
        file.close()
