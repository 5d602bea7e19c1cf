"""The `ricochet` command."""

import argparse
import json
import signal
import sys
from importlib.metadata import version
from pathlib import Path

import uvicorn
from pydantic import ValidationError

from service.app import STOP_SECONDS, create_app
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
    commands.add_parser("version", help="print the versions of the package and the solver")
    asked = parser.parse_args(arguments)
    if asked.command == "serve":
        try:
            return serve(Settings())
        except ValidationError as error:
            parser.error(f"a RICOCHET_... variable is wrong: {error}")
    if asked.command == "openapi":
        return check_contract() if asked.check else write_contract()
    print(f"ricochet {version('ricochet')}, engine {ENGINE_VERSION}")
    return 0


def serve(settings: Settings) -> int:
    """Run the service until SIGTERM or SIGINT."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # uvicorn raises it again once it has stopped
    uvicorn.run(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        access_log=False,
        timeout_graceful_shutdown=settings.grace_seconds - STOP_SECONDS,
    )
    return 0


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
