"""Queries that were asked just before, answered from memory without being looked at again."""

from collections import OrderedDict
from collections.abc import Callable
from time import perf_counter

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access.visit import VISIT, Visit
from service.engine import Engine
from service.errors import QuotaError
from service.logs import BEGUN
from service.results.record import Record

PATHS = frozenset({"/cra", "/trajectory"})
LONGEST = 8 * 1024
"""Of a body that is remembered; few are longer. [bytes]"""
SHARE = 1 / 8
"""Of the memory for results, which bodies may take beside it: some 20,000 of the usual if nothing else is set."""
OVERHEAD = 300
"""Memory of an entry beside its body, about. [bytes]"""
BODY = "ricochet.body"
"""In the scope of a request: its path and body, if they may be remembered."""

Known = tuple[str, bytes]


class HotAnswers:
    """Remembers which bodies ask for which results: the same bytes mean the same key.

    Parameters
    ----------
    engine
        Its cache has the results.
    memory_bytes
        Memory for results.
    """

    def __init__(self, engine: Engine, *, memory_bytes: int) -> None:
        self._cache = engine.cache
        self._limit = SHARE * memory_bytes
        self._keys: OrderedDict[Known, str] = OrderedDict()
        self._nbytes = 0

    def recall(self, asked: Known) -> Record | None:
        """Return the result that was asked for with these bytes, if it is in memory."""
        key = self._keys.get(asked)
        if key is None:
            return None
        self._keys.move_to_end(asked)
        return self._cache.recall(key)

    def remember(self, scope: Scope, key: str) -> None:
        """Note the key of the request with this scope."""
        asked: Known | None = scope.get(BODY)
        if asked is None or asked in self._keys:
            return
        self._keys[asked] = key
        self._nbytes += len(asked[1]) + OVERHEAD
        while self._nbytes > self._limit:
            (_, body), _ = self._keys.popitem(last=False)
            self._nbytes -= len(body) + OVERHEAD


class HotPath:
    """Middleware that answers such queries.

    Parameters
    ----------
    app
        What answers all others.
    hot
        The bodies remembered; none before the application has started.
    count
        Told of every result that is answered.
    """

    def __init__(self, app: ASGIApp, hot: Callable[[], HotAnswers | None], count: Callable[[Record], None]) -> None:
        self._app = app
        self._hot = hot
        self._count = count

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        hot = self._hot() if scope["type"] == "http" and may_be_known(scope) else None
        if hot is None:
            await self._app(scope, receive, send)
            return
        first = await receive()
        if first["type"] == "http.request" and not first.get("more_body"):
            asked = (scope["path"], first["body"])
            if (record := hot.recall(asked)) and counted(scope[VISIT]):
                self._count(record)
                await answer(scope, record, send)
                return
            scope[BODY] = asked
        waiting: list[Message] = [first]

        async def receive_again() -> Message:
            return waiting.pop() if waiting else await receive()

        await self._app(scope, receive_again, send)


def may_be_known(scope: Scope) -> bool:
    """Tell whether a request could be one that is remembered: whatever is unusual of it is looked at elsewhere."""
    if scope["path"] not in PATHS or scope["method"] != "POST":
        return False
    length, json = 0, False
    for name, value in scope["headers"]:
        if name == b"content-type":
            json = value == b"application/json"
        elif name == b"content-length":
            length = int(value)  # the server has checked it
        elif name in {b"content-encoding", b"transfer-encoding"}:
            return False
    return json and 0 < length <= LONGEST


def counted(visit: Visit) -> bool:
    """Count the case of a request; tell whether the key may ask for it. If not, the route says so."""
    try:
        visit.take(1)
    except QuotaError:
        return False
    return True


async def answer(scope: Scope, record: Record, send: Send) -> None:
    """Send a result."""
    scope["route"] = Route(scope["path"])
    headers = [
        (b"content-type", b"application/json"),
        (b"content-length", b"%d" % len(record.json)),
        (b"cache-status", b"ricochet; hit"),
        (b"server-timing", b"total;dur=%.2f" % (1e3 * (perf_counter() - scope[BEGUN]))),
    ]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": record.json})


class Route:
    """Stands for the route that would have answered.

    Parameters
    ----------
    path
        Of the route.
    """

    __slots__ = ("path",)

    def __init__(self, path: str) -> None:
        self.path = path
