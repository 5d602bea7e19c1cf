"""One result as the service keeps and answers it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from service.operations import SCHEMA_VERSION, outcome_of
from solver import ENGINE_VERSION

FloatColumns = dict[str, npt.NDArray[np.float64]]

ENTRY_BYTES = 600
"""Memory of a record in the cache beside its texts: 460 as measured with 16,000, and what malloc adds. [bytes]"""
TEXT_LENGTH = 2.3
"""Length of numbers as JSON over that of their bytes, about."""


class Record:
    """A request, its answer and the versions that made it. Not to be changed.

    A record holds the answer as it is sent, or its parts, or both: each is made from the other when it is first used.

    Parameters
    ----------
    key
        Hash of the request, the operation and the versions.
    operation
        Name of the operation.
    request_json
        Canonical request, every default filled in.
    answer
        The JSON answer without key, version and columns of the history; as a dictionary or as text.
    history
        Those columns, by their names in the contract; None if there is no history.
    json
        The answer as it is sent, in place of its parts.
    outcome
        How the run or the search ended; read from the answer when not given.
    """

    __slots__ = (
        "_answer",
        "_answer_json",
        "_history",
        "_json",
        "_outcome",
        "engine_version",
        "key",
        "operation",
        "request_json",
        "schema_version",
        "stored",
    )

    def __init__(
        self,
        key: str,
        operation: str,
        request_json: bytes,
        answer: dict[str, Any] | bytes | None = None,
        history: FloatColumns | None = None,
        *,
        json: bytes | None = None,
        outcome: str | None = None,
        engine_version: str | None = None,
        schema_version: str = SCHEMA_VERSION,
    ) -> None:
        self.key = key
        self.operation = operation
        self.request_json = request_json
        self.engine_version = ENGINE_VERSION if engine_version is None else engine_version
        self.schema_version = schema_version
        self._answer = answer if isinstance(answer, dict) else None
        self._answer_json = answer if isinstance(answer, bytes) else None
        self._history = history
        self._json = json
        self._outcome = outcome
        self.stored = True
        """False if the disk has refused it: it is answered, and gone with this process."""

    @property
    def json(self) -> bytes:
        """The answer as it is sent."""
        if self._json is None:
            self._json = self._encode()
        return self._json

    @property
    def length(self) -> int:
        """Length of the answer as it is sent; about, as long as it has not been encoded."""
        if self._json is not None:
            return len(self._json)
        columns = sum(column.nbytes for column in (self._history or {}).values())
        return len(self.answer_json) + round(TEXT_LENGTH * columns)

    @property
    def request(self) -> dict[str, Any]:
        """Canonical request."""
        request: dict[str, Any] = orjson.loads(self.request_json)
        return request

    @property
    def answer(self) -> dict[str, Any]:
        """The JSON answer without key, version and columns of the history."""
        if self._answer is None:
            if self._answer_json is not None:
                self._answer = orjson.loads(self._answer_json)
            else:
                self._answer = self._split()
        answer: dict[str, Any] = self._answer
        return answer

    @property
    def answer_json(self) -> bytes:
        """The same as text."""
        if self._answer_json is None:
            self._answer_json = orjson.dumps(self.answer)
        return self._answer_json

    @property
    def history(self) -> FloatColumns | None:
        """Columns of the history; None if there is none."""
        if self._history is None and self._json is not None and self._answer_json is None and self._answer is None:
            self._answer = self._split()
        return self._history

    @property
    def outcome(self) -> str:
        """How the run or the search ended."""
        if self._outcome is None:
            self._outcome = outcome_of(self.answer)
        return self._outcome

    def compact(self, *, exact: bool = False) -> "Record":
        """Return the same result as texts alone, without what has been parsed of it and takes ten times their memory.

        Parameters
        ----------
        exact
            Copy the texts into memory of their length: what orjson returns keeps its buffer, 4 kB for 100 bytes.
        """
        record = Record(
            self.key,
            self.operation,
            bytes(memoryview(self.request_json)) if exact else self.request_json,
            json=bytes(memoryview(self.json)) if exact else self.json,
            outcome=self.outcome,
            engine_version=self.engine_version,
            schema_version=self.schema_version,
        )
        record.stored = self.stored
        return record

    @property
    def nbytes(self) -> int:
        """Memory that it takes when it is compact."""
        return len(self.json) + len(self.request_json) + ENTRY_BYTES

    @property
    def motion(self) -> dict[str, Any] | None:
        """The part of the answer that describes one run, which the history belongs to; None if there is none."""
        return motion_in(self.operation, self.answer)

    def with_warning(self, code: str, detail: str) -> "Record":
        """Return the same result with one more warning."""
        history = self.history
        warnings = [*self.answer.get("warnings", []), {"code": code, "detail": detail}]
        return Record(
            self.key,
            self.operation,
            self.request_json,
            {**self.answer, "warnings": warnings},
            history,
            engine_version=self.engine_version,
            schema_version=self.schema_version,
        )

    def _encode(self) -> bytes:
        """Return the answer with key, version and history; joined as text, which spares parsing one that was stored."""
        text, history = self.answer_json, self._history
        more: dict[str, Any] = {"key": self.key, "engine_version": self.engine_version}
        if history is not None:
            columns = {name: np.ascontiguousarray(column) for name, column in history.items()}
            if self.operation == "trajectory":
                more["history"] = columns
            elif self.motion is not None:
                text = _dumps({**self.answer, "trajectory": {**self.motion, "history": columns}})
        return text[:-1] + b"," * (len(text) > len(b"{}")) + _dumps(more)[1:]

    def _split(self) -> dict[str, Any]:
        """Return the answer of the JSON that is sent, and keep its history apart."""
        answer: dict[str, Any] = orjson.loads(self.json)
        del answer["key"], answer["engine_version"]
        motion = motion_in(self.operation, answer)
        history = None if motion is None else motion.pop("history", None)
        if history is not None:
            self._history = {name: np.array(column) for name, column in history.items()}
        return answer


@dataclass(frozen=True, slots=True)
class CaseResult:
    """Result of a case of a batch.

    Parameters
    ----------
    number
        In the order of the request, from 0.
    record, problem
        One of them. A problem lacks its `instance`; its pointers are into the request of the case.
    cached
        Whether nothing was computed for it.
    """

    number: int
    custom_id: str | None
    record: Record | None
    problem: dict[str, Any] | None
    cached: bool


def motion_in(operation: str, answer: dict[str, Any]) -> dict[str, Any] | None:
    """Return the part of an answer that describes one run; None if there is none."""
    motion: dict[str, Any] | None = answer if operation == "trajectory" else answer.get("trajectory")
    return motion


def _dumps(content: dict[str, Any]) -> bytes:
    return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)
