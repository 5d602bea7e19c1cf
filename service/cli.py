"""The `ricochet` command."""

import argparse
import gc
import json
import signal
import socket
import sys
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from pydantic import ValidationError

from service import storage
from service.app import STOP_SECONDS, create_app
from service.logs import configure
from service.settings import Settings
from solver import ENGINE_VERSION

CONTRACT = Path("openapi/openapi.json")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return its exit status."""
    parser = argparse.ArgumentParser(prog="ricochet", description="Critical ricochet angles over HTTP.")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("serve", help="run the service, as the RICOCHET_... variables say")
    export = commands.add_parser("openapi", help=f"write the contract to {CONTRACT}")
    export.add_argument("--check", action="store_true", help="only tell whether the file there is up to date")
    cache = commands.add_parser("cache", help="look after the results of the data folder")
    add_cache_commands(cache.add_subparsers(dest="action", required=True))
    commands.add_parser("version", help="print the versions of the package and the solver")
    asked = parser.parse_args(arguments)
    if asked.command in {"serve", "cache"}:
        try:
            settings = Settings()
        except ValidationError as error:
            parser.error(f"a RICOCHET_... variable is wrong: {error}")
        return serve(settings) if asked.command == "serve" else look_after(settings, asked)
    if asked.command == "openapi":
        return check_contract() if asked.check else write_contract()
    print(f"ricochet {version('ricochet')}, engine {ENGINE_VERSION}")
    return 0


def add_cache_commands(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add what can be done to the results, each with its help."""
    actions.add_parser("stat", help="tell how much is stored, also while the service runs")
    actions.add_parser("verify", help="read everything, and set aside what is damaged")
    actions.add_parser("rebuild", help="make the index anew from the stored results")
    evict = actions.add_parser("evict", help="remove the results used longest ago")
    evict.add_argument("--bytes", type=int, help="what may stay; RICOCHET_CACHE_BYTES unless said otherwise")


def look_after(settings: Settings, asked: argparse.Namespace) -> int:
    """Do what is asked to the results; return 1 if it cannot be done or something was damaged."""
    folder, damaged = settings.data_dir, list[str]()
    try:
        if asked.action == "stat":
            found = storage.stat(folder)
        elif asked.action == "verify":
            verified = storage.verify(folder)
            found, damaged = verified.statistics, verified.damaged
        elif asked.action == "rebuild":
            found = storage.rebuild(folder)
        else:
            found = storage.evict(folder, settings.cache_bytes if asked.bytes is None else max(0, asked.bytes))
    except storage.UnusableFolderError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{found.cases} results, {found.segments} files, {found.bytes} bytes")
    for name in damaged:
        print(f"damaged, set aside: {name}")
    return 1 if damaged else 0


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


def contract() -> str:
    """Return the contract as text."""
    return json.dumps(create_app(Settings()).openapi(), indent=2, ensure_ascii=False) + "\n"


def write_contract() -> int:
    """Write the contract."""
    CONTRACT.parent.mkdir(exist_ok=True)
    CONTRACT.write_text(contract(), encoding="utf-8")
    return 0


def check_contract() -> int:
    """Return 0 if the committed contract is that of the application."""
    if CONTRACT.exists() and CONTRACT.read_text(encoding="utf-8") == contract():
        return 0
    print(f"{CONTRACT} is not up to date: run `make openapi`", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
