"""What a client would rather have: the `Prefer` header (RFC 7240)."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

PREFERENCE = re.compile(
    r'\s*([!#$%&\'*+.^_`|~0-9a-z-]+)\s*(?:=\s*("(?:[^"\\]|\\.)*"|[^\s;,"]*))?[^,"]*(?:"[^"]*"[^,"]*)*'
)
"""A token, its value, and parameters, which none of ours has. Of what is said twice the first counts."""
MOST_DIGITS = 9


@dataclass(frozen=True, slots=True)
class Preference:
    """How long a client will wait, and whether it would rather not wait at all.

    Parameters
    ----------
    respond_async
        Whether it wants a job whatever the size of the work.
    wait
        Time to wait for the answer; None if it does not say. [s]
    """

    respond_async: bool = False
    wait: int | None = None

    def applied(self, waited: float | None) -> dict[str, str]:
        """Return the header that says which preferences were obeyed in making a job, if any was."""
        told = ["respond-async"] * self.respond_async
        if self.wait is not None and waited is not None:
            told.append(f"wait={min(self.wait, int(waited))}")
        return {"Preference-Applied": ", ".join(told)} if told else {}


def read_preference(headers: Iterable[str]) -> Preference:
    """Return what these headers say; what they say of other matters, or wrongly, is passed over."""
    found: dict[str, str] = {}
    for match in PREFERENCE.finditer(",".join(headers).lower()):
        found.setdefault(match[1], (match[2] or "").strip('"'))
    wait = found.get("wait", "")
    seconds = int(wait[:MOST_DIGITS]) if wait.isascii() and wait.isdigit() else None
    return Preference("respond-async" in found, seconds)
