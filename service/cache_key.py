"""Key of a result: a hash of everything it depends on; canonical requests with their keys."""

import hashlib
from dataclasses import dataclass
from typing import Any, Protocol

import orjson

from solver import ENGINE_VERSION

SCHEMA_VERSION = "1"
"""Raised whenever the meaning of a request or an answer changes: results kept under another version are not used."""


class Request(Protocol):
    """A validated request."""

    def canonical(self) -> dict[str, Any]:
        """Return every field as JSON data, defaults filled in."""
        ...


@dataclass(frozen=True, slots=True)
class KeyedRequest:
    """A canonical request as JSON, and the key of its result."""

    key: str
    json: bytes

    @classmethod
    def of(cls, operation: str, request: Request) -> "KeyedRequest":
        """Return the canonical form of a validated request with its key."""
        canonical = request.canonical()
        return cls(result_key(operation, canonical), orjson.dumps(canonical))


def result_key(operation: str, request: dict[str, Any]) -> str:
    """Key of the result of a request.

    Parameters
    ----------
    operation
        Name of the operation, such as ``"cra"``.
    request
        Canonical request: validated, every default filled in.

    Returns
    -------
    str
        SHA-256, hexadecimal. The order of the fields does not matter, nor 1 or 1.0, nor the sign of a zero; anything
        else does, to the last bit of a number.
    """
    content = {
        "operation": operation,
        "request": _plain(request),
        "engine_version": ENGINE_VERSION,
        "schema_version": SCHEMA_VERSION,
    }
    return hashlib.sha256(orjson.dumps(content, option=orjson.OPT_SORT_KEYS)).hexdigest()


def _plain(value: Any) -> Any:
    """Replace numbers by floats, each of which has one text, and -0.0 by 0.0."""
    kind = type(value)
    if kind is float or kind is int:
        return float(value) + 0.0
    if kind is dict:
        return {name: _plain(item) for name, item in value.items()}
    if kind is list:
        return [_plain(item) for item in value]
    return value
