"""From the body of a batch or a sweep to its cases, two hundred at a time, each validated in a thread.

A whole body at once would hold the interpreter lock for too long; so would telling all that is wrong with it.
"""

import hashlib
import itertools
from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import HTTPException, Request
from pydantic import MISSING, BaseModel, ValidationError
from pydantic_core import to_json

from service.admission import check_work
from service.errors import MAX_ERRORS, InvalidBodyError, field_errors, validation_errors
from service.jobs.slices import Case
from service.routes.body import JSON, JSONL, parse_json, require_type, stream_up_to
from service.schemas.batches import MOST_LINES, Cases
from service.schemas.sweeps import AxisError, Grid, Outline
from service.settings import Settings
from solver import ParameterError

LINES = 200
"""Cases validated in one go, some 5 ms."""
SLICE_BYTES = 256 * 1024
"""Of lines validated in one go: few long ones take as much time as many short ones."""
MOST_FIELDS = 20
"""Of a batch or a sweep, which has two at most: what is wrong with each of a million would take a second to tell."""


@dataclass(frozen=True, slots=True)
class Incoming:
    """A body that is being read: its cases in slices, and when they have been read, what makes the body the same."""

    slices: AsyncIterator[list[Case]]
    _digest: "hashlib._Hash"

    def digest(self) -> str:
        """Hash of operation, media type and body."""
        return self._digest.hexdigest()


async def read_batch(request: Request, model: type[BaseModel]) -> Incoming:
    """Return the cases of a batch; those of a JSON body have all been looked at, those of JSONL only as they are read.

    Raises
    ------
    HTTPException, InvalidBodyError
        If it is none.
    """
    media_type = require_type(request, JSON, JSONL)
    digest = hashlib.sha256(f"{request.scope['path']} {media_type}\n".encode())
    settings, threads = request.app.state.settings, request.app.state.reading
    if media_type == JSONL:
        lines = split_lines(stream_up_to(request, settings.max_jsonl_bytes), settings.max_body_bytes, digest)
        return Incoming(read_lines(lines, model, settings, threads), digest)
    body = await read_whole(request, digest)
    found = await run_sync(unwrap, body, Cases, settings.max_body_depth, limiter=threads)
    cases: list[Case] = []
    for first in range(0, len(found.cases), LINES):
        part = found.cases[first : first + LINES]
        cases += await run_sync(check_cases, part, model, first, settings, limiter=threads)
    return Incoming(sliced(cases), digest)


async def read_sweep(request: Request, model: type[BaseModel]) -> Incoming:
    """Return the points of a sweep, each looked at as it is read.

    Raises
    ------
    HTTPException, InvalidBodyError
        If it is none.
    """
    media_type = require_type(request, JSON)
    digest = hashlib.sha256(f"{request.scope['path']} {media_type}\n".encode())
    body = await read_whole(request, digest)
    settings = request.app.state.settings
    grid = await run_sync(lay_grid, body, model, settings)
    return Incoming(read_points(grid, model, settings, request.app.state.reading), digest)


async def read_whole(request: Request, digest: "hashlib._Hash") -> bytes:
    """Return a JSON body of many cases."""
    body = b"".join([chunk async for chunk in stream_up_to(request, request.app.state.settings.max_batch_bytes)])
    digest.update(body)
    return body


async def sliced(cases: Sequence[Case]) -> AsyncIterator[list[Case]]:
    """Yield cases in slices."""
    for first in range(0, len(cases), LINES):
        yield list(cases[first : first + LINES])


def unwrap(body: bytes, model: type[Cases], most_deep: int) -> Cases:
    """Return a batch, its cases not yet looked at."""
    try:
        return model.model_validate(few_fields(parse_json(body, most_deep)))
    except ValidationError as error:
        raise InvalidBodyError(validation_errors(error.errors())) from error


def few_fields(content: Any) -> Any:
    """Return it unless it is an object with too many fields."""
    if isinstance(content, dict) and len(content) > MOST_FIELDS:
        raise InvalidBodyError([{"pointer": "", "detail": f"has {len(content)} fields, most of them unknown"}])
    return content


def check_cases(found: Sequence[Any], model: type[BaseModel], first: int, limits: Settings) -> list[Case]:
    """Validate a part of a JSON batch, also whether the values of each case go together."""
    cases, errors = list[Case](), list[dict[str, str]]()
    for index, content in enumerate(found, first):
        place = f"/cases/{index}"
        try:
            if len(to_json(content)) > limits.max_body_bytes:
                errors.append({"pointer": place, "detail": f"a case may be {limits.max_body_bytes} bytes long at most"})
                continue
            cases.append(case := to_case(content, model, limits))
            case.request.arguments()  # type: ignore[attr-defined] # every request of the contract has it
        except ValidationError as error:
            errors += validation_errors(error.errors(), place)
        except ParameterError as error:
            errors += behind(place, error)
        if len(errors) > MAX_ERRORS:
            break
    if errors:
        raise InvalidBodyError(errors)
    return cases


def to_case(content: Any, model: type[BaseModel], limits: Settings) -> Case:
    """Validate one case."""
    request: Any = model.model_validate(content)
    check_work(request, limits.max_panel_steps)
    custom_id = getattr(request, "custom_id", MISSING)
    return Case(request, None if custom_id is MISSING else custom_id)


async def split_lines(
    chunks: AsyncIterator[bytes], most_bytes: int, digest: "hashlib._Hash"
) -> AsyncIterator[list[bytes]]:
    """Yield lines, some at a time; one that is too long is cut behind its limit and ends the body."""
    lines, size, rest = list[bytes](), 0, b""
    async for chunk in chunks:
        digest.update(chunk)
        *whole, rest = (rest + chunk).split(b"\n")
        for line in whole:
            lines.append(line)
            size += len(line)
            if len(lines) == LINES or size > SLICE_BYTES:
                yield lines
                lines, size = [], 0
        if len(rest) > most_bytes:
            break
    yield [*lines, rest] if rest else lines


async def read_lines(
    parts: AsyncIterator[list[bytes]], model: type[BaseModel], limits: Settings, threads: CapacityLimiter
) -> AsyncIterator[list[Case]]:
    """Yield the cases of a JSONL body."""
    count = 0
    async for lines in parts:
        if count + len(lines) > MOST_LINES:
            raise InvalidBodyError([{"pointer": "", "detail": f"may have {MOST_LINES:,} lines at most"}])
        if lines:
            yield await run_sync(check_lines, lines, model, count, limits, limiter=threads)
        count += len(lines)
    if not count:
        raise InvalidBodyError([{"pointer": "", "detail": "has no line"}])


def check_lines(lines: Sequence[bytes], model: type[BaseModel], first: int, limits: Settings) -> list[Case]:
    """Validate some lines; the first that is wrong ends it."""
    return [check_line(line, model, index, limits) for index, line in enumerate(lines, first)]


def check_line(line: bytes, model: type[BaseModel], index: int, limits: Settings) -> Case:
    """Validate one line."""
    pointer, place = f"/{index}", f"line {index + 1}"
    if len(line) > limits.max_body_bytes:
        detail = f"may be {limits.max_body_bytes} bytes long at most"
        raise InvalidBodyError([{"pointer": pointer, "detail": detail}], place)
    if not line.strip():
        raise InvalidBodyError([{"pointer": pointer, "detail": "is empty"}], place)
    try:
        return to_case(parse_json(line, limits.max_body_depth), model, limits)
    except HTTPException as error:
        raise InvalidBodyError([{"pointer": pointer, "detail": error.detail}], place) from error
    except ValidationError as error:
        raise InvalidBodyError(validation_errors(error.errors(), pointer), place) from error
    except ParameterError as error:
        raise InvalidBodyError(behind(pointer, error), place) from error


def behind(pointer: str, error: ParameterError) -> list[dict[str, str]]:
    """Return what is wrong with a case, told of the one at this pointer."""
    return [{**each, "pointer": pointer + each["pointer"]} for each in field_errors(error)]


def lay_grid(body: bytes, model: type[BaseModel], limits: Settings) -> Grid:
    """Return the grid of a sweep."""
    try:
        outline = Outline.model_validate(few_fields(parse_json(body, limits.max_body_depth)))
    except ValidationError as error:
        raise InvalidBodyError(validation_errors(error.errors())) from error
    if len(to_json(outline.base)) > limits.max_body_bytes:
        detail = f"may be {limits.max_body_bytes} bytes long at most"
        raise InvalidBodyError([{"pointer": "/base", "detail": detail}])
    try:
        model.model_validate(outline.base)
        return Grid(model, outline)
    except ValidationError as error:
        raise InvalidBodyError(validation_errors(error.errors(), "/base")) from error
    except AxisError as error:
        raise InvalidBodyError([{"pointer": error.pointer, "detail": error.detail}]) from error


async def read_points(
    grid: Grid, model: type[BaseModel], limits: Settings, threads: CapacityLimiter
) -> AsyncIterator[list[Case]]:
    """Yield the cases of a sweep."""
    points = enumerate(grid.points())
    while cases := await run_sync(check_points, grid, model, points, limits, limiter=threads):
        yield cases


def check_points(
    grid: Grid, model: type[BaseModel], points: Iterator[tuple[int, tuple[float, ...]]], limits: Settings
) -> list[Case]:
    """Validate the next points; the first that is wrong ends it."""
    return [check_point(grid, model, number, point, limits) for number, point in itertools.islice(points, LINES)]


def check_point(grid: Grid, model: type[BaseModel], number: int, point: tuple[float, ...], limits: Settings) -> Case:
    """Validate one point."""
    try:
        return to_case(grid.request(point), model, limits)
    except (ValidationError, ParameterError) as error:
        found = field_errors(error) if isinstance(error, ParameterError) else validation_errors(error.errors())
        place = "at " + ", ".join(f"{field} = {value:g}" for field, value in zip(grid.fields, point, strict=True))
        told = [{**each, "pointer": grid.pointer(number, each["pointer"])} for each in found]
        raise InvalidBodyError(told, place) from error
