"""Headers of every answer that tell browsers what not to do with it."""

Pairs = list[tuple[bytes, bytes]]

POLICY = b"default-src 'none'; frame-ancestors 'none'"
"""Of answers that are no pages, if a browser shows one all the same. Pages have policies of their own."""
ALWAYS: Pairs = [
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"content-security-policy", POLICY),
]
TRANSPORT: Pairs = [(b"strict-transport-security", b"max-age=31536000")]
"""For a year; said over TLS alone."""
FORGET: Pairs = [(b"cache-control", b"no-store")]
"""Answers are somebody's: no proxy keeps them."""
ASK_AGAIN: Pairs = [(b"cache-control", b"private, no-cache")]
"""What has an entity tag may be kept, and is asked for with it."""
USUAL, USUAL_TLS = [*ALWAYS, *FORGET], [*ALWAYS, *FORGET, *TRANSPORT]
TOLD = frozenset({b"etag", *(name for name, _ in USUAL_TLS)})
"""Headers that change what is added."""


def secured(headers: Pairs, *, tls: bool) -> Pairs:
    """Return headers of an answer with those that they lack; what is there stays as it is."""
    for name, _ in headers:
        if name in TOLD:
            break
    else:
        return [*headers, *(USUAL_TLS if tls else USUAL)]
    there = {name for name, _ in headers}
    wanted = [*ALWAYS, *(ASK_AGAIN if b"etag" in there else FORGET), *(TRANSPORT if tls else [])]
    return [*headers, *(pair for pair in wanted if pair[0] not in there)]
