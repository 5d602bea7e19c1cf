"""stress.md and stress.json, and the table that is printed."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.stress.lines import Line
from benchmarks.tables import table

HELD = {True: "held", False: "**not held**", None: "not measured"}


def as_table(lines: list[Line]) -> str:
    """What is required, and what was measured, as a Markdown table."""
    rows = [[str(line.number), line.what, line.required, line.measured, HELD[line.held]] for line in lines]
    return table(["", "what", "required", "measured", ""], rows)


def as_json(about: dict[str, Any], lines: list[Line]) -> dict[str, Any]:
    """All that was measured of a part."""
    return about | {"lines": [asdict(line) for line in lines]}


def write_part(folder: Path, part: str, measured: dict[str, Any]) -> None:
    """Write stress.json and stress.md anew, with this part in place of what was there of it; the others stay."""
    path = folder / "stress.json"
    parts = json.loads(path.read_text(encoding="utf-8"))["parts"] if path.exists() else {}
    parts[part] = measured
    path.write_text(json.dumps({"parts": parts}, indent=1) + "\n", encoding="utf-8")
    (folder / "stress.md").write_text(as_markdown(parts), encoding="utf-8")


def as_markdown(parts: dict[str, dict[str, Any]]) -> str:
    """The whole page."""
    lines = [Line(**line) for part in parts.values() for line in part["lines"]]
    page = ["# The service under load and through faults\n"]
    page += ["Clients and server on the same cores, over the loopback interface.\n"]
    page += [as_table(sorted(lines, key=lambda line: line.number)), "## When, how and on what\n"]
    return "\n".join([*page, *(_about(name, part) for name, part in parts.items())])


def _about(name: str, part: dict[str, Any]) -> str:
    machine, versions = part["machine"], part["versions"]
    numbers = ", ".join(map(str, sorted({line["number"] for line in part["lines"]})))
    return (
        f"**{name}** ({numbers}): {part['measured_at']}, `{part['command']}`, {part['duration_s']:.0f} s. "
        f"{machine['processor']}, {machine['cores']} cores, {machine['memory_gb']} GB; {machine['os']}. "
        f"{', '.join(f'{package} {number}' for package, number in versions.items())}.\n"
    )
