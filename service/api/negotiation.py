"""How clients choose answers: `Accept`, `Accept-Encoding`, `If-None-Match` (RFC 9110), and `Prefer` (RFC 7240)."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

PREFERENCE = re.compile(
    r'\s*([!#$%&\'*+.^_`|~0-9a-z-]+)\s*(?:=\s*("(?:[^"\\]|\\.)*"|[^\s;,"]*))?[^,"]*(?:"[^"]*"[^,"]*)*'
)
"""A token, its value, and parameters, which none of ours has. Of what is said twice the first counts."""
MOST_DIGITS = 9
remembered = lru_cache(maxsize=64)
"""Remembers what a header says: a client sends the same one with every request."""


@remembered
def choose(accept: str, offered: tuple[str, ...]) -> str | None:
    """Return the media type the client likes best, the first of several; None if it takes none of those offered."""
    ranges = [_parse(part) for part in accept.split(",") if part.strip()]
    qualities = [_quality(media_type, ranges) for media_type in offered]
    best = max(qualities)
    return offered[qualities.index(best)] if best > 0.0 else None


@remembered
def coding_of(accept_encoding: str, offered: tuple[str, ...] = ("zstd", "gzip")) -> str:
    """Return the coding that the client likes best, the first of several; identity if it takes none of those offered.

    What is not listed is not taken, but identity, which is then liked least (RFC 9110, section 12.5.3).
    """
    qualities = dict(_parse(part) for part in accept_encoding.split(",") if part.strip())
    liked = {coding: qualities.get(coding, qualities.get("*", 0.0)) for coding in offered}
    liked["identity"] = qualities.get("identity", 0.0)
    best = max(liked, key=lambda coding: liked[coding])
    return best if liked[best] > 0.0 else "identity"


def matches(if_none_match: str, etag: str) -> bool:
    """Return whether the client has this representation already."""
    tags = [tag.strip().removeprefix("W/") for tag in if_none_match.split(",")]
    return "*" in tags or etag in tags


def _parse(part: str) -> tuple[str, float]:
    media_range, *parameters = (piece.strip().lower() for piece in part.split(";"))
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                return media_range, float(value)
            except ValueError:
                return media_range, 0.0
    return media_range, 1.0


def _quality(media_type: str, ranges: list[tuple[str, float]]) -> float:
    """Quality of the most specific range that holds the media type."""
    qualities = dict(ranges) if ranges else {"*/*": 1.0}
    for media_range in (media_type, f"{media_type.partition('/')[0]}/*", "*/*"):
        if media_range in qualities:
            return qualities[media_range]
    return 0.0


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
        applied = ["respond-async"] * self.respond_async
        if self.wait is not None and waited is not None:
            applied.append(f"wait={min(self.wait, int(waited))}")
        return {"Preference-Applied": ", ".join(applied)} if applied else {}


def read_preference(headers: Iterable[str]) -> Preference:
    """Return what these headers say; what they say of other matters, or wrongly, is passed over."""
    found: dict[str, str] = {}
    for match in PREFERENCE.finditer(",".join(headers).lower()):
        found.setdefault(match[1], (match[2] or "").strip('"'))
    wait = found.get("wait", "")
    seconds = int(wait[:MOST_DIGITS]) if wait.isascii() and wait.isdigit() else None
    return Preference("respond-async" in found, seconds)
