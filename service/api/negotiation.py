"""Content negotiation (RFC 9110): media types, `Accept`, `Accept-Encoding` and `If-None-Match`."""

from functools import lru_cache

JSON, JSONL = "application/json", "application/jsonl"
CSV, HDF5, PARQUET = "text/csv", "application/x-hdf5", "application/vnd.apache.parquet"

remembered = lru_cache(maxsize=64)
"""Decorator that caches the result for a header, because a client sends the same header with every request. 64 entries,
an arbitrary choice, exceed the number of different headers that the clients of a service send."""


@remembered
def choose(accept: str, offered: tuple[str, ...]) -> str | None:
    """Return the offered media type that the client prefers; the first wins a tie. None if the client accepts none."""
    ranges = [_parse(part) for part in accept.split(",") if part.strip()]
    qualities = [_quality(media_type, ranges) for media_type in offered]
    best = max(qualities)
    return offered[qualities.index(best)] if best > 0.0 else None


@remembered
def coding_of(accept_encoding: str, offered: tuple[str, ...] = ("gzip",)) -> str:
    """Return the offered coding that the client prefers; the first wins a tie. `identity` if the client accepts none.

    Codings that are not listed are not acceptable, except for `identity`, which then ranks last (RFC 9110, section
    12.5.3).
    """
    qualities = dict(_parse(part) for part in accept_encoding.split(",") if part.strip())
    liked = {coding: qualities.get(coding, qualities.get("*", 0.0)) for coding in offered}
    liked["identity"] = qualities.get("identity", 0.0)
    best = max(liked, key=lambda coding: liked[coding])
    return best if liked[best] > 0.0 else "identity"


def matches(if_none_match: str, etag: str) -> bool:
    """Return True if the client already has the representation with this entity tag."""
    # `If-None-Match` compares weakly (RFC 9110, section 13.1.2), and compression makes our tags weak.
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
    """Return the quality of the most specific range that includes the media type; 0 if none does."""
    qualities = dict(ranges) if ranges else {"*/*": 1.0}
    for media_range in (media_type, f"{media_type.partition('/')[0]}/*", "*/*"):
        if media_range in qualities:
            return qualities[media_range]
    return 0.0
