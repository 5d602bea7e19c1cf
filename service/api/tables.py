"""The table of many cases, a row each, as CSV and as Parquet, which needs the extra `parquet`."""

import csv
import io
from collections.abc import AsyncIterator, Iterable, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import orjson
from anyio.to_thread import run_sync

from service.columns import Column, batch_columns, batch_row
from service.jobs.models import CaseResult, JobState, Sweep

if TYPE_CHECKING:
    from pyarrow import DataType

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
    csv.writer(text).writerows(rows)
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
