"""The body of a request, from a file and from flags, and where each part of it has come from."""

import argparse
import json
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.commands.errors import CommandError, RefusedError
from service.commands.flags import Flag

STDIN = "-"


@dataclass(frozen=True, slots=True)
class Body:
    """The body of a request.

    Parameters
    ----------
    content
        As it is sent.
    file
        It comes from; None if from flags alone.
    flags
        Those that could have been given, by pointer.
    given
        Those that were, as they were typed, by pointer.
    """

    content: dict[str, Any]
    file: str | None
    flags: Mapping[str, Flag]
    given: Mapping[str, str]

    def told(self, pointer: str, detail: str) -> str:
        """Return what is wrong at a place of the body, in the words of whoever gave it."""
        if pointer in self.given:
            return f"{self.given[pointer]}: {detail}"
        if self.file is not None:
            return f"{self.file}: {pointer or '/'}: {detail}"
        if pointer == "/projectile/nose":
            return "--caliber-radius-head is missing"
        return f"{self.flags[pointer].name} is missing" if pointer in self.flags else f"{pointer}: {detail}"

    def explained(self, error: RefusedError) -> CommandError:
        """Return a refusal in the words of whoever gave what is refused."""
        if not error.errors:
            return error
        return CommandError(
            "\n".join(self.told(each["pointer"], each["detail"]) for each in error.errors), error.status
        )


def read_body(file: str | Path | None, asked: argparse.Namespace, flags: Sequence[Flag]) -> Body:
    """Return the body that a file and flags give; flags go before the file.

    Raises
    ------
    CommandError
        If the file holds no object, or a field cannot be set.
    """
    content: dict[str, Any] = {} if file is None else read_object(file)
    given = {}
    for flag in flags:
        value = getattr(asked, "/".join(flag.steps))
        _put_number(content, flag, value)
        if value is not None:
            given[flag.pointer] = flag.name
    for text in getattr(asked, "set", ()):
        field, value = _split(text)
        _put_field(content, field.split("."), value, text)
        given["/" + field.replace(".", "/")] = f"--set {text}"
    return Body(content, None if file is None else str(file), {flag.pointer: flag for flag in flags}, given)


def _put_number(body: dict[str, Any], flag: Flag, value: float | None) -> None:
    """Put the value of a flag at its place; without one, see to it that the place can be missed."""
    place: Any = body
    for step in flag.steps[:-1]:
        place = place.setdefault(step, {}) if isinstance(place, dict) else None
    if value is not None and isinstance(place, dict):
        if flag.steps[-2] == "nose":
            place.clear()
            place["shape"] = "ogive"
        place[flag.steps[-1]] = value


def _split(text: str) -> tuple[str, Any]:
    field, equals, value = text.partition("=")
    if not equals or not all(field.split(".")):
        raise CommandError(f"--set {text}: must be FIELD=VALUE, such as impact.velocity_m_s=300")
    try:
        return field, json.loads(value)
    except (ValueError, RecursionError):
        return field, value  # a word, such as the name of a model


def _put_field(body: dict[str, Any], steps: Sequence[str], value: Any, text: str) -> None:
    place = body
    for step in steps[:-1]:
        place = place.setdefault(step, {})
        if not isinstance(place, dict):
            raise CommandError(f"--set {text}: {step} is no object")
    place[steps[-1]] = value


def read_object(file: str | Path) -> dict[str, Any]:
    """Return the object in a JSON or TOML file.

    Raises
    ------
    CommandError
        If there is none.
    """
    text = _read_text(file)
    try:
        content = _from_toml(text) if Path(file).suffix.lower() == ".toml" else json.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise CommandError(f"{file}: not TOML: {error}") from None
    except json.JSONDecodeError as error:
        raise CommandError(f"{file}:{error.lineno}: not JSON: {error.msg}") from None
    except ValueError as error:  # a number with thousands of digits
        raise CommandError(f"{file}: {error}") from None
    except RecursionError:
        raise CommandError(f"{file}: nested too deep") from None
    if not isinstance(content, dict):
        raise CommandError(f"{file}: must be a JSON object")
    return content


def _from_toml(text: str) -> Any:
    """Return what JSON has in its place: a date is text, which no field takes."""
    return json.loads(json.dumps(tomllib.loads(text), default=str))


def _read_text(file: str | Path) -> str:
    try:
        content = sys.stdin.buffer.read() if str(file) == STDIN else Path(file).read_bytes()
    except OSError as error:
        raise CommandError(f"{file}: {error.strerror or error}") from None
    if not content.strip():
        raise CommandError(f"{file}: the file is empty")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CommandError(f"{file}:{line}: not a text file in UTF-8") from None
