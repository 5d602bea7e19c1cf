"""How clients choose answers: `Accept`, `Accept-Encoding`, `If-None-Match` (RFC 9110); and the media types."""

from functools import lru_cache

JSON, JSONL = "application/json", "application/jsonl"
CSV, HDF5, PARQUET = "text/csv", "application/x-hdf5", "application/vnd.apache.parquet"

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
def coding_of(accept_encoding: str, offered: tuple[str, ...] = ("gzip",)) -> str:
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
