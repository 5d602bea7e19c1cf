"""`ricochet openapi`: the committed contract."""

import json
import sys
from pathlib import Path

from service.app import create_app
from service.settings import Settings

CONTRACT = Path("openapi/openapi.json")


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
