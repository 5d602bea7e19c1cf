"""How the help of the commands looks."""

import argparse
from collections.abc import Sequence
from typing import Any


class Formatter(argparse.HelpFormatter):
    """Wraps prose; a text of several lines, such as an example, stays as it is."""

    def __init__(self, *settings: Any, **named: Any) -> None:
        super().__init__(*settings, **{"max_help_position": 28} | named)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if "\n" in text else super()._fill_text(text, width, indent)


def examples(*commands: str) -> str:
    """Return the end of a help: commands that work as they are."""
    return "\n".join(("example:" if len(commands) == 1 else "examples:", *(f"  {command}" for command in commands)))


def add_actions(
    parser: argparse.ArgumentParser, name: str, actions: Sequence[tuple[str, str, str]]
) -> dict[str, argparse.ArgumentParser]:
    """Add actions to a command, each by its name, its help and an example; return their parsers."""
    found: Any = parser.add_subparsers(dest=name, required=True, metavar=name.upper())
    return {
        action: found.add_parser(
            action,
            help=help_,
            description=f"{help_[0].upper()}{help_[1:]}.",
            formatter_class=Formatter,
            epilog=examples(example),
        )
        for action, help_, example in actions
    }
