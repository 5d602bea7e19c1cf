"""What went wrong in many rounds of the same."""

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from benchmarks.stress.lines import Line

MOST_TOLD = 20


@dataclass(slots=True)
class Found:
    """Rounds, what was seen in them, and what should not have been."""

    kinds: Counter[str] = field(default_factory=Counter)
    seen: dict[str, list[float]] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)

    @property
    def rounds(self) -> int:
        """How many there were."""
        return self.kinds.total()

    def claim(self, holds: object, otherwise: str) -> None:
        """Note a fault unless this holds."""
        if not holds:
            self.faults.append(f"round {self.rounds}: {otherwise}")

    def note(self, name: str, value: float) -> None:
        """Note a figure of this round."""
        self.seen.setdefault(name, []).append(value)

    def line(
        self, number: int, what: str, required: str, measured: str = "", more: dict[str, Any] | None = None
    ) -> Line:
        """What is told of all rounds, with more figures if there are any."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.kinds.items())
        told = f"{self.rounds} rounds: {kinds}" + (f"; {measured}" if measured else "")
        told += f"; {len(self.faults)} faults: {self.faults[0]}" if self.faults else "; no fault"
        details = {"rounds": dict(self.kinds), "seen": self.seen, "faults": self.faults[:MOST_TOLD]} | (more or {})
        return Line(
            number=number,
            what=what,
            required=required,
            measured=told,
            held=bool(self.rounds) and not self.faults,
            details=details,
        )


def rounds_until(most: int, deadline: float) -> Iterator[int]:
    """Number rounds, at least one, until there were as many or the time is over (on the monotonic clock)."""
    for number in range(most):
        if number and time.monotonic() > deadline:
            return
        yield number
