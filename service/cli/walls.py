"""`ricochet thickness` and `ricochet limit-speed`: the wall that stops a projectile, the speed that perforates one."""

import argparse
import json
from collections.abc import Mapping
from typing import Any

from service.cli.arguments import (
    ATTACK,
    BODY,
    IMPACT,
    OBLIQUE_ANGLE,
    RESISTANCE,
    add_case,
    add_formats,
    add_url,
    examples,
)
from service.cli.request_body import SOUGHT, read_body, without_sought
from service.cli.single import answer_of, print_csv, print_json
from service.cli.writers import heading, print_table, print_values, print_warnings

STRIKE_FLAGS = (*IMPACT, *(flag for flag in BODY if flag.steps != SOUGHT["thickness"]), *RESISTANCE)
WALL_FLAGS = (OBLIQUE_ANGLE, *ATTACK, *BODY, *RESISTANCE)
FORMULA_VALUES = {"least_thickness_m": "perforation_thickness_m", "limit_speed_m_s": "limit_speed_m_s"}
"""What formulas give for what was sought."""


def add_thickness(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet thickness`."""
    parser.description = (
        "Find the least thickness of a wall that a strike does not perforate, beside what the empirical formulas of "
        "the field say, which take the component of the velocity along the normal. A thickness in the file is left "
        "out, and so are other parts than projectile, target, impact, resistance and numerics."
    )
    parser.epilog = examples(
        "ricochet thickness strike.toml --angle 30", "ricochet thickness strike.toml --angle 0 --json"
    )
    add_case(parser, STRIKE_FLAGS)
    add_formats(parser, json="print the answer as the service sends it", csv="print the thicknesses tried")
    add_url(parser)
    parser.set_defaults(run=run_thickness)


def add_limit_speed(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet limit-speed`."""
    parser.description = (
        "Find the least speed at which a projectile perforates a wall, beside that of CEA and EDF's formula. A speed "
        "in the file is left out, and so are other parts than projectile, target, impact, resistance and numerics."
    )
    parser.epilog = examples("ricochet limit-speed strike.toml --thickness 0.2 --angle 20")
    add_case(parser, WALL_FLAGS)
    add_formats(parser, json="print the answer as the service sends it", csv="print the speeds tried")
    add_url(parser)
    parser.set_defaults(run=run_limit_speed)


def run_thickness(args: argparse.Namespace) -> int:
    """Search the least thickness and print it."""
    body = without_sought(read_body(args.case, args, STRIKE_FLAGS), "thickness")
    return _print(args, answer_of("thickness", body, args.url), "least_thickness_m", "bracket_m")


def run_limit_speed(args: argparse.Namespace) -> int:
    """Search the limit speed and print it."""
    body = without_sought(read_body(args.case, args, WALL_FLAGS), "limit-speed")
    return _print(args, answer_of("limit-speed", body, args.url), "limit_speed_m_s", "bracket_m_s")


def _print(args: argparse.Namespace, text: bytes, value: str, bracket: str) -> int:
    answer: dict[str, Any] = json.loads(text)
    trials = answer["iterations"]
    names = [name for name in trials[0] if name != "exit"]
    columns = {name: [trial[name] for trial in trials] for name in names}
    columns["exit_speed_m_s"] = [trial.get("exit", {}).get("speed_m_s", "") for trial in trials]
    if args.json:
        print_json(text)
    elif args.csv:
        print_csv(columns)
    else:
        print_table([heading(name) for name in columns], list(zip(*columns.values(), strict=True)))
        print()
        print_values(_found(answer, value, bracket))
        if rows := answer.get("formulas"):
            print()
            name = FORMULA_VALUES[value]
            print_table(["formula", heading(name), "range"], [[row["formula"], row[name], _range(row)] for row in rows])
        print_warnings(answer["warnings"])
    return 0


def _found(answer: Mapping[str, Any], value: str, bracket: str) -> dict[str, Any]:
    found = {"status": answer["status"]}
    if value in answer:
        lower, upper = answer[bracket]
        found |= {heading(value): answer[value], heading(bracket): f"{lower:.6g} to {upper:.6g}"}
    return found


def _range(row: Mapping[str, Any]) -> str:
    if row["in_range"]:
        return "in range"
    return "out of range" if row["range_known"] else "range not known"
