"""A body that comes too slowly is not waited for."""

import asyncio
from http import HTTPStatus

from fastapi import HTTPException
from starlette.types import Message, Receive

CYCLE = "ricochet.cycle"
"""In the scope of a request: what the server knows of it, such as whether there is more of its body."""


class Arrival:
    """Receives a request as long as its body comes fast enough; only time spent waiting for it counts.

    Parameters
    ----------
    receive
        Of the server.
    seconds
        To wait in all, beside what the body takes at the slowest rate. [s]
    slowest
        Rate. [bytes/s]
    """

    __slots__ = ("_left", "_receive", "_slowest", "_whole")

    def __init__(self, receive: Receive, seconds: float, slowest: float) -> None:
        self._receive = receive
        self._left = seconds
        self._slowest = slowest
        self._whole = False

    async def __call__(self) -> Message:
        """Receive what comes next.

        Raises
        ------
        HTTPException
            408 if it comes too late.
        """
        if self._whole:
            return await self._receive()
        now = asyncio.get_running_loop().time
        begun = now()
        try:
            async with asyncio.timeout(self._left):
                message = await self._receive()
        except TimeoutError:
            raise HTTPException(
                HTTPStatus.REQUEST_TIMEOUT, "the body comes too slowly", headers={"Connection": "close"}
            ) from None
        self._left += len(message.get("body", b"")) / self._slowest - (now() - begun)
        self._whole = not message.get("more_body", False)
        return message
