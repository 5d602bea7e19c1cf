"""Descriptions of quantities: text and unit of each field of a dataclass, read from docstrings.

A field is described once, where it is defined: in a docstring below it, or under *Parameters* in the docstring of its
class, with the unit in brackets. The manual and editors show that text as it is. This module provides it to the
contract of the service, the columns of tables and the labels of axes.
"""

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from inspect import cleandoc, getsource
from itertools import pairwise
from typing import NamedTuple, get_args, get_origin, get_type_hints

UNIT = re.compile(r"\s*\[([^\]]+)\]")
"""Pattern of a unit in brackets, which follows a description or one of its sentences."""
PARAMETER = re.compile(r"^ {4}(\w+(?:, \w+)*)\n((?: {8}.*\n?)+)", re.MULTILINE)
"""Pattern of an entry under *Parameters* in a docstring: one or more names, and their description."""


class Quantity(NamedTuple):
    """Description and unit of a field."""

    text: str
    """Description of the quantity, without its unit."""
    unit: str
    """Unit of its numbers in the solver; ``1`` for a pure number, empty if it is not a number."""

    @property
    def short(self) -> str:
        """First sentence of the description, for the label of a column or an axis."""
        sentence = self.text.partition(". ")[0].rstrip(".")
        return sentence[:1].lower() + sentence[1:]

    @classmethod
    def of(cls, docstring: str) -> "Quantity":
        """Split a docstring into text and unit.

        The unit is the first text in brackets without the word "or"; a choice such as ``[m or m/s]`` is not a unit.
        """
        units = [found for found in UNIT.findall(docstring) if " or " not in found]
        return cls(UNIT.sub("", docstring).strip(), "".join(units[:1]))


@cache
def field_docstrings(module: str) -> Mapping[str, Mapping[str, str]]:
    """Return the docstrings of all fields of the classes in a module, by class and field, each as one line."""
    # The docstrings are read from the source, because the interpreter does not keep the docstrings of fields.
    classes = [node for node in ast.parse(getsource(sys.modules[module])).body if isinstance(node, ast.ClassDef)]
    return {node.name: dict(_parameters(node)) | dict(_attributes(node)) for node in classes}


def _parameters(node: ast.ClassDef) -> Iterator[tuple[str, str]]:
    """Yield the name and description of each field under *Parameters* in the docstring of a class."""
    lines = ast.get_docstring(node, clean=False) or ""
    _, _, section = lines.partition("    Parameters\n    ----------\n")
    section, *_ = re.split(r"\n\n    \w+\n    -+\n", section)
    for names, text in PARAMETER.findall(section):
        for name in names.split(", "):
            yield name, " ".join(text.split())


def _attributes(node: ast.ClassDef) -> Iterator[tuple[str, str]]:
    """Yield the name and description of each field with a docstring below it."""
    for field, text in pairwise(node.body):
        if (
            isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
            and isinstance(text.value.value, str)
        ):
            yield field.target.id, cleandoc(text.value.value).replace("\n", " ")


@cache
def quantities(kind: type) -> Mapping[str, Quantity]:
    """Return the descriptions of the fields of a dataclass, including inherited ones."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if is_dataclass(base):
            found |= field_docstrings(base.__module__).get(base.__name__, {})
    return {field.name: Quantity.of(found.get(field.name, "")) for field in fields(kind)}


@cache
def columns_of(kind: type) -> Mapping[str, Quantity]:
    """Return the descriptions of the columns of a table whose rows are objects of a class.

    The columns of a nested object begin with the name of its field. A pair of numbers has two columns, which end in
    ``_low`` and ``_high``.
    """
    found: dict[str, Quantity] = {}
    for name, quantity in quantities(kind).items():
        found[name] = quantity
        for part in _parts_in(kind, name):
            found |= {f"{name}_{inner}": each for inner, each in columns_of(part).items()}
        found |= {f"{name}_low": quantity, f"{name}_high": quantity}
    return found


def _parts_in(kind: type, name: str) -> list[type]:
    """Return the dataclasses in the type of a field, except for the class itself."""
    hint = get_type_hints(kind)[name]
    known = [get_origin(each) or each for each in (hint, *get_args(hint))]
    return [each for each in known if isinstance(each, type) and is_dataclass(each) and each is not kind]


def described(name: str, *kinds: type) -> Quantity:
    """Return the description of a column of a table whose rows are objects of the given classes; empty if unknown.

    Parameters
    ----------
    name
        Name of a column, or a dotted name; only its last part is used.
    """
    name = name.rpartition(".")[2]
    return next(filter(None, (_described(name, kind) for kind in kinds)), Quantity("", ""))


def _described(name: str, kind: type) -> Quantity | None:
    known = columns_of(kind)
    parts = (part for field in quantities(kind) for part in _parts_in(kind, field))
    return known.get(name) or next(filter(None, (_described(name, part) for part in parts)), None)
