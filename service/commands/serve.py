"""`ricochet serve`: run the service."""

import gc
import signal
import socket
import sys
from contextlib import suppress

import uvicorn
from fastapi import FastAPI

from service.app import STOP_SECONDS, create_app
from service.logs import configure
from service.settings import Settings


class Server(uvicorn.Server):
    """The server, which tells the application that it is about to stop: some answers have no end of their own."""

    def __init__(self, app: FastAPI, settings: Settings) -> None:
        self._state = app.state
        super().__init__(
            uvicorn.Config(
                app,
                host=settings.host,
                port=settings.port,
                log_config=None,
                access_log=False,
                timeout_graceful_shutdown=settings.grace_seconds - STOP_SECONDS,
            )
        )

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start; what is there then stays, and is not looked at again by the garbage collector, which takes 80 ms."""
        await super().startup(sockets)
        gc.collect()
        gc.freeze()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Answer what there is, and stop."""
        self._state.stopping.set()
        await super().shutdown(sockets)


def serve(settings: Settings) -> int:
    """Run the service until SIGTERM or SIGINT; return 0 if it could be started."""
    configure(settings.log_level)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # uvicorn raises it again once it has stopped
    server = Server(create_app(settings), settings)
    with suppress(KeyboardInterrupt):
        server.run()
    return 0 if server.started else 3
