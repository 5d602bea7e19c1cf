"""What is required of the service, line by line, and what was measured."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One thing that is required.

    Parameters
    ----------
    number
        Of the requirement; several lines may belong to one.
    what, required, measured
        In words and figures.
    held
        Whether it was met; None if it could not be measured here, and `measured` says why.
    details
        More figures, for `stress.json`.
    """

    number: int
    what: str
    required: str
    measured: str
    held: bool | None
    details: dict[str, Any] = field(default_factory=dict)
