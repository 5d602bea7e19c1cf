"""`ricochet version`: what is installed."""

import argparse
from importlib.metadata import version

from service.commands.parsers import examples


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its help."""
    parser.description = "Print the versions of the package and of the solver, whose results change with the latter."
    parser.epilog = examples("ricochet version")


def run(_: argparse.Namespace) -> int:
    """Print the versions."""
    from solver import ENGINE_VERSION

    print(f"ricochet {version('ricochet')}, engine {ENGINE_VERSION}")
    return 0
