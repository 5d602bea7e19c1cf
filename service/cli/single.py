"""`ricochet trajectory` and `ricochet cra`: compute one case locally or through a service."""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from service.cli.arguments import (
    STRIKE,
    CommandError,
    RefusedError,
    add_alternatives,
    add_case,
    add_url,
    add_verbose,
    examples,
)
from service.cli.outputs import add_formats, add_plot, sentence_number
from service.cli.request_body import RequestBody, read_body
from service.cli.writers import heading, print_csv, print_table, print_values, print_warnings, progress
from service.columns import trial_columns
from service.names import CHOICES, OUTCOMES, STATUSES, named

ENDS = {"outcome": OUTCOMES, "status": STATUSES}
"""Display names of outcomes and statuses, by field."""


def add_trajectory(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet trajectory`."""
    parser.description = (
        "Compute the motion of a projectile from first contact until it ricochets, comes to rest, or reaches the "
        "termination time."
    )
    parser.epilog = examples(
        "ricochet trajectory strike.toml --angle 45",
        "ricochet trajectory strike.toml --velocity 300 --angle 55 --csv",
    )
    add_case(parser, STRIKE)
    add_formats(parser, json="print the answer as the service sends it", csv="print the time history")
    add_verbose(parser, "print the warnings in full, with the standing notes")
    add_plot(parser, "the projectile from the side at several instants")
    add_alternatives(parser)
    add_url(parser)
    parser.set_defaults(run=run_trajectory)


def add_cra(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet cra`."""
    parser.description = (
        "Find the smallest oblique angle, from the inward normal of the face, at which a projectile ricochets, with "
        "its 90 % range under the usual scatter; with --angle, judge the strike at that angle too. The answer is one "
        "line, which also says if there is no such angle in the range."
    )
    parser.epilog = examples(
        "ricochet cra strike.toml",
        "ricochet cra strike.toml -v",
        "ricochet cra strike.toml --velocity 300 --set search.tolerance_deg=0.1 --json",
    )
    add_case(parser, STRIKE)
    add_formats(parser, json="print the answer as the service sends it", csv="print the trial angles")
    add_verbose(
        parser, "also print the trial angles and further numbers, and the warnings in full with the standing notes"
    )
    add_plot(parser, "the trial angles and the critical angle")
    add_alternatives(parser)
    add_url(parser)
    parser.set_defaults(run=run_cra)


def add_operation_command(commands: Any, name: str) -> argparse.ArgumentParser | None:
    """Add a command for an operation that has batches but no command of its own, and return its parser.

    For any other name, return None.
    """
    from service.operations import OPERATIONS

    if name not in OPERATIONS or OPERATIONS[name].many is None:
        return None
    parser: argparse.ArgumentParser = commands.add_parser(name)
    parser.description = OPERATIONS[name].description
    add_case(parser, ())
    add_url(parser)
    parser.set_defaults(run=run_operation)
    return parser


def run_operation(args: argparse.Namespace) -> int:
    """Compute an operation, and print the answer as the service sends it."""
    print_json(answer_of(args.command, read_body(args.case, args, ()), args.url))
    return 0


def run_trajectory(args: argparse.Namespace) -> int:
    """Compute a trajectory, and print it."""
    body, text = answer_one("trajectory", args)
    answer: dict[str, Any] = json.loads(text)
    if args.plot:
        from service.cli.plots import plot_motion

        plot_motion(args.plot, body.content, answer, history_of(answer))
    if args.json:
        print_json(text)
    elif args.csv:
        print_csv(alternatives_of(answer) if args.alternatives else history_of(answer), args.digits)
    else:
        print(motion_sentence(answer, body.value_at("/impact/oblique_angle_deg")), end="\n\n")
        print_motion(answer, verbose=args.verbose)
    return 0


def run_cra(args: argparse.Namespace) -> int:
    """Find a critical angle, and print it with its verdict."""
    body, text = answer_one("cra", args)
    answer: dict[str, Any] = json.loads(text)
    if args.plot:
        from service.cli.plots import plot_search

        plot_search(args.plot, answer)
    if args.json:
        print_json(text)
    elif args.csv:
        print_csv(alternatives_of(answer) if args.alternatives else trial_columns(answer), args.digits)
    else:
        announce(answer)
        verdict = verdict_on(body, answer, args.url)
        print_search(answer, verdict, verbose=args.verbose, shots=shots_sentence(body, answer))
    return 0


def announce(answer: Mapping[str, Any]) -> None:
    """Print the critical angle on a terminal before its range is sampled, which takes seconds."""
    # A script that reads the output needs no preview, and must not receive the angle twice.
    if sys.stdout.isatty() and sys.stderr.isatty() and "critical_angle_deg" in answer:
        print(f"Critical angle {answer['critical_angle_deg']:.2f}°; its range follows", file=sys.stderr)


def answer_one(operation: str, args: argparse.Namespace) -> tuple[RequestBody, bytes]:
    """Compute the case given by the arguments; return its request body, and the answer as JSON.

    Raises
    ------
    CommandError
        If the request is refused or fails. The message names the invalid flag or field of the file.
    """
    body = read_body(args.case, args, STRIKE)
    if args.alternatives:
        body.content["alternatives"] = True
    if args.plot:
        from service.cli.plots import check_plot

        check_plot()
    return body, answer_of(operation, of_search(body) if operation == "cra" else body, args.url)


def of_search(body: RequestBody) -> RequestBody:
    """Return the request body of a search, without the oblique angle and the flight, which only the verdict uses."""
    content = {name: value for name, value in body.content.items() if name != "flight"}
    impact = content.get("impact")
    if isinstance(impact, dict):
        content["impact"] = {name: value for name, value in impact.items() if name != "oblique_angle_deg"}
    return replace(body, content=content)


def answer_of(operation: str, body: RequestBody, url: str | None) -> bytes:
    """Return the answer as JSON, from the service at `url` or computed in this process.

    Raises
    ------
    CommandError
        If the request is refused or fails. The message names the invalid flag or field of the file.
    """
    try:
        if url:
            from service.cli.client import connect

            with connect(url) as client:
                return client.compute(operation, body.content)
        from service.cli.local import compute

        return compute(operation, body.content)
    except RefusedError as error:
        raise body.explain(error) from None


def history_of(answer: Mapping[str, Any]) -> Mapping[str, Sequence[float]]:
    """Return the columns of the time history in an answer.

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
    # Bytes are written, as JSON is UTF-8 whatever the encoding of the terminal.
    sys.stdout.buffer.write(answer + b"\n")
    sys.stdout.buffer.flush()


def motion_sentence(answer: Mapping[str, Any], oblique_angle: float) -> str:
    """Return a sentence with the outcome of a strike; `oblique_angle` is in degrees."""
    after = f"after {sentence_number(1e3 * answer['final']['time_s'], 3)} ms"
    if (left := answer.get("exit")) is None:
        end = f"{sentence_number(1e3 * answer['maximum_depth_m'], 3)} mm deep {after}"
    else:
        end = f"it leaves at {sentence_number(left['speed_m_s'], 3)} m/s {after}"
    if answer["outcome"] == "embedded" and (out := answer.get("protrusion", {}).get("final_m")):
        end = f"its nose {sentence_number(round(1e3 * out, 1))} mm out of the rear face, {end}"
    sentence = f"At {oblique_angle:g}° from the normal: {named(OUTCOMES, answer['outcome'])}, {end}."
    if left is None or "flight" not in left:
        return sentence
    from solver.flight import landing_sentence

    distances = (left["flight"][name] for name in ("range_m", "farthest_range_m", "range_without_drag_m"))
    return f"{sentence} {landing_sentence(*distances)}"


def print_motion(answer: Mapping[str, Any], *, verbose: bool) -> None:
    """Print the outcome and the final state of a motion."""
    final = {heading(name): value for name, value in answer["final"].items()}
    values = {"outcome": named(OUTCOMES, answer["outcome"])}
    values |= {heading(name): answer[name] for name in ("maximum_depth_m", "strength_factor") if name in answer}
    values |= {f"protrusion {heading(name)}": length for name, length in answer.get("protrusion", {}).items()}
    bending = answer.get("bending", {})
    values |= {f"bending {heading(name)}": bending[name] for name in bending if name != "history"}
    print_values(values | {f"final {name}": value for name, value in final.items()})
    print_alternatives(answer)
    print_warnings(answer["warnings"], verbose=verbose)


def print_search(answer: Mapping[str, Any], verdict: Mapping[str, Any], *, verbose: bool, shots: str) -> None:
    """Print the verdict, the effect of the user's own shots if any, and with `verbose` the trials and numbers."""
    if verbose:
        columns = ("oblique_angle_deg", "final_position_m", "outcome")
        rows = [
            [trial["oblique_angle_deg"], trial["final_position_m"], named(OUTCOMES, trial["outcome"])]
            for trial in answer["iterations"]
        ]
        print_table([heading(name) for name in columns], rows)
        print()
    print(verdict["sentence"])
    if shots:
        print(shots)
    if verbose:
        found = {"status": named(STATUSES, answer["status"])}
        for name in ("critical_angle_deg", "critical_angle_standard_error_deg"):
            if name in answer:
                found[heading(name)] = answer[name]
        if "bracket_deg" in answer:
            found[heading("bracket_deg")] = " to ".join(f"{angle:.5g}" for angle in answer["bracket_deg"])
        if "strength_factor" in answer:
            found[heading("strength_factor")] = answer["strength_factor"]
        print()
        print_values(found)
    print_alternatives(answer)
    print_warnings(verdict["warnings"], verbose=verbose)


def shots_sentence(body: RequestBody, answer: Mapping[str, Any]) -> str:
    """Return a sentence on the effect of the user's own shots on S; empty without shots or without an angle."""
    if "own_tests" not in answer or body.value_at("/resistance/strength_factor/model") != "own_tests":
        return ""
    tests = answer["own_tests"]
    after, before = (
        f"{tests[f'{prior}median']:.3g}, dispersion {tests[f'{prior}dispersion']:.2g}" for prior in ("", "prior_")
    )
    shots = "1 shot" if tests["shots"] == 1 else f"{tests['shots']} shots"
    return (
        f"Strength factor S at normal impact with {shots}: median {after}; without, by the published tests: {before}."
    )


def verdict_on(body: RequestBody, answer: Mapping[str, Any], url: str | None) -> dict[str, Any]:
    """Return the verdict on a strike, from the service at `url` or computed in this process.

    Raises
    ------
    CommandError
        If the request is refused or fails. The message names the invalid flag or field of the file.
    """
    if url:
        found: dict[str, Any] = json.loads(answer_of("verdict", body, url))
        return found
    from service.cli.local import judge
    from solver.uncertainty.verdict import SAMPLES

    try:
        with progress("sampling" if "critical_angle_deg" not in answer else "sampling its range") as report:
            return judge(body.content, lambda samples, _: report(samples, SAMPLES))
    except RefusedError as error:
        raise body.explain(error) from None


def print_alternatives(answer: Mapping[str, Any]) -> None:
    """Print the results with other laws, if there are any."""
    if "alternatives" in answer:
        columns = dict(alternatives_of(answer))
        # `none` is not a theory of the decay, so its angle is left out of the range.
        theories = [each for each in answer["alternatives"] if each["free_surface"] != "none"]
        angles = [each["critical_angle_deg"] for each in theories if "critical_angle_deg" in each]
        print()
        if angles:
            print(f"With either decay and every law of S: {min(angles):.2f}° to {max(angles):.2f}°")
        laws = {name: CHOICES[f"resistance.{name}.model"] for name in ("free_surface", "strength_factor")}
        laws["obliquity_shape"] = CHOICES["resistance.strength_factor.obliquity_shape"]
        columns |= {name: [named(names, law) for law in columns[name]] for name, names in laws.items()}
        columns |= {name: [named(ENDS[name], end) for end in columns[name]] for name in ENDS.keys() & columns.keys()}
        print_table([heading(name) for name in columns], list(zip(*columns.values(), strict=True)))


def alternatives_of(answer: Mapping[str, Any]) -> Mapping[str, Sequence[Any]]:
    """Return the columns of the table of results with other laws; missing values are empty cells."""
    alternatives = answer["alternatives"]
    found = ("status", "critical_angle_deg") if "status" in answer else ("outcome",)
    names = ("free_surface", "strength_factor", "obliquity_shape", *found)
    columns = {name: [each.get(name, "") for each in alternatives] for name in names}
    if any("problem" in each for each in alternatives):
        columns["problem"] = [each.get("problem", {}).get("detail", "") for each in alternatives]
    return columns | {"fitted_to": [each["fitted_to"] for each in alternatives]}
