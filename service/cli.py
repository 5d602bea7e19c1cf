"""The `ricochet` command."""

import argparse
import sys
from importlib.metadata import version

from pydantic import ValidationError

from service.commands import cache, calibrate, contract, reports
from service.commands.serve import serve
from service.settings import Settings
from solver import ENGINE_VERSION


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return its exit status."""
    parser = argparse.ArgumentParser(prog="ricochet", description="Critical ricochet angles over HTTP.")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("serve", help="run the service, as the RICOCHET_... variables say")
    export = commands.add_parser("openapi", help=f"write the contract to {contract.CONTRACT}")
    export.add_argument("--check", action="store_true", help="only tell whether the file there is up to date")
    results = commands.add_parser("cache", help="look after the results of the data folder")
    cache.add_commands(results.add_subparsers(dest="action", required=True))
    calibrate.add_commands(commands)
    reports.add_commands(commands)
    commands.add_parser("version", help="print the versions of the package and the solver")
    asked = parser.parse_args(arguments)
    if asked.command in {"serve", "cache"}:
        try:
            settings = Settings()
        except ValidationError as error:
            parser.error(f"a RICOCHET_... variable is wrong: {error}")
        return serve(settings) if asked.command == "serve" else cache.look_after(settings, asked)
    if asked.command == "calibrate":
        return calibrate.run(asked)
    if asked.command in {"reproduce", "validate"}:
        return reports.run(asked)
    if asked.command == "openapi":
        return contract.check_contract() if asked.check else contract.write_contract()
    print(f"ricochet {version('ricochet')}, engine {ENGINE_VERSION}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
