"""Request body of one case from a file and flags, and error messages that name the file or flag of a field."""

import argparse
import json
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.cli.arguments import MODEL_NAMES, CommandError, Flag, InputFile, RefusedError

STDIN = "-"
MAX_BYTES, MAX_OBJECT = 2**30, 10_000_000
"""Largest file of JSON lines and largest file of one case [bytes]; without a limit, a device such as /dev/zero would be
read forever. A service accepts 200 MiB of JSON lines and 128 KiB in one case by default."""
QUOTED = re.compile(r""""(?:[^"\\\n]|\\.)*+"?|'[^'\n]*+'?""")
DEEP_KEY = re.compile(r"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){100}")
"""Pattern of an unquoted TOML key of more than 100 parts. The time that tomllib takes grows with the square of their
number, so the longest keys would take minutes."""
MISSING = "is missing"
"""Message for a missing required field, the same as in `service.schemas.wording`."""
WALL_PARTS = {"projectile", "target", "impact", "resistance", "numerics", "strength_scatter"}
SOUGHT = {"thickness": ("target", "thickness_m"), "limit-speed": ("impact", "velocity_m_s")}
"""Field that a search for perforation determines, by operation."""


@dataclass(frozen=True, slots=True)
class RequestBody:
    """A request body, with the flag or the file from which each field comes.

    Parameters
    ----------
    content
        JSON object.
    file
        File of the object; None if it comes from flags only.
    flags
        Flags of the command by JSON pointer.
    given
        Flags on the command line as typed, by JSON pointer.
    """

    content: dict[str, Any]
    file: str | None
    flags: Mapping[str, Flag]
    given: Mapping[str, str]

    def describe(self, pointer: str, detail: str) -> str:
        """Return an error message that names the flag or the file of the field."""
        if pointer in self.given:
            return f"{self.given[pointer]}: {detail}"
        if self.file is not None:
            flag = self.flags.get(pointer) if detail == MISSING else None
            names = "" if flag is None else f"; give it there or by {(*flag.short, flag.name)[0]}"
            return f"{self.file}: {pointer or '/'}: {detail}{names}"
        if pointer == "/projectile/nose":
            return "--nose or --caliber-radius-head is missing"
        return f"{self.flags[pointer].name} is missing" if pointer in self.flags else f"{pointer}: {detail}"

    def value_at(self, pointer: str) -> Any:
        """Return the value at a pointer; None if there is no value."""
        value: Any = self.content
        for step in pointer.split("/")[1:]:
            value = value.get(step) if isinstance(value, dict) else None
        return value

    def explain(self, error: RefusedError) -> CommandError:
        """Return an error that names the flag or the file of each invalid field."""
        if not error.errors:
            return error
        lines = [self.describe(each["pointer"], each["detail"]) for each in error.errors]
        return CommandError("\n".join(lines), error.status)


def read_body(file: str | Path | None, args: argparse.Namespace, flags: Sequence[Flag]) -> RequestBody:
    """Read the request body from a file and flags, which override the file.

    Raises
    ------
    CommandError
        If the file holds no object, or a field cannot be set.
    """
    content: dict[str, Any] = {} if file is None else read_object(file)
    values = [(flag, getattr(args, "/".join(flag.steps))) for flag in flags]
    for flag, value in values:
        if flag.steps[:-1] not in MODEL_NAMES:
            _put_number(content, flag, value)
    chosen = [
        (flag, read_own_shots(flag, value) if isinstance(value, InputFile) else value)
        for flag, value in values
        if value is not None
    ]
    given = {flag.pointer: flag.name for flag, _ in chosen}
    for part in MODEL_NAMES:
        put_model(content, part, [(flag, value) for flag, value in chosen if flag.steps[:-1] == part])
    for text in getattr(args, "set", ()):
        field, value = _split(text)
        put_field(content, field.split("."), value, f"--set {text}")
        given["/" + field.replace(".", "/")] = f"--set {text}"
    return RequestBody(content, None if file is None else str(file), {flag.pointer: flag for flag in flags}, given)


def read_own_shots(flag: Flag, file: InputFile) -> list[dict[str, float]]:
    """Read a file of the user's own shots, and return them as the `shots` of the model `own_tests`.

    Raises
    ------
    CommandError
        If the file holds no shots. The message names the flag.
    """
    from service.readers.calibration import read_shots
    from service.readers.files import FileError

    units = {"velocity": "m_s", "depth": "m", "mass": "kg", "diameter": "m"}
    try:
        shots = read_shots(file)
    except FileError as error:
        raise CommandError(f"{flag.name} {error}") from None
    return [
        {f"{name}_{unit}": value for name, unit in units.items() if (value := getattr(shot, name)) is not None}
        for shot in shots
    ]


def without_sought(body: RequestBody, operation: str) -> RequestBody:
    """Remove the fields that a search for perforation determines or does not use, and return the body.

    The field to find is kept if it is given on the command line, so that it is refused by name.
    """
    if operation in SOUGHT:
        part, field = SOUGHT[operation]
        for name in body.content.keys() - WALL_PARTS:
            del body.content[name]
        if isinstance(body.content.get(part), dict) and f"/{part}/{field}" not in body.given:
            body.content[part].pop(field, None)
    return body


def _put_number(body: dict[str, Any], flag: Flag, value: float | None) -> None:
    """Set the field of a flag. Without a value, only add its parent objects, so that validation names the field."""
    parent: Any = body
    if value is None and len(flag.steps) > 2:
        return  # Nested parts, such as the boat-tail of a projectile, are optional.
    for step in flag.steps[:-1]:
        parent = parent.setdefault(step, {}) if isinstance(parent, dict) else None
    if value is not None and isinstance(parent, dict):
        parent[flag.steps[-1]] = value


def put_model(body: dict[str, Any], part: tuple[str, ...], chosen: Sequence[tuple[Flag, Any]]) -> None:
    """Set a part that has a choice of models, such as the nose, from its flags.

    A model in the file is kept if it has the fields that the flags set.

    Raises
    ------
    CommandError
        If a flag belongs to a model other than the one named on the command line.
    """
    holder: Any = body.setdefault(part[0], {}) if chosen or part[0] == "projectile" else None
    if not chosen or not isinstance(holder, dict):
        return
    name, before = MODEL_NAMES[part], holder.get(part[1])
    values = {flag.steps[-1]: value for flag, value in chosen}
    model = values.get(name) or (before.get(name) if isinstance(before, dict) else None)
    for flag, _ in chosen:
        if flag.implies and model not in flag.implies:
            if name in values:
                raise CommandError(f"{flag.name}: is of {' or '.join(flag.implies)}, not of {model}")
            model = flag.implies[0]
    kept = before if isinstance(before, dict) and before.get(name) == model else {}
    holder[part[1]] = {**kept, name: model, **values}


def _split(text: str) -> tuple[str, Any]:
    field, equals, value = text.partition("=")
    if not equals or not all(field.split(".")):
        raise CommandError(f"--set {text}: must be FIELD=VALUE, such as impact.velocity_m_s=300")
    try:
        return field, json.loads(value)
    except (ValueError, RecursionError):
        return field, value  # The value is a string, such as the name of a model.


def put_field(body: dict[str, Any], steps: Sequence[str], value: Any, text: str) -> None:
    """Set any field of a body.

    Parameters
    ----------
    text
        Flag or header that sets the field, for the error message.

    Raises
    ------
    CommandError
        If a parent of the field is not an object.
    """
    parent = body
    for step in steps[:-1]:
        parent = parent.setdefault(step, {})
        if not isinstance(parent, dict):
            raise CommandError(f"{text}: {step} is not an object")
    parent[steps[-1]] = value


def read_object(file: str | Path) -> dict[str, Any]:
    """Read the object in a JSON or TOML file.

    Raises
    ------
    CommandError
        If the file cannot be read or parsed, or does not hold an object.
    """
    text = read_text(file, MAX_OBJECT)
    try:
        content = _parse_toml(text) if Path(file).suffix.lower() == ".toml" else json.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise CommandError(f"{file}: not TOML: {error}") from None
    except json.JSONDecodeError as error:
        raise CommandError(f"{file}:{error.lineno}: not JSON: {error.msg}") from None
    except ValueError:  # Python limits the digits of an integer, since the conversion takes quadratic time.
        raise CommandError(f"{file}: holds a number of more than 4300 digits") from None
    except RecursionError:
        raise CommandError(f"{file}: nested too deep") from None
    if not isinstance(content, dict):
        raise CommandError(f"{file}: must be a JSON object")
    return content


def _parse_toml(text: str) -> Any:
    """Parse TOML to JSON values. Dates and times become strings."""
    if DEEP_KEY.search(QUOTED.sub("x", text)):
        raise RecursionError
    return json.loads(json.dumps(tomllib.loads(text), default=str))


def read_text(file: str | Path, limit: int = MAX_BYTES) -> str:
    """Read the text of a file or, for `-`, of standard input.

    Parameters
    ----------
    limit
        Largest accepted size [bytes].

    Raises
    ------
    CommandError
        If the file cannot be read, is empty, too large or not UTF-8.
    """
    try:
        with nullcontext(sys.stdin.buffer) if str(file) == STDIN else Path(file).open("rb") as stream:
            content = stream.read(limit + 1)
    except OSError as error:
        raise CommandError(f"{file}: {error.strerror or error}") from None
    if len(content) > limit:
        raise CommandError(f"{file}: the file is larger than {limit:,} bytes")
    if not content.strip():
        raise CommandError(f"{file}: the file is empty")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CommandError(f"{file}:{line}: not a UTF-8 text file") from None
