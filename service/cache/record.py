"""Records: results as they are stored and sent to clients."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from service.operations import SCHEMA_VERSION, outcome_of
from solver import ENGINE_VERSION

FloatColumns = dict[str, npt.NDArray[np.float64]]

ENTRY_BYTES = 600
"""Memory of a cached record in addition to its texts [bytes]: 460 as measured over 16,000 records, and the overhead of
malloc."""
TEXT_LENGTH = 2.3
"""Approximate length of the numbers of a history in JSON, relative to their size in memory: a number of 16 digits has
some 18 characters with its comma, and takes 8 bytes. [1]"""


class Record:
    """A request with its answer and the versions that computed it. Callers must not modify it.

    A record holds the answer as it is sent (`json`), or its parts (`answer` and `history`), or both. Each form is made
    from the other on first use.

    Parameters
    ----------
    key
        Hash of request, operation and versions.
    operation
        Name of the operation.
    request_json
        Canonical request as JSON, with all defaults filled in.
    answer
        Answer without key, version and columns of the history, as a dictionary or as JSON.
    history
        Columns of the history by their names in the contract; None if there is no history.
    json
        Answer as it is sent, instead of its parts.
    outcome
        Outcome of the run or search; taken from the answer if not given.
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
        """False if the record could not be written to the disk. It is then lost when this process ends."""

    @property
    def json(self) -> bytes:
        """Answer as it is sent, with key, version and history, as JSON."""
        if self._json is None:
            self._json = self._encode()
        return self._json

    @property
    def length(self) -> int:
        """Length of the answer as it is sent [bytes]; an estimate until the answer has been encoded."""
        if self._json is not None:
            return len(self._json)
        columns = sum(column.nbytes for column in (self._history or {}).values())
        return len(self.answer_json) + round(TEXT_LENGTH * columns)

    @property
    def request(self) -> dict[str, Any]:
        """Canonical request, parsed at each access."""
        request: dict[str, Any] = orjson.loads(self.request_json)
        return request

    @property
    def answer(self) -> dict[str, Any]:
        """Answer without key, version and columns of the history."""
        if self._answer is None:
            if self._answer_json is not None:
                self._answer = orjson.loads(self._answer_json)
            else:
                self._answer = self._split()
        answer: dict[str, Any] = self._answer
        return answer

    @property
    def answer_json(self) -> bytes:
        """Answer without key, version and columns of the history, as JSON."""
        if self._answer_json is None:
            self._answer_json = orjson.dumps(self.answer)
        return self._answer_json

    @property
    def history(self) -> FloatColumns | None:
        """Columns of the history; None if there is none."""
        # A record with `_answer` or `_answer_json` was made from its parts, or has been split already.
        if self._history is None and self._json is not None and self._answer_json is None and self._answer is None:
            self._answer = self._split()
        return self._history

    @property
    def outcome(self) -> str:
        """Outcome of the run or search."""
        if self._outcome is None:
            self._outcome = outcome_of(self.answer)
        return self._outcome

    def compact(self, *, exact: bool = False) -> "Record":
        """Return a copy of the record with its JSON texts only. Parsed content takes ten times as much memory.

        Parameters
        ----------
        exact
            Copy the texts into memory of their exact length. Bytes from orjson occupy its whole buffer, which takes
            4 kB for a text of 100 bytes.
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
        """Memory of the record after `compact`. [bytes]"""
        return len(self.json) + len(self.request_json) + ENTRY_BYTES

    @property
    def motion(self) -> dict[str, Any] | None:
        """Part of the answer that describes a run, to which the history belongs; None if there is none."""
        return motion_in(self.operation, self.answer)

    def with_warning(self, code: str, detail: str) -> "Record":
        """Return a copy of the record with an additional warning."""
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
        """Return the answer with key, version and history. JSON texts are joined to avoid parsing a stored answer."""
        text, history = self.answer_json, self._history
        more: dict[str, Any] = {"key": self.key, "engine_version": self.engine_version}
        if history is not None:
            # orjson encodes only contiguous arrays, and a column may be a view of another array.
            columns = {name: np.ascontiguousarray(column) for name, column in history.items()}
            if self.operation == "trajectory":
                more["history"] = columns
            elif self.motion is not None:
                # The history belongs inside the field `trajectory`, so the whole answer has to be encoded again.
                text = _dumps({**self.answer, "trajectory": {**self.motion, "history": columns}})
        return text[:-1] + b"," * (len(text) > len(b"{}")) + _dumps(more)[1:]

    def _split(self) -> dict[str, Any]:
        """Parse the answer as it is sent, and separate the history from it."""
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
        Number of the case in the request, from 0.
    record, problem
        Record of the result, or the problem if there is no result. The problem has no `instance`; its pointers refer to
        the request of the case.
    cached
        True if the result came from the cache.
    """

    number: int
    custom_id: str | None
    record: Record | None
    problem: dict[str, Any] | None
    cached: bool


def motion_in(operation: str, answer: dict[str, Any]) -> dict[str, Any] | None:
    """Return the part of an answer that describes a run; None if there is none."""
    motion: dict[str, Any] | None = answer if operation == "trajectory" else answer.get("trajectory")
    return motion


def _dumps(content: dict[str, Any]) -> bytes:
    return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)
