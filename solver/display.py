"""Answers as text: one line for a console, a small card for a notebook."""

from collections.abc import Iterable, Mapping
from html import escape
from typing import Protocol


class Warned(Protocol):
    """A warning of an answer."""

    @property
    def code(self) -> str:
        """Stable name."""

    @property
    def detail(self) -> str:
        """Explanation."""


def line(answer: object, *parts: str) -> str:
    """Return the class of an answer and what it holds, in one line; empty parts are left out."""
    return f"<{type(answer).__name__}: {', '.join(filter(None, parts))}>"


def card(title: str, rows: Mapping[str, str], warnings: Iterable[Warned] = (), more: str = "") -> str:
    """Return an answer as HTML in the colours of the notebook, light or dark.

    Parameters
    ----------
    title
        Of the answer, as text.
    rows
        Names and values, as text; empty values are left out.
    warnings
        Of the answer; folded.
    more
        Further HTML, which is not escaped.
    """
    cells = "".join(
        f'<tr><th style="text-align:left;font-weight:normal">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows.items()
        if value
    )
    found = [f"<li><code>{escape(each.code)}</code> {escape(each.detail)}</li>" for each in warnings]
    count = "1 warning" if len(found) == 1 else f"{len(found)} warnings"
    folded = f"<details><summary>{count}</summary><ul>{''.join(found)}</ul></details>" if found else ""
    table = f'<table style="color:inherit">{cells}</table>'
    return f"<div><strong>{escape(title)}</strong>{table}{more}{folded}</div>"
