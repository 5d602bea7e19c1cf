"""A job as it is told: its state, its cases, and what makes a request that is sent again the same."""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal, NamedTuple, TypeAlias

from service.jobs.slices import CaseState

Status: TypeAlias = Literal["accepted", "running", "successful", "failed", "dismissed"]
FINAL = frozenset({"successful", "failed", "dismissed"})


@dataclass(frozen=True, slots=True)
class Idempotency:
    """What makes a request that is sent again the same.

    Parameters
    ----------
    token
        The client's key.
    digest
        Of the operation and the whole body; a function if the body is still being read, called at its end.
    """

    token: str
    digest: str | Callable[[], str]

    @property
    def whole_digest(self) -> str:
        """The digest, once the body has been read."""
        return self.digest if isinstance(self.digest, str) else self.digest()


@dataclass(frozen=True, slots=True)
class JobState:
    """A job at one instant. `done` counts every case that has its result: new ones, `cached` ones, `failed` ones."""

    id: str
    operation: str
    status: Status
    total: int
    done: int
    cached: int
    failed: int
    created: datetime
    started: datetime | None
    finished: datetime | None
    expires: datetime | None
    problem: dict[str, Any] | None
    revision: int
    number: int = field(repr=False)
    """Of the job in the store."""
    owner: str = field(repr=False)
    versions: str = field(repr=False)

    @property
    def final(self) -> bool:
        """Whether nothing changes any more."""
        return self.status in FINAL


class CaseRow(NamedTuple):
    """A case as it is stored."""

    number: int
    state: CaseState
    key: str
    custom_id: str | None
    problem: dict[str, Any] | None
