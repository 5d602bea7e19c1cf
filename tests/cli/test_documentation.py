"""What docs/command-line.md says, beside its blocks, which tests/docs runs."""

import re

from service import cli
from tests.cli.commands import ROOT

TEXT = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")


def test_every_command_has_its_line() -> None:
    rows = re.findall(r"^\| (`.*?`) \| .* \| `.*?ricochet ([\w-]+)", TEXT, re.MULTILINE)
    named = {name for names, _ in rows for name in re.findall(r"`([\w-]+)`", names)}
    assert {command.name for command in cli.COMMANDS} == named
    assert all(example in names for names, example in rows)
