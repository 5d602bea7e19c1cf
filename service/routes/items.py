"""Results of many cases as they are sent: JSON items, lines, rows of a table."""

import csv
import io
import itertools
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from typing import Any

import orjson

from service.batches.small import CaseResult
from service.summary import SCALARS, codes_of, scalars_of

PIECE = 128 * 1024
"""Sent at once. [bytes]"""


def to_item(result: CaseResult, instance: str) -> bytes:
    """Return the JSON of a result; a problem is told as one of this path."""
    head: dict[str, Any] = {"index": result.number}
    if result.custom_id is not None:
        head["custom_id"] = result.custom_id
    if result.record is None:
        return orjson.dumps({**head, "problem": {**(result.problem or {}), "instance": instance}})
    return b'%b,"result":%b}' % (orjson.dumps(head)[:-1], result.record.json)


def to_lines(results: Iterable[CaseResult], instance: str) -> bytes:
    """Return the results as JSON lines."""
    return b"".join(to_item(result, instance) + b"\n" for result in results)


async def as_lines(slices: AsyncIterator[list[CaseResult]], instance: str) -> AsyncIterator[bytes]:
    """Yield results as JSON lines, some at a time."""
    async for results in slices:
        for part in in_pieces(to_item(result, instance) + b"\n" for result in results):
            yield part


async def as_array(
    slices: AsyncIterator[list[CaseResult]], instance: str, end: Callable[[], bytes] = lambda: b""
) -> AsyncIterator[bytes]:
    """Yield results as one JSON object, some at a time; what stands in it after them is asked for at their end."""
    separators = itertools.chain([b'{"results":['], itertools.repeat(b","))
    async for results in slices:
        for part in in_pieces(next(separators) + to_item(result, instance) for result in results):
            yield part
    yield next(separators).replace(b",", b"") + b"]" + end() + b"}"


def in_pieces(items: Iterable[bytes]) -> Iterator[bytes]:
    """Yield items together: a piece costs as much as some items to send, and a large one holds up others."""
    piece: list[bytes] = []
    size = 0
    for item in items:
        piece.append(item)
        size += len(item)
        if size > PIECE:
            yield b"".join(piece)
            piece, size = [], 0
    if piece:
        yield b"".join(piece)


def header(operation: str) -> bytes:
    """Return the first row of the table of an operation."""
    return _rows([["index", "custom_id", "key", *SCALARS[operation], "warnings", "problem"]])


def to_rows(results: Iterable[CaseResult], operation: str) -> bytes:
    """Return the rows of these results; codes of several warnings are told with blanks between them."""
    return _rows(_row(result, operation) for result in results)


def _row(result: CaseResult, operation: str) -> list[Any]:
    if result.record is None:
        problem = (result.problem or {}).get("type", "")
        return [result.number, result.custom_id or "", "", *[""] * len(SCALARS[operation]), "", problem]
    answer = result.record.answer
    scalars = scalars_of(operation, answer)
    return [result.number, result.custom_id or "", result.record.key, *scalars, codes_of(answer), ""]


def _rows(rows: Iterable[list[Any]]) -> bytes:
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue().encode()
