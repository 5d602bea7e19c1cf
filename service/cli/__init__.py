"""The `ricochet` command, which runs the module of the given command and turns errors into exit statuses.

The module of a command has a function `add_NAME(parser)`, which adds the flags and sets `run`, a function of the parsed
arguments that returns the exit status. Only the module of the command that runs is imported, since `ricochet --help`
would otherwise take seconds. Most modules import the solver and the service inside functions, so that their help is
fast too.
"""

import argparse
import atexit
import codecs
import gc
import io
import os
import signal
import sys
import threading
import unicodedata
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import NamedTuple

from service.cli.arguments import (
    EXIT_STATUSES,
    FAILED,
    INTERRUPTED,
    CommandError,
    UsageError,
    examples,
    reason_of,
)
from service.cli.outputs import check_outputs, one_answer
from service.cli.parser import Parser, with_values
from service.version import VERSION

PLAIN = {"°": "deg", "−": "-", "θ": "theta", "±": "+/-", "×": "x", "–": "-", "…": "..."}
"""ASCII replacements for characters that the encoding of a terminal may lack."""


COMPLETION = "_ARGCOMPLETE"
"""Environment variable that a shell sets to request completions from argcomplete."""
EVENT_LOOPS = frozenset({"serve", "mcp"})
"""Commands with an event loop in the main thread, which handles Ctrl-C itself."""


class Command(NamedTuple):
    """Name and help text of a command, and the module that defines it."""

    name: str
    help: str
    module: str


COMMANDS = (
    Command("init", "write a commented strike file to start from", "service.cli.init"),
    Command("trajectory", "motion of one impact", "service.cli.single"),
    Command("cra", "critical ricochet angle of one impact", "service.cli.single"),
    Command("uncertainty", "uncertainty of a critical angle or of an outcome", "service.cli.uncertainty"),
    Command("formulas", "penetration depth and least thickness by empirical formulas", "service.cli.walls"),
    Command("thickness", "least thickness of a wall that is not perforated", "service.cli.walls"),
    Command("limit-speed", "least speed that perforates a wall", "service.cli.walls"),
    Command("flight", "landing point of a body after a ricochet", "service.cli.flight"),
    Command("report", "two-page report of a strike, as HTML or PDF", "service.cli.reports"),
    Command("batch", "results of many cases from a file", "service.cli.batch"),
    Command("sweep", "one case over ranges of up to four of its fields", "service.cli.batch"),
    Command("jobs", "list, follow and cancel the jobs of a service", "service.cli.jobs"),
    Command("serve", "run the service, configured by RICOCHET_... variables", "service.cli.serve"),
    Command("mcp", "offer the solver as tools of the Model Context Protocol", "service.cli.serve"),
    Command("keys", "add, list and revoke the API keys of a service", "service.cli.data_folder"),
    Command("cache", "inspect and repair the stored results", "service.cli.data_folder"),
    Command("calibrate", "fit strength factors to tests or finite element histories", "service.cli.calibrate"),
    Command("openapi", "write the contract, openapi/openapi.json", "service.cli.serve"),
    Command("completion", "print a script that completes commands and flags in a shell", "service.cli.init"),
    Command("version", "print the versions of the package and the solver", "service.cli"),
    Command("help", "print the help of a command", "service.cli"),
)


def add_version(parser: argparse.ArgumentParser) -> None:
    """Set up the parser of `ricochet version`, which has no arguments."""
    parser.description = "Print the version of the package and of the solver; results can change with the latter."
    parser.epilog = examples("ricochet version")
    parser.set_defaults(run=print_versions)


def print_versions(_: argparse.Namespace) -> int:
    """Print the versions of the package and of the solver."""
    from solver import ENGINE_VERSION

    print(f"ricochet {VERSION}, engine {ENGINE_VERSION}")
    return 0


def add_help(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet help`."""
    parser.description = "Print the help of a command, as its flag --help does, or the list of commands."
    parser.epilog = examples("ricochet help", "ricochet help cra", "ricochet help jobs results")
    parser.add_argument(
        "words", nargs="*", metavar="COMMAND", help="name of a command, and of its action if it has any"
    )
    parser.set_defaults(run=print_help)


def print_help(args: argparse.Namespace) -> int:
    """Print the help of a command. argparse then ends the process."""
    return run(next(iter(args.words), ""), [*args.words, "--help"])


def main(arguments: list[str] | None = None) -> int:
    """Run the `ricochet` command with the given arguments, by default `sys.argv`; return its exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    prepare_streams()
    # The garbage collection at exit would take a quarter of a second to free memory that the system frees anyway.
    atexit.register(gc.freeze)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # Small systems of equations are slower on several threads.
    os.environ.pop("MPLBACKEND", None)  # Plots go to files, and a notebook's backend might not be installed.
    os.environ["MATPLOTLIBRC"] = os.devnull  # Figures have their own style, whatever the user's.
    if COMPLETION in os.environ:
        # The shell asks for completions, and passes the line typed so far in a variable. Its first word is `ricochet`.
        arguments = os.environ.get("COMP_LINE", "").split()[1:]
    name = next((argument for argument in arguments if not argument.startswith("-")), "")
    try:
        with interruptible(name):
            return run(name, arguments)
    except UsageError as error:
        command = error.command or f"ricochet {name}"
        print(f"{command}: {error}\n{command} --help lists what it takes", file=sys.stderr)
        return error.status
    except CommandError as error:
        print(f"ricochet {name}: {error}", file=sys.stderr)
        return error.status
    except KeyboardInterrupt:
        return interrupted()
    except BrokenPipeError:
        # The reader of the pipe, such as `head`, has closed it. Without this line, the flush at exit would raise again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # This is most likely a full disk.
        print(f"ricochet {name}: {reason_of(error)}", file=sys.stderr)
        return FAILED


@contextmanager
def interruptible(name: str) -> Iterator[None]:
    """Raise `KeyboardInterrupt` in place of any error that Ctrl-C has caused.

    A C extension that is importing modules may convert the interruption to another error: numpy raises `ImportError`.
    Commands with an event loop leave Ctrl-C to asyncio, which replaces only the default handler of Python.
    """
    if name in EVENT_LOOPS or threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed = False

    def press(*_: object) -> None:
        nonlocal pressed
        pressed = True
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, press)
    try:
        yield
    except BaseException as error:
        if pressed:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)


def interrupted() -> int:
    """Report that Ctrl-C was pressed, and return the exit status."""
    # From now on Ctrl-C ends the process at once, without a traceback from a function that runs at exit.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # If Ctrl-C interrupted `exec` or `eval` of a string, as in the definition of a named tuple, Python would end the
    # process by the signal instead of with this exit status. Evaluating another string resets that state.
    eval("None")  # noqa: S307 (a constant)
    print("interrupted", file=sys.stderr)
    return INTERRUPTED


def prepare_streams() -> None:
    """Replace closed standard streams with /dev/null, and characters that an encoding lacks with ASCII."""
    codecs.register_error("plain", plain)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            # The stream stays open until the process exits.
            setattr(sys, name, os.fdopen(nowhere, mode, encoding="utf-8", closefd=False))
        elif isinstance(stream, io.TextIOWrapper) and mode == "w":
            stream.reconfigure(errors="plain")


def plain(error: UnicodeError) -> tuple[str, int]:
    """Return ASCII replacements for characters that an encoding lacks, and the position after them."""
    assert isinstance(error, UnicodeEncodeError)  # noqa: S101 (only output streams use this handler)
    found = ""
    for character in error.object[error.start : error.end]:
        known = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
        found += PLAIN.get(character) or known or "?"
    return found, error.end


def define(command: Command, parser: argparse.ArgumentParser) -> None:
    """Import the module of a command, and add its flags to the parser."""
    getattr(import_module(command.module), f"add_{command.name.replace('-', '_')}")(parser)


def run(name: str, arguments: Sequence[str]) -> int:
    """Parse the arguments and run the command; only its module is imported and only its flags are known."""
    parser = Parser(
        prog="ricochet",
        description="Critical ricochet angles of rigid projectiles on concrete, computed here or by a service (--url).",
        epilog=f"{examples('ricochet cra --help')}\n\n{EXIT_STATUSES}",
    )
    parser.add_argument("--version", action="version", version=f"ricochet {VERSION}", help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    known = False
    for command in COMMANDS:
        subparser = commands.add_parser(command.name, help=command.help)
        if command.name == name:
            known = True
            define(command, subparser)
    if name and not known and COMPLETION not in os.environ:
        import_module("service.cli.single").add_operation_command(commands, name)
    if COMPLETION in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser)  # This prints the completions, and ends the process.
    args = parser.parse_args(with_values(arguments))
    check_outputs(args)
    with one_answer(args):
        status: int = args.run(args)
    sys.stdout.flush()
    return status
