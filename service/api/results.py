"""Results: many as JSON, JSON lines, CSV or HDF5, and the route of one by its key."""

import csv
import hashlib
import io
import itertools
import os
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterable, Iterator
from http import HTTPStatus
from io import BufferedReader
from pathlib import Path
from secrets import token_hex
from typing import Annotated, Any

import orjson
from anyio import CancelScope
from anyio.to_thread import run_sync
from fastapi import APIRouter, Header, HTTPException, Request, Response
from fastapi import Path as PathParameter
from fastapi.responses import StreamingResponse

from service.api.body import choose, matches
from service.api.contract import Responses, problems
from service.api.services import services_of
from service.auth.dependencies import READ
from service.cache.hdf5 import BatchFile, to_hdf5
from service.cache.record import Record
from service.cache.tables import residuals_of
from service.errors import StorageError
from service.jobs.models import CaseResult, JobState, Sweep
from service.schemas import Result

HDF5 = "application/x-hdf5"
DOWNLOADS = "downloads"
"""Folder of files being written to be sent, in the data folder. Emptied at the start of the service."""
JSON_PIECE = 128 * 1024
"""JSON sent at once. [bytes]"""
FILE_PIECE = 256 * 1024
"""The same of a file. [bytes]"""


def to_item(result: CaseResult, instance: str, sweep: Sweep | None) -> bytes:
    """Return the JSON of a result; a problem gets this path as its instance."""
    head: dict[str, Any] = {"index": result.number}
    if result.custom_id is not None:
        head["custom_id"] = result.custom_id
    if sweep is not None:
        head["point"] = dict(zip(sweep.fields, sweep.point(result.number), strict=True))
    if result.record is None:
        return orjson.dumps({**head, "problem": {**(result.problem or {}), "instance": instance}})
    return b'%b,"result":%b}' % (orjson.dumps(head)[:-1], result.record.json)


def to_lines(results: Iterable[CaseResult], instance: str, sweep: Sweep | None) -> bytes:
    """Return the results as JSON lines."""
    return b"".join(to_item(result, instance, sweep) + b"\n" for result in results)


async def as_lines(blocks: AsyncIterator[list[CaseResult]], instance: str, sweep: Sweep | None) -> AsyncIterator[bytes]:
    """Yield results as JSON lines, some at a time."""
    async for results in blocks:
        for part in in_pieces(to_item(result, instance, sweep) + b"\n" for result in results):
            yield part


async def as_array(
    blocks: AsyncIterator[list[CaseResult]],
    instance: str,
    sweep: Sweep | None,
    end: Callable[[], bytes] = lambda: b"",
) -> AsyncIterator[bytes]:
    """Yield results as one JSON object, some at a time; `end` returns what stands in it after them."""
    separators = itertools.chain([b'{"results":['], itertools.repeat(b","))
    async for results in blocks:
        for part in in_pieces(next(separators) + to_item(result, instance, sweep) for result in results):
            yield part
    yield next(separators).replace(b",", b"") + b"]" + end() + b"}"


def in_pieces(items: Iterable[bytes]) -> Iterator[bytes]:
    """Yield items together: a piece costs as much as some items to send, and a large one holds up others."""
    piece: list[bytes] = []
    size = 0
    for item in items:
        piece.append(item)
        size += len(item)
        if size > JSON_PIECE:
            yield b"".join(piece)
            piece, size = [], 0
    if piece:
        yield b"".join(piece)


async def hdf5_response(
    data_dir: Path, job: JobState, blocks: AsyncGenerator[list[CaseResult], None], sweep: Sweep | None
) -> StreamingResponse:
    """Return a file with all the results, which is gone from the disk before it is sent."""
    file = await write_hdf5(data_dir / DOWNLOADS / token_hex(16), job.operation, blocks, sweep)
    length = await run_sync(file.seek, 0, 2)
    headers = {
        "Content-Length": str(length),
        "Content-Disposition": f'attachment; filename="{job.id}.h5"',
        "Vary": "Accept",
    }
    return StreamingResponse(file_pieces(file), media_type=HDF5, headers=headers)


async def write_hdf5(
    path: Path, operation: str, blocks: AsyncGenerator[list[CaseResult], None], sweep: Sweep | None
) -> BufferedReader:
    """Write the results, block by block; return the file, open, without a name on the disk any more.

    Raises
    ------
    StorageError
        If the disk has no room for it.
    """
    axes = sweep.fields if sweep else ()
    base = orjson.dumps(sweep.request["base"]).decode() if sweep else ""
    try:
        await run_sync(lambda: path.parent.mkdir(parents=True, exist_ok=True))
        with await run_sync(lambda: BatchFile(path, operation, axes=axes, base=base)) as batch:
            async for results in blocks:
                points = [sweep.point(result.number) for result in results] if sweep else []
                await run_sync(batch.write, results, points)
            await run_sync(batch.finish)  # compresses what is left and reads the whole file for its hash
        return await run_sync(path.open, "rb")
    except OSError as error:  # the message of HDF5 holds the path
        why = os.strerror(error.errno) if error.errno else "the disk refuses it"
        raise StorageError(f"the file cannot be written: {why}") from error
    finally:
        with CancelScope(shield=True):
            await blocks.aclose()
            await run_sync(lambda: path.unlink(missing_ok=True))


async def file_pieces(file: BufferedReader) -> AsyncIterator[bytes]:
    """Yield the content of a file."""
    try:
        await run_sync(file.seek, 0)
        while piece := await run_sync(file.read, FILE_PIECE):
            yield piece
    finally:
        file.close()


router = APIRouter(tags=["results"], dependencies=[READ])


def to_csv(record: Record) -> bytes:
    """Return the table of a result.

    The history of a run, or its end if it has none; the trials of a search; the residuals of a calibration.
    """
    if record.operation == "trajectory" and record.history is not None:
        names, columns = list(record.history), [column.tolist() for column in record.history.values()]
    elif residuals := residuals_of(record):
        names, columns = list(residuals), list(residuals.values())
    else:
        records = [record.answer["final"]] if record.operation == "trajectory" else record.answer["iterations"]
        names = [name for name in records[0] if name != "exit"]
        columns = [[each[name] for each in records] for name in names]
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(names)
    for row in zip(*columns, strict=True):  # all at once would hold the interpreter lock until the last
        writer.writerow(row)
    return text.getvalue().encode()


REPRESENTATIONS: dict[str, Callable[[Record], bytes]] = {
    "application/json": lambda record: record.json,
    "text/csv": to_csv,
    "application/x-hdf5": to_hdf5,
}
"""Every form a result is given in, the usual one first."""

DECLARED: Responses = {
    200: {
        "description": "The result, in the form that `Accept` names.",
        "headers": {"ETag": {"description": "Of this form; strong.", "schema": {"type": "string"}, "required": True}},
        "content": {"text/csv": {"schema": {"type": "string"}}, "application/x-hdf5": {}},
    },
    304: {"description": "The client has this form of the result."},
    **problems(404, 406, 422, 500),
}
KEY = {"pattern": "^[0-9a-f]{64}$"}


@router.get("/results/{key}", response_model=Result, responses=DECLARED)
async def get_result(
    request: Request,
    key: Annotated[str, PathParameter(description="Of an answer.", json_schema_extra=KEY)],
    if_none_match: Annotated[str, Header(alias="If-None-Match", description="Entity tags the client has.")] = "",
) -> Response:
    """Give the result with this key: JSON, CSV or HDF5 (all of it).

    CSV is the history of a run, the trials of a search, the residuals of a calibration.
    """
    media_type = choose(request.headers.get("accept", "*/*"), list(REPRESENTATIONS))
    if media_type is None:
        raise HTTPException(HTTPStatus.NOT_ACCEPTABLE, f"a result is given as {', '.join(REPRESENTATIONS)}")
    record = await services_of(request).queries.result(key)
    if record is None:
        raise HTTPException(HTTPStatus.NOT_FOUND, "no result is kept under this key")
    content = await run_sync(REPRESENTATIONS[media_type], record)
    headers = {"ETag": f'"{hashlib.sha256(content).hexdigest()[:32]}"', "Vary": "Accept"}
    if matches(if_none_match, headers["ETag"]):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    return Response(content, media_type=media_type, headers=headers)
