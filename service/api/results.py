"""Encoding of the results of jobs and batches as JSON, JSON lines, CSV, HDF5 and Parquet (extra `parquet`)."""

import csv
import io
import itertools
import os
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import aclosing
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import orjson
from anyio import CancelScope
from anyio.to_thread import run_sync
from fastapi import Request
from fastapi.responses import StreamingResponse

from service.api.downloads import file_pieces
from service.api.negotiation import HDF5, PARQUET
from service.api.services import services_of
from service.cache.hdf5 import BatchFile
from service.cache.record import CaseResult
from service.columns import Column, base_of, batch_columns, batch_row, csv_cells
from service.jobs.manager import JobManager
from service.jobs.models import JobState, StoredSweep
from service.operations import OPERATIONS

if TYPE_CHECKING:
    from pyarrow import DataType

JSON_PIECE = 128 * 1024
"""Size of the pieces of JSON that are sent [bytes]. Sending a smaller piece takes as long as encoding it; a larger one
delays other requests. The value is arbitrary."""

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class ReadyResults:
    """The available results of a job.

    Parameters
    ----------
    jobs
        Job manager that reads the results.
    job
        State of the job when it was requested.
    sweep
        Request for a sweep; None for a batch.
    start
        Number of the first case.
    limit
        Largest number of results; None for all.
    take
        Function that charges the quota of the client for results that were evicted and are computed again.
    """

    jobs: JobManager
    job: JobState
    sweep: StoredSweep | None
    start: int = 0
    limit: int | None = None
    take: Callable[[int], None] = lambda _: None

    def read(self, use: Callable[[list[CaseResult]], Value], *, whole: bool = False) -> AsyncGenerator[Value, None]:
        """Yield the value of `use` for each block of results; see `JobManager.results`."""
        return self.jobs.results(self.job.id, use, start=self.start, limit=self.limit, take=self.take, whole=whole)

    def points(self, results: Iterable[CaseResult]) -> list[tuple[float, ...]]:
        """Return the values of the axes at these results of a sweep; an empty list for a batch."""
        return [self.sweep.point(result.number) for result in results] if self.sweep else []


def to_item(result: CaseResult, instance: str, sweep: StoredSweep | None) -> bytes:
    """Return the JSON of a case. `instance` is added to its problem, if it has one."""
    head: dict[str, Any] = {"index": result.number}
    if result.custom_id is not None:
        head["custom_id"] = result.custom_id
    if sweep is not None:
        head["point"] = dict(zip(sweep.fields, sweep.point(result.number), strict=True))
    if result.record is None:
        return orjson.dumps({**head, "problem": {**(result.problem or {}), "instance": instance}})
    # Answers are stored in the form in which they are sent, so the bytes are inserted rather than parsed and encoded
    # again.
    return b'%b,"result":%b}' % (orjson.dumps(head)[:-1], result.record.json)


def to_lines(results: Iterable[CaseResult], instance: str, sweep: StoredSweep | None) -> bytes:
    """Return the results as JSON lines."""
    return b"".join(to_item(result, instance, sweep) + b"\n" for result in results)


async def as_lines(ready: ReadyResults, instance: str) -> AsyncIterator[bytes]:
    """Yield results as JSON lines in pieces."""

    def encode(results: list[CaseResult]) -> list[bytes]:
        return list(in_pieces(to_item(result, instance, ready.sweep) + b"\n" for result in results))

    async with aclosing(ready.read(encode)) as blocks:
        async for pieces in blocks:
            while pieces:  # Popping frees each piece as soon as it has been sent.
                yield pieces.pop(0)


async def as_array(
    ready: ReadyResults,
    instance: str,
    note: Callable[[list[CaseResult]], object] = lambda _: None,
    end: Callable[[], bytes] = lambda: b"",
) -> AsyncIterator[bytes]:
    """Yield results as one JSON object in pieces.

    Parameters
    ----------
    note
        Function called with each block of results before it is sent.
    end
        Function that returns JSON to be inserted after the list of results, at the end of the object.
    """
    separators = itertools.chain([b'{"results":['], itertools.repeat(b","))

    def encode(results: list[CaseResult]) -> list[bytes]:
        note(results)
        return list(in_pieces(next(separators) + to_item(result, instance, ready.sweep) for result in results))

    async with aclosing(ready.read(encode)) as blocks:
        async for pieces in blocks:
            while pieces:
                yield pieces.pop(0)
    yield next(separators).replace(b",", b"") + b"]" + end() + b"}"


def in_pieces(items: Iterable[bytes]) -> Iterator[bytes]:
    """Join items into pieces of about `JSON_PIECE` bytes."""
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


async def file_response(request: Request, ready: ReadyResults, form: str) -> StreamingResponse:
    """Return a response with the results as a file, HDF5 or Parquet. The file of a finished job is kept."""
    job, ending, write = ready.job, *FILES[form]
    name = f"{job.id}-{job.revision}-{ready.start}-{ready.limit}.{ending}"
    file = await services_of(request).downloads.open(name, lambda path: write(path, ready), keep=job.final)
    headers = {
        "Content-Length": str(os.fstat(file.fileno()).st_size),
        "Content-Disposition": f'attachment; filename="{job.id}.{ending}"',
        "Vary": "Accept",
    }
    return StreamingResponse(file_pieces(file), media_type=form, headers=headers)


async def write_hdf5(path: Path, ready: ReadyResults) -> None:
    """Write the results to an HDF5 file, block by block."""
    axes = ready.sweep.fields if ready.sweep else ()
    base = orjson.dumps(ready.sweep.request["base"]).decode() if ready.sweep else ""
    with await run_sync(lambda: BatchFile(path, ready.job.operation, axes=axes, base=base)) as batch:
        async with aclosing(
            ready.read(lambda results: batch.write(results, ready.points(results)), whole=True)
        ) as blocks:
            async for _ in blocks:
                pass
        await run_sync(batch.finish)  # Runs in a thread, because it compresses and writes the rest of the file.


GROUP_ROWS = 4096
"""Number of rows of a Parquet row group, some megabytes. It bounds the part of a table that is held in memory."""


def columns_of(operation: str) -> tuple[Column, ...]:
    """Return the columns of the answers of an operation, none for the unknown operation of a damaged job."""
    return OPERATIONS[operation].columns if operation in OPERATIONS else ()


def csv_head(operation: str, sweep: StoredSweep | None) -> bytes:
    """Return the CSV header. The last columns are the base of a sweep, which is the same in each row."""
    names = [column.name for column in batch_columns(columns_of(operation), sweep.fields if sweep else ())]
    return _lines([[*names, *_base(sweep)]])


def csv_rows(results: Iterable[CaseResult], operation: str, sweep: StoredSweep | None) -> bytes:
    """Return the results as CSV rows, without the header."""
    base = _base(sweep).values()
    return _lines([*_row(result, operation, sweep), *base] for result in results)


def _base(sweep: StoredSweep | None) -> dict[str, Any]:
    return base_of(sweep.request["base"], sweep.fields) if sweep else {}


async def as_csv(ready: ReadyResults) -> AsyncIterator[bytes]:
    """Yield the CSV table of the summaries in blocks."""
    operation, sweep = ready.job.operation, ready.sweep
    yield csv_head(operation, sweep)
    async with aclosing(ready.read(lambda results: csv_rows(results, operation, sweep))) as blocks:
        async for rows in blocks:
            yield rows


def _row(result: CaseResult, operation: str, sweep: StoredSweep | None) -> list[Any]:
    item: dict[str, Any] = {"index": result.number, "custom_id": result.custom_id, "problem": result.problem}
    if result.record is not None:
        item["result"] = {**result.record.answer, "key": result.record.key}
    return batch_row(columns_of(operation), item, sweep.point(result.number) if sweep else ())


def _lines(rows: Iterable[list[Any]]) -> bytes:
    text = io.StringIO()
    csv.writer(text).writerows(map(csv_cells, rows))
    return text.getvalue().encode()


def has_parquet() -> bool:
    """Return True if pyarrow is installed."""
    return find_spec("pyarrow") is not None


async def write_parquet(path: Path, ready: ReadyResults) -> None:
    """Write the table of the summaries to a Parquet file."""
    table = await run_sync(ParquetTable, path, ready.job, ready.sweep)
    try:
        async with aclosing(ready.read(table.write, whole=True)) as blocks:
            async for _ in blocks:
                pass
    finally:
        with CancelScope(shield=True):
            await run_sync(table.close)


class ParquetTable:
    """Writer of a Parquet file with one row per case, which holds one row group in memory.

    Parameters
    ----------
    path
        Location of the file to write.
    job
        Job whose operation determines the columns and whose engine version goes into the metadata.
    sweep
        Request for a sweep; its axes become columns and its base goes into the metadata.
    """

    def __init__(self, path: Path, job: JobState, sweep: StoredSweep | None) -> None:
        import pyarrow as pa  # noqa: PLC0415 (an extra)
        from pyarrow import parquet  # noqa: PLC0415

        metadata = {"title": "ricochet results", "operation": job.operation, "engine_version": job.engine_version}
        if sweep is not None:
            metadata["base"] = orjson.dumps(sweep.request["base"]).decode()
            metadata["axes"] = orjson.dumps(sweep.fields).decode()
        columns = batch_columns(columns_of(job.operation), sweep.fields if sweep else ())
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
        self._writer = parquet.ParquetWriter(path, self._schema)

    def write(self, results: Sequence[CaseResult]) -> None:
        """Add a row for each case, and write a row group when `GROUP_ROWS` have been added."""
        self._rows += (_row(result, self._operation, self._sweep) for result in results)
        if len(self._rows) >= GROUP_ROWS:
            self._write_group()

    def close(self) -> None:
        """Write the remaining rows and the footer of the file."""
        if self._rows:
            self._write_group()
        self._writer.close()

    def _write_group(self) -> None:
        import pyarrow as pa  # noqa: PLC0415 (an extra)

        columns = zip(*self._rows, strict=True)
        arrays = [pa.array(column, field.type) for column, field in zip(columns, self._schema, strict=True)]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))
        self._rows = []


def _arrow_type(column: Column) -> "DataType":
    import pyarrow as pa  # noqa: PLC0415 (an extra)

    return {"f": pa.float64(), "i": pa.int64(), "S": pa.string(), "?": pa.bool_()}[column.dtype.lstrip("<")[0]]


FILES: dict[str, tuple[str, Callable[[Path, ReadyResults], Awaitable[None]]]] = {
    HDF5: ("h5", write_hdf5),
    PARQUET: ("parquet", write_parquet),
}
"""Media types that are written to a file first, with the file extension and the function that writes the file."""
