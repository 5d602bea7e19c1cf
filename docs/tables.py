"""Write the generated tables of docs/operating.md, settings and metrics. With --check, only compare them.

Each table is between two comments, and the first comment names it. The rest of the page is written by hand.
"""

import re
import sys
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo

from service.api.services import LABELS, Metrics
from service.settings import GROUPS, Settings

PAGE = Path(__file__).with_name("operating.md")
BYTES = {"GiB": 1024**3, "MiB": 1024**2, "KiB": 1024}
SIGNS = ((Ge, "ge", "≥"), (Gt, "gt", ">"), (Le, "le", "≤"), (Lt, "lt", "<"))


def settings_table() -> str:
    """Return a heading and a table for each group of settings."""
    prefix = Settings.model_config["env_prefix"]
    parts = []
    for group, settings in GROUPS.items():
        rows = [
            (
                f"`{(prefix + name).upper()}`",
                default(name, field),
                bounds(field),
                described(field),
            )
            for name, field in settings.model_fields.items()
        ]
        found = table(("variable", "default", "bounds", "description and reason"), rows)
        parts.append(f"### {group.capitalize()}\n\n{settings.__doc__}\n\n{found}")
    return "\n\n".join(parts)


def metrics_table() -> str:
    """Return the table of metrics with their labels."""
    rows = []
    for family in Metrics().registry.collect():
        name = family.name + {"counter": "_total", "info": "_info"}.get(family.type, "")
        # LABELS lists the labels of families without samples; the build info always has a sample.
        labels = LABELS.get(family.name) or next(
            (tuple(sample.labels) for sample in family.samples if sample.labels), ()
        )
        shown = ", ".join(f"`{label}`" for label in labels)
        rows.append((f"`{name}`", "gauge" if family.type == "info" else family.type, shown, family.documentation))
    return table(("metric", "type", "labels", "description"), rows)


TABLES = {"settings": settings_table, "metrics": metrics_table}


def default(name: str, field: FieldInfo) -> str:
    """Return the default of a setting as Markdown; a size in bytes is repeated in a larger unit."""
    if field.default_factory is not None:
        return (field.default_factory.__doc__ or "").strip().rstrip(".").lower().removeprefix("return the ")
    value = field.default
    if value is None:
        return "none"
    if value in ("", ()):
        return "empty"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if name.endswith("bytes"):
        unit, size = next((unit, size) for unit, size in BYTES.items() if value % size == 0)
        return f"`{value}` ({value // size} {unit})"
    return f"`{value}`"


def described(field: FieldInfo) -> str:
    """Return the description of a setting, without the unit [1] of plain numbers, which looks like a footnote."""
    return " ".join((field.description or "").replace("[1]", "").split())


def bounds(field: FieldInfo) -> str:
    """Return the bounds or the allowed values of a setting as Markdown."""
    if get_origin(field.annotation) is Literal:
        return ", ".join(f"`{value}`" for value in get_args(field.annotation))
    if field.annotation is bool:
        return "`true`, `false`"
    found = [
        f"{sign} {getattr(bound, attribute):g}".replace("e+0", "e")
        for kind, attribute, sign in SIGNS
        for bound in field.metadata
        if isinstance(bound, kind)
    ]
    return ", ".join(found)


def table(head: tuple[str, ...], rows: list[Any]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def filled(page: str) -> str:
    """Return the page with newly generated tables."""
    for name, make in TABLES.items():
        place = re.compile(rf"(<!-- table: {name} -->\n).*?(<!-- end of table -->)", re.DOTALL)
        if len(place.findall(page)) != 1:
            raise SystemExit(f"{PAGE.name} must have one place for the table {name}")
        text = make() + "\n"
        page = place.sub(lambda found, text=text: found[1] + text + found[2], page)  # type: ignore[misc]
    return page


def main() -> int:
    """Write the tables or, with --check, return 1 if they are not up to date."""
    page = PAGE.read_text(encoding="utf-8")
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(filled(page), encoding="utf-8")
    elif page != filled(page):
        print(f"the tables of docs/{PAGE.name} are not up to date: run `make docs`", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
