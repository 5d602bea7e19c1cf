"""Reading of batch and sweep bodies in blocks of cases, which are validated in a thread.

Validating a whole body in one call, or listing all its errors, would hold the interpreter lock for too long.
"""

import hashlib
import itertools
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from anyio.to_thread import run_sync
from fastapi import HTTPException, Request
from pydantic import MISSING, ValidationError
from pydantic_core import to_json

from service.api.body import BodyLimits, parse_json, read_body, require_type, stream_up_to
from service.api.negotiation import JSON, JSONL
from service.api.services import Services, services_of, unless_left
from service.auth.dependencies import context_in
from service.errors import (
    MAX_ERRORS,
    InvalidBodyError,
    errors_found,
    errors_of_point,
    field_errors,
    grid_of,
    validated_as,
    validation_errors,
)
from service.jobs.models import JobCase, StoredSweep
from service.operations import KeyedRequest
from service.queries import check_work
from service.schemas.batches import MOST_LINES, Cases
from service.schemas.quantities import named_units
from service.schemas.requests import Case
from service.schemas.sweeps import Grid, Outline
from service.telemetry import path_of
from service.workers.worker import check_requests
from solver import ParameterError
from solver.units import whole_number, written_in

CASES_AT_ONCE = 200
"""Number of cases validated in one call, which takes 5 to 10 ms."""
CHECKED_AT_ONCE = 50
"""Number of cases that a worker checks in one call. A call takes a few milliseconds, and single queries wait for it."""
CHECK_COST = 0.01
"""Cost of checking a case [ordinary cases]: the check takes some 0.1 ms, computing an ordinary case 10 to 20 ms."""
BYTES_AT_ONCE = 256 * 1024
"""Size above which a block of lines is validated even if it has fewer than `CASES_AT_ONCE`, because validating a few
long lines takes as much time as validating many short ones. [bytes]"""


@dataclass(frozen=True, slots=True)
class BatchBody:
    """The body of a batch or a sweep while it is being read.

    Parameters
    ----------
    blocks
        Iterator over the validated cases, in blocks.
    count
        Number of cases; 0 for JSONL, where it is unknown until the body has been read.
    sweep
        Request for a sweep; None for a batch.
    """

    blocks: AsyncIterator[list[JobCase]]
    _digest: "hashlib._Hash"
    count: int = 0
    sweep: StoredSweep | None = None
    estimate: Callable[[], int] = lambda: 0
    """Function that extrapolates the number of cases of a JSONL body from the lines read; returns 0 if the body has
    no declared length."""

    def digest(self) -> str:
        """Return the hash of the path, the media type and the body. It is complete only when the body has been read."""
        return self._digest.hexdigest()


class BatchReader:
    """Reads and validates the body of a batch or a sweep.

    Parameters
    ----------
    request
        HTTP request with the body.
    operation
        Operation of every case.
    model
        Model with which every case is validated.
    """

    def __init__(self, request: Request, operation: str, model: type[Case]) -> None:
        self._request = request
        self._operation = operation
        self._model = model
        self._services: Services = services_of(request)
        self._limits = self._services.settings
        self._read_count, self._read_bytes = 0, 0
        """Number of lines of a JSONL body read so far, and their total length. [1, bytes]"""

    async def read_batch(self) -> BatchBody:
        """Return the cases of a batch. A JSON body is validated here, the lines of JSONL as they are read.

        Raises
        ------
        HTTPException, InvalidBodyError
            If the body is not valid.
        """
        media_type = require_type(self._request, JSON, JSONL)
        digest = hashlib.sha256(f"{path_of(self._request.scope)} {media_type}\n".encode())
        if media_type == JSONL:
            # JSON lines are read as a stream: such a body may be far larger than a JSON body, which has to be parsed as
            # a whole.
            chunks = stream_up_to(self._request, self._limits.max_jsonl_bytes)
            lines = split_lines(chunks, self._limits.max_body_bytes, digest)
            return BatchBody(self._read_lines(lines), digest, estimate=self._estimate)
        limits = BodyLimits.of_batch(self._limits)
        body = await read_body(self._request, limits)
        digest.update(body)
        reading = self._services.reading
        found = await run_sync(unwrap, body, limits, limiter=reading)
        cases: list[JobCase] = []
        for first in range(0, len(found.cases), CASES_AT_ONCE):
            part = found.cases[first : first + CASES_AT_ONCE]
            valid, errors = await run_sync(self._validate_part, part, first, limiter=reading)
            errors |= await self._check(valid, part, first)
            if errors:
                raise InvalidBodyError([error for number in sorted(errors) for error in errors[number]])
            cases += valid.values()
        return BatchBody(in_blocks(cases), digest, len(cases))

    async def read_sweep(self) -> BatchBody:
        """Return the points of a sweep. The base and the axes are validated here, each point as it is read.

        Raises
        ------
        HTTPException, InvalidBodyError
            If the body is not valid.
        """
        media_type = require_type(self._request, JSON)
        digest = hashlib.sha256(f"{path_of(self._request.scope)} {media_type}\n".encode())
        limits = BodyLimits.of_series(self._limits)
        body = await read_body(self._request, limits)
        digest.update(body)
        outline, grid = await run_sync(self._make_grid, body, limits, limiter=self._services.reading)
        # The sweep is stored as the client sent it, so that the job can be shown and repeated with the same request.
        sent = {"base": outline.base, "axes": [axis.model_dump(mode="json") for axis in outline.axes]}
        sweep = StoredSweep(sent, tuple(grid.fields), tuple(grid.values))
        return BatchBody(self._read_points(grid), digest, grid.count, sweep)

    def _case(self, content: Any) -> JobCase:
        request: Any = self._model.model_validate(content)
        check_work(request, self._limits.max_panel_steps)
        custom_id = getattr(request, "custom_id", MISSING)
        return JobCase(KeyedRequest.of(self._operation, request), None if custom_id is MISSING else custom_id)

    def _validate_part(
        self, part: Sequence[Any], first: int
    ) -> tuple[dict[int, JobCase], dict[int, list[dict[str, str]]]]:
        """Validate a part of a JSON batch; return the valid cases, and the errors of the others, by case number."""
        cases: dict[int, JobCase] = {}
        errors: dict[int, list[dict[str, str]]] = {}
        for number, content in enumerate(part, first):
            place, longest = f"/cases/{number}", self._limits.max_body_bytes
            try:
                # Each case must keep within the limit on the body of a single query, which a batch must not circumvent.
                if len(to_json(content)) > longest:
                    detail = f"a case may be {whole_number(longest)} bytes long at most"
                    errors[number] = [{"pointer": place, "detail": detail}]
                else:
                    cases[number] = self._case(content)
            except (ValidationError, ParameterError) as error:
                errors[number] = behind(place, errors_of_case(error, content))
            # A response lists at most `MAX_ERRORS` errors, so the rest of the part need not be validated.
            if sum(map(len, errors.values())) > MAX_ERRORS:
                break
        return cases, errors

    async def _check(
        self, cases: dict[int, JobCase], part: Sequence[Any], first: int
    ) -> dict[int, list[dict[str, str]]]:
        """Have workers check that the values of each case of a part are consistent; return the errors by case number.

        Lines of JSONL and points of a sweep are not checked: for them, such an error is the result of the case.
        """
        canonical = self._services.queries.operations[self._operation].request
        numbers, errors = list(cases), dict[int, list[dict[str, str]]]()
        for begin in range(0, len(numbers), CHECKED_AT_ONCE):
            some = numbers[begin : begin + CHECKED_AT_ONCE]
            requests = [cases[number].request.json for number in some]
            # A worker does the check, which takes a few milliseconds and would block the event loop meanwhile.
            checking = self._services.executor.submit(
                check_requests,
                canonical,
                requests,
                owner=context_in(self._request.scope).queue_owner,
                cost=CHECK_COST * len(requests),
            )
            wrong = await unless_left(self._request, checking)
            for place, error in wrong.items():
                number = some[place]
                errors[number] = behind(f"/cases/{number}", errors_of_case(error, part[number - first]))
        return errors

    async def _read_lines(self, parts: AsyncIterator[list[bytes]]) -> AsyncIterator[list[JobCase]]:
        async for lines in parts:
            first, count = self._read_count, self._read_count + len(lines)
            self._read_count, self._read_bytes = count, self._read_bytes + sum(len(line) + 1 for line in lines)
            if count > MOST_LINES:
                detail = f"may have {whole_number(MOST_LINES)} lines at most"
                raise InvalidBodyError([{"pointer": "", "detail": detail}])
            if lines:
                yield await run_sync(self._validate_lines, lines, first, limiter=self._services.reading)
        if not self._read_count:
            raise InvalidBodyError([{"pointer": "", "detail": "the body has no line"}])

    def _estimate(self) -> int:
        # A body with chunked transfer coding has no length, and then there is no estimate.
        length = int(self._request.headers.get("content-length", 0))
        return length * self._read_count // max(1, self._read_bytes)

    def _validate_lines(self, lines: Sequence[bytes], first: int) -> list[JobCase]:
        """Validate consecutive lines; raise an error for the first invalid one."""
        return [self._validate_line(line, number) for number, line in enumerate(lines, first)]

    def _validate_line(self, line: bytes, number: int) -> JobCase:
        pointer, place = f"/{number}", f"line {number + 1}"
        if len(line) > self._limits.max_body_bytes:
            detail = f"may be {whole_number(self._limits.max_body_bytes)} bytes long at most"
            raise InvalidBodyError([{"pointer": pointer, "detail": detail}], place)
        if not line.strip():
            raise InvalidBodyError([{"pointer": pointer, "detail": "is empty"}], place)
        content = None
        try:
            content = parse_json(line, BodyLimits.of_one(self._limits))
            return self._case(content)
        except InvalidBodyError as error:
            raise InvalidBodyError(behind(pointer, error.errors), place) from error
        except HTTPException as error:
            # The parser has seen only this line, so its line number is always 1. `place` has the real number.
            detail = error.detail.replace(" at line 1 column ", " at column ")
            raise InvalidBodyError([{"pointer": pointer, "detail": detail}], place) from error
        except (ValidationError, ParameterError) as error:
            raise InvalidBodyError(behind(pointer, errors_of_case(error, content)), place) from error

    def _make_grid(self, body: bytes, limits: BodyLimits) -> tuple[Outline, Grid]:
        """Parse the body of a sweep, and return its base and axes (the outline) and the grid of its points."""
        outline = validated_as(Outline, parse_json(body, limits))
        if len(to_json(outline.base)) > self._limits.max_body_bytes:
            detail = f"may be {whole_number(self._limits.max_body_bytes)} bytes long at most"
            raise InvalidBodyError([{"pointer": "/base", "detail": detail}])
        with written_in(named_units(outline.base)):
            return outline, grid_of(self._model, outline)

    async def _read_points(self, grid: Grid) -> AsyncIterator[list[JobCase]]:
        points = enumerate(grid.points())
        while cases := await run_sync(self._validate_points, grid, points, limiter=self._services.reading):
            yield cases

    def _validate_points(self, grid: Grid, points: Iterator[tuple[int, tuple[float, ...]]]) -> list[JobCase]:
        """Validate the next points of a sweep; raise an error for the first invalid one."""
        return [self._validate_point(grid, *numbered) for numbered in itertools.islice(points, CASES_AT_ONCE)]

    def _validate_point(self, grid: Grid, number: int, point: tuple[float, ...]) -> JobCase:
        with written_in(named_units(grid.base)), errors_of_point(grid, number, point):
            return self._case(grid.request(point))


async def in_blocks(cases: Sequence[JobCase]) -> AsyncIterator[list[JobCase]]:
    """Yield cases in blocks of `CASES_AT_ONCE`."""
    for first in range(0, len(cases), CASES_AT_ONCE):
        yield list(cases[first : first + CASES_AT_ONCE])


def unwrap(body: bytes, limits: BodyLimits) -> Cases:
    """Parse the body of a batch without validating its cases."""
    return validated_as(Cases, parse_json(body, limits))


async def split_lines(
    chunks: AsyncIterator[bytes], max_bytes: int, digest: "hashlib._Hash"
) -> AsyncIterator[list[bytes]]:
    """Split a body into lines, and yield them in blocks.

    Reading stops in a line that exceeds `max_bytes`. The part of the line read so far, which is itself longer than
    `max_bytes`, is yielded, so that the caller can refuse the line.
    """
    lines, size, rest = list[bytes](), 0, b""
    async for chunk in chunks:
        digest.update(chunk)
        # The text after the last line break may continue in the next chunk.
        *whole, rest = (rest + chunk).split(b"\n")
        for line in whole:
            lines.append(line)
            size += len(line)
            if len(lines) == CASES_AT_ONCE or size > BYTES_AT_ONCE:
                yield lines
                lines, size = [], 0
        if len(rest) > max_bytes:
            break
    yield [*lines, rest] if rest else lines


def errors_of_case(error: ValidationError | ParameterError, content: Any) -> list[dict[str, str]]:
    """Return the errors of a case with pointers into it, in the units that it names."""
    with written_in(named_units(content)):
        return field_errors(error) if isinstance(error, ParameterError) else validation_errors(errors_found(error))


def behind(pointer: str, errors: Sequence[dict[str, str]]) -> list[dict[str, str]]:
    """Return the errors of a case with `pointer` prepended to their pointers."""
    return [{**each, "pointer": pointer + each["pointer"]} for each in errors]
