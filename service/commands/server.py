"""The server: uvicorn, which tells the application when it is about to stop."""

import asyncio
import gc
import socket
from typing import Any

import uvicorn
from fastapi import FastAPI

from service.access.connection import Connection
from service.api.app import STOP_SECONDS
from service.settings import Settings

TICKS = 10
"""Of the server, in a second."""


class Server(uvicorn.Server):
    """The server, which tells the application that it is about to stop: some answers have no end of their own.

    Parameters
    ----------
    app, settings
        What is served, and where.
    **options
        More of uvicorn's.
    """

    def __init__(self, app: FastAPI, settings: Settings, **options: Any) -> None:
        self._state = app.state
        super().__init__(
            uvicorn.Config(
                app,
                host=settings.host,
                port=settings.port,
                http=Connection,
                ws="none",
                log_config=None,
                access_log=False,
                server_header=False,
                ssl_certfile=settings.tls_certificate,
                ssl_keyfile=settings.tls_key,
                timeout_graceful_shutdown=settings.grace_seconds - STOP_SECONDS,
                **options,
            )
        )

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start; what is there then stays, and is not looked at again by the garbage collector, which takes 80 ms."""
        await super().startup(sockets)
        gc.collect()
        gc.freeze()

    async def on_tick(self, counter: int) -> bool:
        """Look once a second at connections whose clients are slow; return whether to stop."""
        if counter % TICKS == 0:
            now = asyncio.get_running_loop().time()
            for connection in list(self.server_state.connections):
                if isinstance(connection, Connection):
                    connection.look(now)
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Answer what there is, and stop."""
        self._state.services.stopping.set()
        await super().shutdown(sockets)
