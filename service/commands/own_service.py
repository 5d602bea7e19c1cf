"""A private service in this process: its pool, its cache and its jobs, but nobody else can reach it.

So many cases are computed here by the same code that a service has, and asked for by the same client.
"""

import asyncio
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path

from httpx import HTTPTransport

from service.api.app import create_app, lifespan
from service.commands.client import Client, connect
from service.commands.environment import read_settings
from service.commands.errors import FAILED, CommandError
from service.commands.progress import progress
from service.commands.server import Server
from service.errors import ExecutorError, FolderInUseError
from service.settings import Settings

TERMINATED = 143
"""Exit status after SIGTERM, as shells tell it."""


@contextmanager
def own_service(data_dir: Path | None) -> Iterator[Client]:
    """Run a service as long as this lasts.

    Parameters
    ----------
    data_dir
        Folder of its results; a temporary one, gone at the end, if there is none.

    Raises
    ------
    CommandError
        If the folder belongs to a running service, or the service cannot be started.
    """
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # leaves by way of what is below
    with tempfile.TemporaryDirectory(prefix="ricochet-") as folder:
        address = f"{folder}/socket"
        settings = read_settings(data_dir=data_dir or Path(folder) / "data", log_level="error", access="open")
        server = PrivateServer(settings, address)
        thread = threading.Thread(target=server.live, name="ricochet-service")
        thread.start()
        try:
            with progress("starting"):
                server.up.result()
            with connect("http://ricochet", transport=HTTPTransport(uds=address), trust_env=False) as client:
                yield client
        except FolderInUseError as error:
            raise CommandError(f"{error}; ask that one by --url", FAILED) from None
        except ExecutorError as error:
            raise CommandError(str(error), FAILED) from None
        finally:
            server.should_exit = True
            thread.join()
            signal.signal(signal.SIGTERM, before)


class PrivateServer(Server):
    """The server on a socket that is a file, to be run in a thread.

    Parameters
    ----------
    address
        File where it listens, in a folder that only we may enter.
    """

    def __init__(self, settings: Settings, address: str) -> None:
        self._app = create_app(settings)
        self.up: Future[None] = Future()
        """Done once it listens; fails if it never will."""
        super().__init__(self._app, settings, uds=address, lifespan="off")

    def live(self) -> None:
        """Serve until it should exit."""
        try:
            with asyncio.Runner(loop_factory=self.config.get_loop_factory()) as runner:
                runner.run(self._live())
        except BaseException as error:  # noqa: BLE001 (of whoever waits for it to be up)
            if not self.up.done():
                self.up.set_exception(error)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and tell of it."""
        await super().startup(sockets)
        self.up.set_result(None)

    async def _live(self) -> None:
        async with lifespan(self._app):  # not by the server, which would only log why it cannot be
            await self.serve()
