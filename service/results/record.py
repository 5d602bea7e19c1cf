"""One result as the service keeps and answers it."""

from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

FloatColumns = dict[str, npt.NDArray[np.float64]]

DICT_WEIGHT = 8
"""Memory of parsed JSON over the length of its text, about."""


class Record:
    """A request, its answer and the versions that made it. Not to be changed.

    Parameters
    ----------
    key
        Hash of the request, the operation and the versions.
    operation
        ``"trajectory"``, ``"cra"`` or one of the calibrations.
    request
        Canonical request, every default filled in; or its JSON, which is then read only when somebody looks at it.
    answer
        The JSON answer but for the columns of the history; or its JSON, likewise.
    history
        Those columns, under their API names; None if there is no history.
    engine_version, schema_version
        Of the solver and of the contract.
    """

    __slots__ = ("_answer", "_request", "engine_version", "history", "json", "key", "operation", "schema_version")

    def __init__(
        self,
        key: str,
        operation: str,
        request: dict[str, Any] | bytes,
        answer: dict[str, Any] | bytes,
        history: FloatColumns | None,
        engine_version: str,
        schema_version: str,
    ) -> None:
        self.key = key
        self.operation = operation
        self.history = history
        self.engine_version = engine_version
        self.schema_version = schema_version
        self._request = request
        self._answer = answer
        self.json = self._encode()
        """The answer as it is sent: made once, so that a hot one costs a look-up."""

    @property
    def request(self) -> dict[str, Any]:
        """Canonical request."""
        if isinstance(self._request, bytes):
            self._request = _parsed(self._request)
        return self._request

    @property
    def answer(self) -> dict[str, Any]:
        """The JSON answer but for the columns of the history."""
        if isinstance(self._answer, bytes):
            self._answer = _parsed(self._answer)
        return self._answer

    @property
    def request_json(self) -> bytes:
        """The request as text."""
        return _text(self._request)

    @property
    def answer_json(self) -> bytes:
        """The answer as text, without the columns of the history."""
        return _text(self._answer)

    @property
    def nbytes(self) -> int:
        """Memory it takes, about."""
        columns = sum(column.nbytes for column in (self.history or {}).values())
        return len(self.json) + columns + DICT_WEIGHT * (len(self.request_json) + len(self.answer_json))

    @property
    def motion(self) -> dict[str, Any] | None:
        """The part of the answer that describes one run, which the history belongs to; None if there is none."""
        motion: dict[str, Any] | None = self.answer if self.operation == "trajectory" else self.answer.get("trajectory")
        return motion

    def with_warning(self, code: str, detail: str) -> "Record":
        """Return the same result with one more warning."""
        warnings = [*self.answer.get("warnings", []), {"code": code, "detail": detail}]
        answer = {**self.answer, "warnings": warnings}
        versions = self.engine_version, self.schema_version
        return Record(self.key, self.operation, self._request, answer, self.history, *versions)

    def _encode(self) -> bytes:
        """Answer with key, version and history; put together as text, which spares parsing one that was stored."""
        text = _text(self._answer)
        more: dict[str, Any] = {"key": self.key, "engine_version": self.engine_version}
        if self.history is not None:
            history = {name: np.ascontiguousarray(column) for name, column in self.history.items()}
            if self.operation == "trajectory":
                more["history"] = history
            elif self.motion is not None:
                text = _dumps({**self.answer, "trajectory": {**self.motion, "history": history}})
        return text[:-1] + b"," * (len(text) > len(b"{}")) + _dumps(more)[1:]


def _text(content: dict[str, Any] | bytes) -> bytes:
    return content if isinstance(content, bytes) else orjson.dumps(content)


def _parsed(text: bytes) -> dict[str, Any]:
    content: dict[str, Any] = orjson.loads(text)
    return content


def _dumps(content: dict[str, Any]) -> bytes:
    return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)
