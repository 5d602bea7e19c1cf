"""The `ricochet` command: which commands there are, and how they end.

A command is a module of `service.commands` with `add_arguments(parser)` and `run(asked)`, which returns the exit
status. It is imported only when it is asked for: `ricochet --help` would otherwise wait seconds for the solver's
libraries.
"""

import argparse
import os
import sys
from importlib import import_module
from typing import Any, NamedTuple

from service.commands.errors import EXIT_STATUSES, FAILED, INTERRUPTED, CommandError, UsageError
from service.commands.parsers import Formatter, examples


class Command(NamedTuple):
    """A command and the module that does it."""

    name: str
    help: str
    module: str


COMMANDS = (
    Command("trajectory", "motion of one strike", "trajectory"),
    Command("cra", "critical ricochet angle of one strike", "cra"),
    Command("batch", "many cases from a file", "batch"),
    Command("sweep", "one case over ranges of up to four of its numbers", "sweep"),
    Command("jobs", "the jobs of a service", "jobs"),
    Command("serve", "run the service, as the RICOCHET_... variables say", "serve"),
    Command("keys", "say who may ask the service, and for how much", "keys"),
    Command("cache", "look after the results of the data folder", "cache"),
    Command("calibrate", "fit strength factors to tests or finite element histories", "calibrate"),
    Command("reproduce", "compute the paper anew, beside its own numbers", "reports"),
    Command("validate", "compare with published penetration tests", "reports"),
    Command("openapi", "write the contract, openapi/openapi.json", "contract"),
    Command("version", "print the versions of the package and the solver", "version"),
)


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return its exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    name = next((argument for argument in arguments if not argument.startswith("-")), "")
    try:
        return run(name, arguments)
    except CommandError as error:
        print(f"ricochet {name}: {error}", file=sys.stderr)
        return error.status
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # whoever reads has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except OSError as error:  # a full disk, most likely
        print(f"ricochet {name}: {error}", file=sys.stderr)
        return FAILED


def run(name: str, arguments: list[str]) -> int:
    """Run the command of this name; only its module is imported, only its own flags are known."""
    parser = argparse.ArgumentParser(
        prog="ricochet",
        description="Critical ricochet angles of rigid projectiles on concrete, computed here or by a service (--url).",
        epilog=f"{examples('ricochet cra --help')}\n\n{EXIT_STATUSES}",
        formatter_class=Formatter,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    asked_for, module = parser, None
    for command in COMMANDS:
        own = commands.add_parser(command.name, help=command.help, formatter_class=Formatter, allow_abbrev=False)
        if command.name == name:
            asked_for, module = own, import_module(f"service.commands.{command.module}")
            module.add_arguments(own)
    asked = parser.parse_args(arguments)
    return finished(asked_for, module, asked)


def finished(parser: argparse.ArgumentParser, module: Any, asked: argparse.Namespace) -> int:
    """Run a command to its end, all it prints included."""
    try:
        status: int = module.run(asked)
        sys.stdout.flush()
    except UsageError as error:
        parser.error(str(error))
    return status


if __name__ == "__main__":
    sys.exit(main())
