"""One result as the service keeps and answers it."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

FloatColumns = dict[str, npt.NDArray[np.float64]]

DICT_WEIGHT = 8
"""Memory of parsed JSON over the length of its text, about."""


@dataclass(frozen=True, slots=True)
class Record:
    """A request, its answer and the versions that made it.

    Parameters
    ----------
    key
        Hash of the request, the operation and the versions.
    operation
        ``"trajectory"`` or ``"cra"``.
    request
        Canonical request, every default filled in.
    answer
        The JSON answer but for the columns of the history.
    history
        Those columns, under their API names; None if there is no history.
    engine_version, schema_version
        Of the solver and of the contract.
    """

    key: str
    operation: str
    request: dict[str, Any]
    answer: dict[str, Any]
    history: FloatColumns | None
    engine_version: str
    schema_version: str
    json: bytes = field(init=False, repr=False, compare=False)
    """The answer as it is sent: made once, so that a hot one costs a look-up."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "json", self._encode())

    @property
    def nbytes(self) -> int:
        """Memory it takes, about."""
        columns = sum(column.nbytes for column in (self.history or {}).values())
        return len(self.json) + columns + DICT_WEIGHT * len(orjson.dumps((self.request, self.answer)))

    @property
    def motion(self) -> dict[str, Any] | None:
        """The part of the answer that describes one run, which the history belongs to; None if there is none."""
        motion: dict[str, Any] | None = self.answer if self.operation == "trajectory" else self.answer.get("trajectory")
        return motion

    def with_warning(self, code: str, detail: str) -> "Record":
        """Return the same result with one more warning."""
        warnings = [*self.answer.get("warnings", []), {"code": code, "detail": detail}]
        return replace(self, answer={**self.answer, "warnings": warnings})

    def _encode(self) -> bytes:
        answer = {**self.answer, "key": self.key, "engine_version": self.engine_version}
        if self.history is not None and self.motion is not None:
            columns = {name: np.ascontiguousarray(column) for name, column in self.history.items()}
            if self.operation == "trajectory":
                answer["history"] = columns
            else:
                answer["trajectory"] = {**self.motion, "history": columns}
        return orjson.dumps(answer, option=orjson.OPT_SERIALIZE_NUMPY)
