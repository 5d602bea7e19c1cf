"""What a worker does with a case: parse its request, solve it, encode the answer and the file that keeps it."""

from collections.abc import Callable, Sequence
from typing import Any

from service.cache.hdf5 import Segment, encode_segments
from service.cache.record import FloatColumns, Record
from service.errors import field_errors
from service.schemas.quantities import Part
from solver import ParameterError

Compute = Callable[[bytes], tuple[dict[str, Any], FloatColumns | None]]

_chunks: dict[str, list[Record]] = {}
"""Records of the chunk being computed, by its id. A worker runs one chunk at a time."""


def compute_single(compute: Compute, operation: str, key: str, request: bytes) -> tuple[bytes, str, Sequence[Segment]]:
    """Return the answer to one request as it is sent, its outcome, and the file of the result."""
    record = Record(key, operation, request, *compute(request))
    return record.json, record.outcome, encode_segments([record])


def compute_case(compute: Compute, operation: str, key: str, request: bytes, chunk: str) -> tuple[bytes, str]:
    """Return the answer to one case of a chunk and its outcome; keep it for the file of the chunk."""
    record = Record(key, operation, request, *compute(request))
    if chunk not in _chunks:
        _chunks.clear()  # one that never ended
    _chunks.setdefault(chunk, []).append(record)
    return record.json, record.outcome


def close_chunk(chunk: str) -> Sequence[Segment]:
    """Return the files of the cases of this chunk that this process has computed."""
    return encode_segments(_chunks.pop(chunk, []))


def check_requests(model: type[Part], requests: Sequence[bytes]) -> dict[int, list[dict[str, str]]]:
    """Return what the solver finds wrong with these requests, each valid by itself, by their place."""
    wrong = {}
    for number, request in enumerate(requests):
        try:
            model.model_validate_json(request).arguments()  # type: ignore[attr-defined] # all requests have it
        except ParameterError as error:
            wrong[number] = field_errors(error)
    return wrong
