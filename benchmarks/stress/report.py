"""stress.md and stress.json, and the table that is printed."""

from typing import Any

from benchmarks.stress.lines import Line
from benchmarks.tables import table

HELD = {True: "held", False: "**not held**", None: "not measured"}


def as_table(lines: list[Line]) -> str:
    """What is required, and what was measured, as a Markdown table."""
    rows = [[str(line.number), line.what, line.required, line.measured, HELD[line.held]] for line in lines]
    return table(["", "what", "required", "measured", ""], rows)


def as_json(about: dict[str, Any], lines: list[Line]) -> dict[str, Any]:
    """All that was measured."""
    names = ("number", "what", "required", "measured", "held", "details")
    return about | {"lines": [{name: getattr(line, name) for name in names} for line in lines]}


def as_markdown(about: dict[str, Any], lines: list[Line]) -> str:
    """The whole page."""
    machine, versions = about["machine"], about["versions"]
    return "\n".join(
        [
            "# The service under load and through faults\n",
            f"{machine['processor']}, {machine['cores']} cores, {machine['memory_gb']} GB; {machine['os']}.",
            ", ".join(f"{name} {number}" for name, number in versions.items()) + ".",
            f"Measured on {about['measured_at']} by `{about['command']}` in {about['duration_s']:.0f} s, clients and",
            "server on the same cores, over the loopback interface.\n",
            as_table(lines),
        ]
    )
