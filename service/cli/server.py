"""HTTP server: uvicorn with the lifespan of the application, and a private server in this process."""

import asyncio
import gc
import logging
import os
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI

from service.api.app import REFUSAL_SECONDS, STOP_SECONDS, create_app
from service.cli.arguments import FAILED, CommandError, read_settings
from service.cli.client import Client, connect
from service.cli.http_protocol import HttpProtocol
from service.cli.writers import progress
from service.errors import ExecutorError, UnusableFolderError
from service.settings import Settings
from solver.compilation import compilation_progress

SOCKET_FOLDER_BYTES = 70
"""Longest path of the folder of a socket [bytes]. The names below it take 25; macOS allows 103 in all, Linux 107."""
TICK_SECONDS = 0.1
"""Interval between checks for a signal during a slow start [s], short enough for SIGTERM to seem immediate."""
MAX_CONNECTIONS = 800
"""Largest number of open connections. Each takes 10 kB and a file descriptor; the usual limit of 1,024 descriptors
leaves the rest for files and workers. Further connections are answered with 503."""
IDLE_SECONDS = 10
"""Timeout of an idle connection between two requests [s]. The timeout in deploy/nginx.conf is shorter, so that nginx
never sends a request on a connection that is being closed here."""
TERMINATED = 143
"""Exit status after SIGTERM, as reported by shells: 128 plus the number of the signal."""
PROGRESS_SECONDS = 5.0
"""Interval between log entries while the solver is compiled [s]. An arbitrary choice: compilation takes about a
minute."""

log = logging.getLogger(__name__)


class Server(uvicorn.Server):
    """Uvicorn server that runs the lifespan of the application itself, so that a failed start raises its error.

    Uvicorn would only log the error of a lifespan.

    Parameters
    ----------
    app, settings
        Application, and settings with its address and limits.
    on_start
        Function called when the server listens, with the port, or None for a socket file.
    **options
        Additional options of uvicorn.
    """

    def __init__(
        self, app: FastAPI, settings: Settings, on_start: Callable[[int | None], None] | None = None, **options: Any
    ) -> None:
        self._app = app
        self._on_start = on_start
        self._lifespan = AsyncExitStack()
        super().__init__(
            uvicorn.Config(
                app,
                host=settings.host,
                port=settings.port,
                root_path=settings.root_path,
                http=HttpProtocol,
                ws="none",
                limit_concurrency=MAX_CONNECTIONS,
                timeout_keep_alive=IDLE_SECONDS,
                lifespan="off",
                log_config=None,
                access_log=False,
                server_header=False,
                proxy_headers=bool(settings.trusted_proxies),
                forwarded_allow_ips=list(settings.trusted_proxies),
                ssl_certfile=settings.tls_certificate,
                ssl_keyfile=settings.tls_key,
                timeout_graceful_shutdown=settings.grace_seconds - STOP_SECONDS,
                **options,
            )
        )

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application and listen, unless a signal to exit arrives first.

        All objects made so far are excluded from later garbage collections, which would otherwise take 80 ms longer
        each.
        """
        starting = asyncio.ensure_future(
            self._lifespan.enter_async_context(self._app.router.lifespan_context(self._app))
        )
        loop = asyncio.get_running_loop()
        reported = loop.time()
        while not self.should_exit and not starting.done():
            await asyncio.wait({starting}, timeout=TICK_SECONDS)
            if loop.time() > reported + PROGRESS_SECONDS:
                reported = loop.time()
                progress = compilation_progress()
                if progress.left:
                    log.info("%s", progress)
        if self.should_exit:  # Without the cancellation, workers that compile the solver would delay the exit.
            starting.cancel()
            await asyncio.gather(starting, return_exceptions=True)
            await self._lifespan.aclose()
            return
        await starting
        try:
            await super().startup(sockets)
        except BaseException:
            await self._lifespan.aclose()
            raise
        gc.collect()
        gc.freeze()
        if self._on_start:
            address = self.servers[0].sockets[0].getsockname()
            self._on_start(address[1] if isinstance(address, tuple) else None)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop the server once the application has ended its event streams and answered its requests.

        Event streams would otherwise stay open. Requests unfinished `REFUSAL_SECONDS` before the timeout are refused.
        """
        services, seconds = self._app.state.services, self.config.timeout_graceful_shutdown or 0
        services.stopping.set()
        asyncio.get_running_loop().call_later(seconds - REFUSAL_SECONDS, services.ending.set_result, None)
        await super().shutdown(sockets)
        if not self.force_exit:
            await self._lifespan.aclose()


def socket_folder() -> str:
    """Return the folder for temporary files, or /tmp if the path of a socket there would be too long."""
    folder = tempfile.gettempdir()
    return folder if len(os.fsencode(folder)) <= SOCKET_FOLDER_BYTES else "/tmp"  # noqa: S108 (folders in it are private)


@contextmanager
def local_server(data_dir: Path | None) -> Iterator[Client]:
    """Run a private service in this process, with its own workers, cache and jobs, and open a client for it.

    The same code thus computes batches and sweeps locally and in a service.

    Parameters
    ----------
    data_dir
        Folder for the results; None keeps nothing.

    Raises
    ------
    CommandError
        If the folder belongs to a running service, or the workers cannot be started.
    """
    previous = signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # This exits the contexts below.
    with (
        tempfile.TemporaryDirectory(prefix="ricochet-") as folder,
        tempfile.TemporaryDirectory(prefix="ricochet-", dir=socket_folder()) as sockets,
    ):
        socket_path = f"{sockets}/socket"
        settings = read_settings(data_dir=data_dir or Path(folder) / "data", log_level="error", access="open")
        started: Future[None] = Future()
        server = Server(create_app(settings), settings, lambda _: started.set_result(None), uds=socket_path)
        thread = threading.Thread(target=_serve, args=(server, started), name="ricochet-service")
        thread.start()
        try:
            with progress("starting"):
                started.result()
            with connect("http://ricochet", socket=socket_path) as client:
                yield client
        except UnusableFolderError as error:
            raise CommandError(f"{error}; use that service with --url", FAILED) from None
        except ExecutorError as error:
            raise CommandError(str(error), FAILED) from None
        finally:
            server.should_exit = True
            thread.join()
            signal.signal(signal.SIGTERM, previous)


def _serve(server: Server, started: Future[None]) -> None:
    """Run the server, and pass a startup error to the future."""
    try:
        server.run()
    except BaseException as error:  # noqa: BLE001 (raised in the thread that waits)
        if not started.done():
            started.set_exception(error)
