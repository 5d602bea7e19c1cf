"""`ricochet openapi`: the committed contract."""

import argparse
import json
import sys
from pathlib import Path

from service.commands.parsers import examples

CONTRACT = Path("openapi/openapi.json")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its flag."""
    parser.description = f"Write the contract to {CONTRACT}."
    parser.epilog = examples("ricochet openapi")
    parser.add_argument("--check", action="store_true", help="only tell whether the file there is up to date")


def run(asked: argparse.Namespace) -> int:
    """Write the contract, or return 1 if the one there is not up to date."""
    return check_contract() if asked.check else write_contract()


def contract() -> str:
    """Return the contract as text."""
    from service.api.app import create_app
    from service.settings import Settings

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
