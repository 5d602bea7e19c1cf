"""Results in every form: many as JSON, JSON lines, HDF5 or a table, CSV or Parquet; and the route of one by its key.

Parquet needs the extra `parquet`.
"""

import csv
import hashlib
import io
import itertools
import os
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterable, Iterator, Sequence
from http import HTTPStatus
from importlib.util import find_spec
from io import BufferedReader
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, Annotated, Any

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
from service.columns import Column, batch_columns, batch_row, csv_cells
from service.errors import StorageError
from service.jobs.models import CaseResult, JobState, Sweep
from service.schemas import Result

if TYPE_CHECKING:
    from pyarrow import DataType

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


CSV = "text/csv"
PARQUET = "application/vnd.apache.parquet"
GROUP_ROWS = 4096
"""Rows of a row group: some megabytes, which is all of the table that is in memory at once."""


def csv_head(operation: str, sweep: Sweep | None) -> bytes:
    """Return what stands before the rows: the base of a sweep as a comment, the names of the columns."""
    names = _lines([[column.name for column in batch_columns(operation, sweep.fields if sweep else ())]])
    return names if sweep is None else b"# base: %b\r\n" % orjson.dumps(sweep.request["base"]) + names


def csv_rows(results: Iterable[CaseResult], operation: str, sweep: Sweep | None) -> bytes:
    """Return the rows of these results."""
    return _lines(_row(result, operation, sweep) for result in results)


async def as_csv(blocks: AsyncIterator[list[CaseResult]], operation: str, sweep: Sweep | None) -> AsyncIterator[bytes]:
    """Yield the table of the summaries."""
    yield csv_head(operation, sweep)
    async for results in blocks:
        yield await run_sync(csv_rows, results, operation, sweep)


def _row(result: CaseResult, operation: str, sweep: Sweep | None) -> list[Any]:
    item: dict[str, Any] = {"index": result.number, "custom_id": result.custom_id, "problem": result.problem}
    if result.record is not None:
        item["result"] = {**result.record.answer, "key": result.record.key}
    return batch_row(operation, item, sweep.point(result.number) if sweep else ())


def _lines(rows: Iterable[list[Any]]) -> bytes:
    text = io.StringIO()
    csv.writer(text).writerows(map(csv_cells, rows))
    return text.getvalue().encode()


def has_parquet() -> bool:
    """Return whether pyarrow is installed."""
    return find_spec("pyarrow") is not None


async def as_parquet(
    blocks: AsyncIterator[list[CaseResult]], job: JobState, sweep: Sweep | None
) -> AsyncIterator[bytes]:
    """Yield the table of the summaries, a row group at a time."""
    table = await run_sync(ParquetTable, job, sweep)
    async for results in blocks:
        if piece := await run_sync(table.write, results):
            yield piece
    yield await run_sync(table.finish)


class ParquetTable:
    """A Parquet file of the cases of a job, made piece by piece.

    Parameters
    ----------
    job
        Its operation names the columns, its engine goes into the metadata.
    sweep
        Request of a sweep: its axes become columns, its base goes into the metadata.
    """

    def __init__(self, job: JobState, sweep: Sweep | None) -> None:
        import pyarrow as pa  # noqa: PLC0415 (an extra)
        from pyarrow import parquet  # noqa: PLC0415

        metadata = {"title": "ricochet results", "operation": job.operation, "engine_version": job.engine_version}
        if sweep is not None:
            metadata["base"] = orjson.dumps(sweep.request["base"]).decode()
            metadata["axes"] = orjson.dumps(sweep.fields).decode()
        columns = batch_columns(job.operation, sweep.fields if sweep else ())
        fields = [
            pa.field(
                column.name, _arrow_type(column), metadata={"unit": column.unit, "description": column.description}
            )
            for column in columns
        ]
        self._schema = pa.schema(fields, metadata=metadata)
        self._operation = job.operation
        self._sweep = sweep
        self._rows: list[list[Any]] = []
        self._sink = Pieces()
        self._writer = parquet.ParquetWriter(self._sink, self._schema)

    def write(self, results: Sequence[CaseResult]) -> bytes:
        """Add the rows of these cases; return what has become ready of the file."""
        self._rows += (_row(result, self._operation, self._sweep) for result in results)
        if len(self._rows) >= GROUP_ROWS:
            self._write_group()
        return self._sink.take()

    def finish(self) -> bytes:
        """Return the rest of the file."""
        if self._rows:
            self._write_group()
        self._writer.close()
        return self._sink.take()

    def _write_group(self) -> None:
        import pyarrow as pa  # noqa: PLC0415 (an extra)

        columns = zip(*self._rows, strict=True)
        arrays = [pa.array(column, field.type) for column, field in zip(columns, self._schema, strict=True)]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))
        self._rows = []


class Pieces(io.RawIOBase):
    """A file that hands over what is written to it."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
        self._size = 0

    def writable(self) -> bool:
        """Return that it is written to."""
        return True

    def tell(self) -> int:
        """Return how much has been written."""
        return self._size

    def write(self, data: Any) -> int:
        """Keep a piece until it is taken."""
        self._pieces.append(bytes(data))
        self._size += len(self._pieces[-1])
        return len(self._pieces[-1])

    def take(self) -> bytes:
        """Return what has been written since the last call."""
        pieces, self._pieces = self._pieces, []
        return b"".join(pieces)


def _arrow_type(column: Column) -> "DataType":
    """Return the type of a column in Arrow."""
    import pyarrow as pa  # noqa: PLC0415 (an extra)

    return {"f": pa.float64(), "i": pa.int64(), "S": pa.string(), "?": pa.bool_()}[column.dtype.lstrip("<")[0]]


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
        writer.writerow(csv_cells(row))
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
    key: Annotated[str, PathParameter(description="Key of an answer.", json_schema_extra=KEY)],
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
