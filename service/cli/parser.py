"""Command-line parser: argparse with one-line error messages and suggestions for misspelt words."""

import argparse
import difflib
import re
import shutil
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NoReturn

from service.cli.arguments import STRIKE, UsageError
from service.names import ALIASES

NEGATIVE = re.compile(r"-\.?\d")
"""Pattern of the first characters of a negative number."""
FLAG_COLUMN = re.compile(r"^  (-.*)$", re.MULTILINE)
"""Pattern of the lines of a help text that begin with a flag."""
FLAG = re.compile(r"(?<![\w-])--?[a-z][a-z-]*")
SIMILAR = 0.7
"""Least difflib ratio at which a flag is suggested for a misspelt one [1]. An arbitrary choice. Leading hyphens are not
compared."""
WORDING: Sequence[tuple[str, Callable[[re.Match[str]], str]]] = (
    (
        r"argument (?P<flag>-.*?): invalid choice: '?(?P<word>.*?)'? \(choose from (?P<known>.*)\)",
        lambda found: f"{found['flag']}: unknown value {found['word']!r}; expected {_listed(found['known'])}",
    ),
    (
        r"argument (?P<flag>.*?): invalid choice: '?(?P<word>.*?)'? \(choose from (?P<known>.*)\)",
        lambda found: f"{found['word']}: unknown {found['flag'].lower()}; expected {_listed(found['known'])}",
    ),
    (r"argument (.*?): invalid float value: (.*)", lambda found: f"{found[1]}: must be a number, got {found[2]}"),
    (r"argument (.*?): invalid int value: (.*)", lambda found: f"{found[1]}: must be a whole number, got {found[2]}"),
    (r"argument (.*?): expected (?:one|at least one) argument", lambda found: f"{found[1]}: needs a value"),
    (r"argument (.*?): not allowed with argument (.*)", lambda found: f"{found[1]}: cannot go with {found[2]}"),
    (r"the following arguments are required: (.*)", lambda found: f"{found[1]}: is missing"),
    (r"argument (.*)", lambda found: found[1]),
)
"""Patterns of argparse's error messages, with functions that reword them. argparse reports errors only as text;
messages that match no pattern are printed unchanged."""


class Parser(argparse.ArgumentParser):
    """Parser that raises `UsageError`, accepts no abbreviated flags, and keeps the layout of examples."""

    def __init__(self, *args: Any, **options: Any) -> None:
        layout = partial(argparse.RawDescriptionHelpFormatter, max_help_position=28)
        super().__init__(*args, **{"formatter_class": layout, **options, "allow_abbrev": False})
        self.subcommands: Mapping[str, Parser] = {}
        """Parsers of the actions of this command, by name."""

    def add_subparsers(self, **options: Any) -> Any:
        """Add the actions of this command, and keep their parsers."""
        added: Any = super().add_subparsers(**options)
        self.subcommands = added.choices
        return added

    def format_help(self) -> str:
        """Return the help text with its description wrapped to the width of the terminal."""
        # argparse wraps both description and examples, or neither, so the description is wrapped here.
        width = shutil.get_terminal_size().columns - 2
        self.description = textwrap.fill(self.description or "", width)
        return super().format_help()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse all arguments. The parser of the command, which can suggest its flags, reports unknown ones."""
        found, rest = super().parse_known_args(args, namespace)
        if rest:
            word = next((word for word in rest if word.startswith("-")), rest[0])
            if not word.startswith("-"):
                self.error(f"{word}: is an unexpected argument")
            name, _, _ = word.partition("=")
            self.error(f"{name}: unknown flag{self._suggestion(name)}")
        return found, rest

    def error(self, message: str) -> NoReturn:
        """Raise a `UsageError` with the reworded message."""
        for pattern, worded in WORDING:
            if found := re.fullmatch(pattern, message):
                raise UsageError(worded(found) + _closest_choice(found.groupdict()), self.prog)
        raise UsageError(message, self.prog)

    def _suggestion(self, name: str) -> str:
        """Return a suggestion for a misspelt flag, preferably the flag of the quantity that it names."""
        known = {flag for line in FLAG_COLUMN.findall(self.format_help()) for flag in FLAG.findall(line)}
        quantity = name.lstrip("-").replace("-", "_")
        for flag in STRIKE:
            if flag.name in known and quantity in ALIASES.get(".".join(flag.steps), ()):
                return f"; did you mean {flag.name}?"
        words = {flag.lstrip("-"): flag for flag in sorted(known)}
        begun = sorted((word for word in words if word.startswith(name.lstrip("-"))), key=len)
        found = begun or difflib.get_close_matches(name.lstrip("-"), words, 1, SIMILAR)
        return f"; did you mean {words[found[0]]}?" if found else ""


def _listed(known: str) -> str:
    return ", ".join(_words(known))


def _words(known: str) -> list[str]:
    """Return the choices in a message of argparse, which are quoted in some versions of Python."""
    return [word.strip("'") for word in known.split(", ")]


def _closest_choice(found: dict[str, str | Any]) -> str:
    known = _words(found["known"]) if "known" in found else []
    close = difflib.get_close_matches(found.get("word", ""), known, 1)
    return f"; did you mean {close[0]}?" if close else ""


def with_values(arguments: Iterable[str]) -> list[str]:
    """Join negative numbers to the flag before them by an equals sign.

    argparse would take values such as -1e-1 and -1,2 for flags.
    """
    found: list[str] = []
    for word in arguments:
        if NEGATIVE.match(word) and found and found[-1].startswith("--") and "=" not in found[-1]:
            found[-1] = f"{found[-1]}={word}"
        else:
            found.append(word)
    return found
