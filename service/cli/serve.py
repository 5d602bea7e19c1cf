"""`ricochet serve`, `ricochet mcp` and `ricochet openapi`: run the service or its MCP tools, and write the contract."""

import argparse
import asyncio
import errno
import json
import logging
import os
import signal
import sys
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from http import HTTPStatus
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from service.cli.arguments import (
    FAILED,
    CommandError,
    RefusedError,
    add_data_dir,
    add_url,
    examples,
    read_settings,
    reason_of,
)
from service.cli.outputs import OutputFile
from service.version import VERSION

if TYPE_CHECKING:
    from service.auth.api_keys import ApiKeyStore
    from service.cli.client import Client
    from service.settings import Settings

NOT_STARTED = 3
"""Exit status of a service that could not start, by which a service manager can tell it from a later failure."""
READ_BYTES = 64 * 1024
"""Size of the pieces in which standard input is read [bytes]: the capacity of a pipe on Linux."""
CONTRACT = Path("openapi/openapi.json")

log = logging.getLogger(__name__)


def add_serve(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet serve`."""
    parser.description = (
        "Run the service until SIGTERM or Ctrl-C. It is configured by RICOCHET_HOST, RICOCHET_PORT, RICOCHET_DATA_DIR, "
        "RICOCHET_WORKERS and the other variables of docs/operating.md."
    )
    parser.epilog = examples("ricochet serve --port 9000")
    parser.add_argument("--host", help="address to listen on, in place of RICOCHET_HOST (default: 127.0.0.1)")
    parser.add_argument("--port", help="port to listen on, in place of RICOCHET_PORT (default: 8000)")
    parser.set_defaults(run=run_serve)


def run_serve(args: argparse.Namespace) -> int:
    """Run the service until SIGTERM or SIGINT.

    Raises
    ------
    CommandError
        If the service cannot start.
    """
    flags = {"host": args.host, "port": args.port}
    settings = read_settings(**{name: value for name, value in flags.items() if value is not None})
    asyncio.run(check_address(settings.host, settings.port))
    if settings.executor != "in-process":
        from service.workers.template import template

        template.start()  # The template loads the solver while this process imports the application.
    from service.api.app import create_app
    from service.auth.api_keys import KeysUnreadableError
    from service.cli.server import Server
    from service.errors import ExecutorError, MissingExtraError, UnusableFolderError
    from service.private_files import warn_of_readers
    from service.settings import unknown_variables
    from service.telemetry import configure_log
    from service.workers.template import LIMIT_HINT

    configure_log(settings.log_level)
    if unknown := unknown_variables():
        log.warning("the environment has variables that are not settings: %s", ", ".join(unknown))
    try:
        app = create_app(settings)
    except MissingExtraError as error:
        raise CommandError(str(error), FAILED) from None
    except KeysUnreadableError as error:
        raise CommandError(str(error), NOT_STARTED) from None
    check_access(settings, app.state.services.keys)
    check_proxy(settings)
    warn_of_readers(*filter(None, (settings.data_dir / "auth.sqlite", settings.tls_key)))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # Uvicorn raises the signal again after its shutdown.
    server = Server(app, settings, lambda port: print_address(settings, port))
    try:
        with suppress(KeyboardInterrupt):
            server.run()
    except (UnusableFolderError, ExecutorError, OSError) as error:
        raise CommandError(reason_of(error), NOT_STARTED) from None
    except RuntimeError as error:
        if "start new thread" not in str(error):  # There is no specific exception for a thread that cannot be started.
            raise
        raise CommandError(f"{error}; {LIMIT_HINT}", NOT_STARTED) from None
    except Exception:
        log.exception("the service failed")
        return FAILED
    return 0


async def check_address(host: str, port: int) -> None:
    """Check that the server can listen at an address, before workers start and the data folder is opened.

    Raises
    ------
    CommandError
        If the address cannot be used.
    """
    try:
        server = await asyncio.get_running_loop().create_server(asyncio.Protocol, host, port, start_serving=False)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            text = f"port {port} of {host} is in use; choose another with --port or RICOCHET_PORT"
        else:
            text = f"cannot listen on port {port} of {host}: {error.strerror or error}"
        raise CommandError(text, NOT_STARTED) from None
    server.close()


def check_access(settings: "Settings", keys: "ApiKeyStore") -> None:
    """Check that the service has API keys or is configured to be open.

    Raises
    ------
    CommandError
        If keys are required and there is no valid one, or their file has been lost.
    """
    if settings.access == "open":
        if not settings.on_loopback:
            names = ", ".join(settings.allowed_hosts) or "localhost alone (RICOCHET_ALLOWED_HOSTS)"
            log.warning("the service on %s is open to everyone, under the names: %s", settings.host, names)
        return
    if keys.lost:
        raise CommandError(
            f"auth.sqlite is missing from {settings.data_dir}, but auth.lock shows that there were keys: restore it "
            "from a backup, add new keys with `ricochet keys add --owner NAME`, or set RICOCHET_ACCESS=open to admit "
            "everyone",
            NOT_STARTED,
        )
    if (settings.access == "keys" or not settings.on_loopback) and not keys.usable:
        raise CommandError(
            f"{settings.host} requires an API key and there is none: add one with `ricochet keys add --owner NAME`, or "
            "set RICOCHET_ACCESS=open to admit everyone",
            NOT_STARTED,
        )
    if not settings.on_loopback and settings.tls_certificate is None:
        log.warning(
            "API keys are sent unencrypted: set RICOCHET_TLS_CERTIFICATE and RICOCHET_TLS_KEY, or use a proxy with TLS"
        )


def check_proxy(settings: "Settings") -> None:
    """Log a warning if other machines reach the service without a proxy, since only a proxy limits slow clients."""
    if not settings.on_loopback and not settings.trusted_proxies:
        log.warning(
            "the service on %s does not limit slow clients: put a proxy in front of it as in docs/how-to/deploy.md and "
            "name its address in RICOCHET_TRUSTED_PROXIES",
            settings.host,
        )


def print_address(settings: "Settings", port: int | None) -> None:
    """Print the address of the service on standard error if that is a terminal; otherwise the log has it."""
    if sys.stderr.isatty():
        scheme = "https" if settings.tls_certificate else "http"
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        print(f"ricochet {VERSION} on {scheme}://{host}:{port}", file=sys.stderr)


def add_mcp(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet mcp`."""
    parser.description = (
        "Offer critical angles, trajectories, uncertainty and wall thicknesses as tools of the Model Context Protocol, "
        "over standard input and output, until the input ends. Results are computed here or by a service. Needs the "
        "extra mcp."
    )
    parser.epilog = examples("ricochet mcp", "ricochet mcp --url http://127.0.0.1:8000")
    add_data_dir(parser)
    add_url(parser)
    parser.set_defaults(run=run_mcp)


def run_mcp(args: argparse.Namespace) -> int:
    """Serve the tools until standard input ends, or until SIGTERM or SIGINT.

    Raises
    ------
    CommandError
        If the MCP SDK is not installed.
    """
    if find_spec("mcp") is None:
        from service.settings import missing_package

        raise CommandError(missing_package("this command", "the package mcp", "mcp"), FAILED)
    import anyio

    from service.cli.jobs import service_for
    from service.cli.server import TERMINATED

    with service_for(args) as client:
        return TERMINATED if anyio.run(serve_until_terminated, client) else 0


async def serve_until_terminated(client: "Client") -> bool:
    """Serve the tools until standard input ends or SIGTERM arrives; return True for SIGTERM.

    The event loop receives the signal. A handler that raises SystemExit could interrupt any callback of the loop, which
    would then end with a traceback.
    """
    import anyio

    terminated = False
    with anyio.open_signal_receiver(signal.SIGTERM) as signals:

        async def stop_on_signal() -> None:
            nonlocal terminated
            async for _ in signals:
                terminated = True
                group.cancel_scope.cancel()

        async with anyio.create_task_group() as group:
            group.start_soon(stop_on_signal)
            await serve_tools(client)
            group.cancel_scope.cancel()
    return terminated


async def serve_tools(client: "Client") -> None:
    """Answer the messages of an MCP client. A computation ends when its call is cancelled or the input ends."""
    from mcp.server.stdio import stdio_server

    from service.api.mcp_tools import ToolError, server_of
    from service.cli.client import path_of
    from service.errors import InvalidBodyError, ProblemType

    async def compute(operation: str, body: Mapping[str, Any], _: Any) -> dict[str, Any]:
        try:
            answer = await client.compute_until_cancelled(http, operation, dict(body))
            if "key" not in answer:  # The answer is a job, for which a tool cannot wait.
                await http.delete(path_of(answer["id"]))
                detail = "more samples than are answered at once: lower it"
                raise InvalidBodyError([{"pointer": "/sampling/max_samples", "detail": detail}])
        except RefusedError as error:
            raise ToolError(error.problem) from None
        except CommandError as error:
            raise ToolError(ProblemType.of_status(HTTPStatus.BAD_GATEWAY).content(str(error))) from None
        return answer

    server = server_of(compute)
    messages = cast(Any, lines_of(sys.stdin.fileno()))
    async with client.asynchronous() as http, stdio_server(messages) as (reading, writing):
        await server.run(reading, writing, server.create_initialization_options())


async def lines_of(descriptor: int) -> AsyncIterator[str]:
    """Yield the lines of a file as they arrive.

    The MCP SDK would read standard input in a thread. No signal interrupts that thread while the input is open, so
    SIGTERM could not end the process.
    """
    import anyio

    rest = b""
    while True:
        with suppress(PermissionError):  # epoll refuses regular files, which are always readable.
            await anyio.wait_readable(descriptor)
        part = os.read(descriptor, READ_BYTES)
        *lines, rest = (rest + part).split(b"\n")
        for line in lines if part else filter(None, [rest]):
            yield line.decode("utf-8", errors="replace")
        if not part:
            return


def add_openapi(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet openapi`."""
    parser.description = f"Write the contract of the service to {CONTRACT}."
    parser.epilog = examples("ricochet openapi")
    parser.add_argument("--check", action="store_true", help="only check that the file is up to date")
    parser.set_defaults(run=run_openapi)


def run_openapi(args: argparse.Namespace) -> int:
    """Write the contract; with `--check`, return 1 if the file is not up to date."""
    if not args.check:
        CONTRACT.parent.mkdir(exist_ok=True)
        OutputFile("openapi", (".json",), str(CONTRACT)).write(contract().encode())
        return 0
    if CONTRACT.exists() and CONTRACT.read_text(encoding="utf-8") == contract():
        return 0
    print(f"{CONTRACT} is not up to date; run `make openapi`", file=sys.stderr)
    return FAILED


def contract() -> str:
    """Return the OpenAPI document as text."""
    from service.api.app import create_app
    from service.settings import Settings

    return json.dumps(create_app(Settings()).openapi(), indent=2, ensure_ascii=False) + "\n"
