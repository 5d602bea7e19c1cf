"""`ricochet trajectory` and `ricochet cra`: one case, computed locally or by a service."""

import argparse
import csv
import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from service.cli.arguments import (
    ATTACK,
    BODY,
    IMPACT,
    VELOCITY,
    Flag,
    add_case,
    add_formats,
    add_plot,
    add_url,
    examples,
)
from service.cli.errors import CommandError, RefusedError
from service.cli.request_body import RequestBody, read_body
from service.cli.writers import heading, print_table, print_values, print_warnings

TRAJECTORY_FLAGS = (*IMPACT, *BODY)
CRA_FLAGS = (VELOCITY, *ATTACK, *BODY)
OPERATIONS = {"trajectory": "TRAJECTORY", "cra": "CRITICAL_ANGLE"}
"""Name of each operation in its module of `service.routes`."""


def add_trajectory(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet trajectory`."""
    parser.description = (
        "Compute the motion of a projectile from first contact until it ricochets, comes to rest, or reaches the "
        "termination time."
    )
    parser.epilog = examples(
        "ricochet trajectory strike.toml --angle 45",
        "ricochet trajectory strike.toml --velocity 300 --angle 55 --csv",
    )
    add_case(parser, TRAJECTORY_FLAGS)
    add_formats(parser, json="print the answer as the service sends it", csv="print the time history")
    add_plot(parser, "the projectile from the side at several instants")
    add_url(parser)
    parser.set_defaults(run=run_trajectory)


def add_cra(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet cra`."""
    parser.description = (
        "Find the smallest oblique angle, from the inward normal of the face, at which a projectile ricochets. If "
        "there is none in the range, the status of the answer says so."
    )
    parser.epilog = examples(
        "ricochet cra strike.toml",
        "ricochet cra strike.toml --velocity 300 --set search.tolerance_deg=0.1 --json",
    )
    add_case(parser, CRA_FLAGS)
    add_formats(parser, json="print the answer as the service sends it", csv="print the trial angles")
    add_plot(parser, "the trial angles and the critical angle")
    add_url(parser)
    parser.set_defaults(run=run_cra)


def run_trajectory(args: argparse.Namespace) -> int:
    """Compute a trajectory and print it."""
    body, text = answer_one("trajectory", args, TRAJECTORY_FLAGS)
    answer: dict[str, Any] = json.loads(text)
    if args.plot:
        from service.cli.plots import plot_motion

        plot_motion(args.plot, body.content, answer, history_of(answer))
    if args.json:
        print_json(text)
    elif args.csv:
        print_csv(history_of(answer))
    else:
        print_motion(answer)
    return 0


def run_cra(args: argparse.Namespace) -> int:
    """Search a critical angle and print it."""
    _, text = answer_one("cra", args, CRA_FLAGS)
    answer: dict[str, Any] = json.loads(text)
    if args.plot:
        from service.cli.plots import plot_search

        plot_search(args.plot, answer)
    if args.json:
        print_json(text)
    elif args.csv:
        trials = answer["iterations"]
        print_csv({name: [trial[name] for trial in trials] for name in trials[0]})
    else:
        print_search(answer)
    return 0


def answer_one(operation: str, args: argparse.Namespace, flags: Sequence[Flag]) -> tuple[RequestBody, bytes]:
    """Return the request body and the answer as JSON.

    Raises
    ------
    CommandError
        If there is no answer; it names the flag or the field of the file that is invalid.
    """
    body = read_body(args.case, args, flags)
    if args.plot:
        from service.cli.plots import check_plot

        check_plot(args.plot)
    try:
        if args.url:
            from service.cli.client import connect

            with connect(args.url) as client:
                return body, client.compute(operation, body.content)
        return body, compute_locally(operation, body.content)
    except RefusedError as error:
        raise body.explain(error) from None


def compute_locally(name: str, body: dict[str, Any]) -> bytes:
    """Return the answer that a service would send, computed in this process.

    Raises
    ------
    RefusedError
        If the request is invalid, or the computation fails.
    """
    from importlib import import_module

    from pydantic import ValidationError

    from service.engine import Operation, name_request
    from service.keys import SCHEMA_VERSION
    from service.kinds import INVALID, content, problem_of
    from service.results.record import Record
    from service.schemas.pointers import pointer_of_location
    from solver import ENGINE_VERSION, RicochetError

    operation: Operation = getattr(import_module(f"service.routes.{name}"), OPERATIONS[name])
    try:
        request = operation.parse(json.dumps(body).encode())
        key, canonical = name_request(name, request)
        function, arguments = operation.call(request)
        answer, history = operation.answer(request, function(*arguments))
    except ValidationError as error:
        errors = [{"pointer": pointer_of_location(each["loc"]), "detail": each["msg"]} for each in error.errors()]
        raise RefusedError(content(INVALID, "", errors)) from None
    except RicochetError as error:
        raise RefusedError(problem_of(error)) from None
    return Record(key, name, canonical, answer, history, ENGINE_VERSION, SCHEMA_VERSION).json


def history_of(answer: Mapping[str, Any]) -> Mapping[str, Sequence[float]]:
    """Return the columns of a time history.

    Raises
    ------
    CommandError
        If the request excludes the history.
    """
    if "history" not in answer:
        raise CommandError("there is no history: output.history is false in this case")
    history: Mapping[str, Sequence[float]] = answer["history"]
    return history


def print_json(answer: bytes) -> None:
    """Print an answer as received, on one line."""
    sys.stdout.buffer.write(answer + b"\n")
    sys.stdout.buffer.flush()


def print_csv(columns: Mapping[str, Sequence[Any]]) -> None:
    """Print columns of equal length."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))


def print_motion(answer: Mapping[str, Any]) -> None:
    """Print the end of a motion."""
    final = {heading(name): value for name, value in answer["final"].items()}
    values = {"outcome": answer["outcome"], heading("maximum_depth_m"): answer["maximum_depth_m"]}
    print_values(values | {f"final {name}": value for name, value in final.items()})
    print_warnings(answer["warnings"])


def print_search(answer: Mapping[str, Any]) -> None:
    """Print the trial angles of a search and its result."""
    columns = ("oblique_angle_deg", "final_position_m", "outcome")
    rows = [[trial[name] for name in columns] for trial in answer["iterations"]]
    print_table([heading(name) for name in columns], rows)
    found = {"status": answer["status"]}
    for name in ("critical_angle_deg", "critical_angle_standard_error_deg"):
        if name in answer:
            found[heading(name)] = answer[name]
    if "bracket_deg" in answer:
        found[heading("bracket_deg")] = " to ".join(f"{angle:.5g}" for angle in answer["bracket_deg"])
    if answer["other_crossings_deg"]:
        found[heading("other_crossings_deg")] = ", ".join(f"{angle:.5g}" for angle in answer["other_crossings_deg"])
    print()
    print_values(found)
    print_warnings(answer["warnings"])
