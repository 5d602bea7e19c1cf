"""One case: read, asked of a service or computed here, printed."""

import argparse
import csv
import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from service.commands.body import Body, read_body
from service.commands.errors import CommandError, RefusedError
from service.commands.flags import Flag
from service.commands.tables import heading, print_table, print_values, print_warnings


def answer_one(operation: str, asked: argparse.Namespace, flags: Sequence[Flag]) -> tuple[Body, bytes]:
    """Return the body of the request and the answer to it, as JSON.

    Raises
    ------
    CommandError
        If there is no answer, naming the flag or the place in the file that is to blame, if one is.
    """
    body = read_body(asked.case, asked, flags)
    if asked.alternatives:
        body.content["alternatives"] = True
    if asked.plot:
        from service.commands.pictures import check_picture

        check_picture(asked.plot)
    try:
        if asked.url:
            from service.commands.client import connect

            with connect(asked.url) as client:
                return body, client.compute(operation, body.content)
        from service.commands.alone import compute

        return body, compute(operation, body.content)
    except RefusedError as error:
        raise body.explained(error) from None


def print_json(answer: bytes) -> None:
    """Print an answer as it is sent, on one line."""
    sys.stdout.buffer.write(answer + b"\n")
    sys.stdout.buffer.flush()


def print_csv(columns: Mapping[str, Sequence[Any]]) -> None:
    """Print columns of equal length."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))


def print_motion(answer: Mapping[str, Any]) -> None:
    """Print how a strike ended."""
    final = {heading(name): value for name, value in answer["final"].items()}
    values = {"outcome": answer["outcome"]}
    values |= {heading(name): answer[name] for name in ("maximum_depth_m", "strength_factor")}
    print_values(values | {f"final {name}": value for name, value in final.items()})
    print_alternatives(answer)
    print_warnings(answer["warnings"])


def history_of(answer: Mapping[str, Any]) -> Mapping[str, Sequence[float]]:
    """Return the columns of a motion over time.

    Raises
    ------
    CommandError
        If the case asks for none.
    """
    if "history" not in answer:
        raise CommandError("there is no history: output.history is false in this case")
    history: Mapping[str, Sequence[float]] = answer["history"]
    return history


def print_search(answer: Mapping[str, Any]) -> None:
    """Print the angles that a search has tried, and what it has found."""
    columns = ("oblique_angle_deg", "final_position_m", "outcome")
    print_table(
        [heading(name) for name in columns], [[trial[name] for name in columns] for trial in answer["iterations"]]
    )
    found = {"status": answer["status"]}
    for name in ("critical_angle_deg", "critical_angle_standard_error_deg"):
        if name in answer:
            found[heading(name)] = answer[name]
    if "bracket_deg" in answer:
        found[heading("bracket_deg")] = " to ".join(f"{angle:.5g}" for angle in answer["bracket_deg"])
    if "strength_factor" in answer:
        found[heading("strength_factor")] = answer["strength_factor"]
    if angles := [
        each["critical_angle_deg"] for each in answer.get("alternatives", ()) if "critical_angle_deg" in each
    ]:
        found["under other laws °"] = f"{min(angles):.5g} to {max(angles):.5g}"
    if answer["other_crossings_deg"]:
        found[heading("other_crossings_deg")] = ", ".join(f"{angle:.5g}" for angle in answer["other_crossings_deg"])
    print()
    print_values(found)
    print_alternatives(answer)
    print_warnings(answer["warnings"])


def print_alternatives(answer: Mapping[str, Any]) -> None:
    """Print the answers under other laws, if there are any."""
    if "alternatives" in answer:
        columns = alternatives_of(answer)
        print()
        print_table([heading(name) for name in columns], list(zip(*columns.values(), strict=True)))


def alternatives_of(answer: Mapping[str, Any]) -> Mapping[str, Sequence[Any]]:
    """Return the answers under other laws as columns, empty where one has no value."""
    found = ("status", "critical_angle_deg") if "status" in answer else ("outcome",)
    columns = {
        name: [each.get(name, "") for each in answer["alternatives"]]
        for name in ("free_surface", "strength_factor", *found)
    }
    if any("problem" in each for each in answer["alternatives"]):
        columns["problem"] = [each.get("problem", {}).get("detail", "") for each in answer["alternatives"]]
    return columns | {"fitted_to": [each["fitted_to"] for each in answer["alternatives"]]}


def loads(answer: bytes) -> dict[str, Any]:
    """Return an answer as data."""
    content: dict[str, Any] = json.loads(answer)
    return content
