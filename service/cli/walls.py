"""`ricochet thickness`, `limit-speed` and `formulas`: walls that stop a projectile, and speeds that perforate a wall.

`formulas` evaluates the empirical formulas for the thickness of a wall and for the depth in thick concrete.
"""

import argparse
import copy
import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from service.cli.arguments import (
    ATTACK,
    BODY,
    IMPACT,
    OBLIQUE_ANGLE,
    RESISTANCE,
    add_case,
    add_url,
    add_verbose,
    examples,
)
from service.cli.outputs import add_formats
from service.cli.request_body import SOUGHT, WALL_PARTS, read_body, without_sought
from service.cli.single import answer_of, print_json
from service.cli.writers import heading, print_csv, print_table, print_values, print_warnings
from service.columns import trial_columns
from service.names import FORMULAS, OUTCOMES, QUANTITIES, STATUSES, named

STRIKE_FLAGS = (*IMPACT, *(flag for flag in BODY if flag.steps != SOUGHT["thickness"]), *RESISTANCE)
WALL_FLAGS = (OBLIQUE_ANGLE, *ATTACK, *BODY, *RESISTANCE)
FORMULA_VALUES = {"least_thickness_m": "perforation_thickness_m", "limit_speed_m_s": "limit_speed_m_s"}
"""Field of the formulas that corresponds to the result of a search, by the field of the result."""
BRACKETS = {"least_thickness_m": "bracket_m", "limit_speed_m_s": "bracket_m_s"}
"""Field of the bracket, by the field of the result."""


def add_thickness(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet thickness`."""
    parser.description = (
        "Find how thick a wall must be: design values against perforation and scabbing by the empirical formulas, "
        "which use the component of the velocity along the normal, and by the model the least thickness that the "
        "strike does not perforate. A thickness in the file is judged as well. Everything in the file but projectile, "
        "target, impact, resistance and numerics is ignored."
    )
    parser.epilog = examples(
        "ricochet thickness strike.toml --angle 30", "ricochet thickness strike.toml --angle 0 --json"
    )
    add_case(parser, STRIKE_FLAGS)
    add_formats(parser, json="print the answer as the service sends it", csv="print the thicknesses tried")
    add_verbose(parser, "also print the thicknesses tried and the numbers of the search, and the warnings in full")
    add_url(parser)
    parser.set_defaults(run=run_thickness)


def add_limit_speed(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet limit-speed`."""
    parser.description = (
        "Find the least speed at which a projectile perforates a wall, by the empirical formulas and by the model. A "
        "speed in the file is ignored, and so is everything but projectile, target, impact, resistance and numerics."
    )
    parser.epilog = examples("ricochet limit-speed strike.toml --thickness 0.2 --angle 20")
    add_case(parser, WALL_FLAGS)
    add_formats(parser, json="print the answer as the service sends it", csv="print the speeds tried")
    add_verbose(parser, "also print the speeds tried and the numbers of the search, and the warnings in full")
    add_url(parser)
    parser.set_defaults(run=run_limit_speed)


def run_thickness(args: argparse.Namespace) -> int:
    """Find the least thickness, and print it after the verdict on the target wall."""
    body = read_body(args.case, args, STRIKE_FLAGS)
    for name in body.content.keys() - WALL_PARTS:
        del body.content[name]
    said = []
    if not (args.json or args.csv):
        wall = replace(body, content=copy.deepcopy(body.content))  # A copy, as `without_sought` removes the thickness.
        said.append(json.loads(answer_of("wall", wall, args.url))["sentence"])
    text = answer_of("thickness", without_sought(body, "thickness"), args.url)
    return _print(args, text, "least_thickness_m", said)


def run_limit_speed(args: argparse.Namespace) -> int:
    """Find the limit speed, and print it."""
    body = without_sought(read_body(args.case, args, WALL_FLAGS), "limit-speed")
    return _print(args, answer_of("limit-speed", body, args.url), "limit_speed_m_s", [])


def _print(args: argparse.Namespace, text: bytes, value: str, said: list[str]) -> int:
    """Print an answer: its sentences, the formulas, and with `--verbose` the trials and the numbers of the search.

    Parameters
    ----------
    value
        Field with the result of the search.
    said
        Sentences to print before the sentence of the answer.
    """
    answer: dict[str, Any] = json.loads(text)
    columns = trial_columns(answer)
    columns["exit_speed_m_s"] = [trial.get("exit", {}).get("speed_m_s", "") for trial in answer["iterations"]]
    if args.json:
        print_json(text)
    elif args.csv:
        print_csv(columns, args.digits)
    else:
        print("\n".join([*said, *([answer["sentence"]] if "sentence" in answer else [])]))
        if rows := answer.get("formulas"):
            print()
            name = FORMULA_VALUES[value]
            found = [[named(FORMULAS, row["formula"]), row[name], _range(row)] for row in rows]
            print_table(["formula", heading(name), "range"], found)
        if args.verbose:
            print()
            columns["outcome"] = [named(OUTCOMES, outcome) for outcome in columns["outcome"]]
            print_table([heading(name) for name in columns], list(zip(*columns.values(), strict=True)))
            print()
            print_values(_found(answer, value))
        print_warnings(answer["warnings"], verbose=args.verbose)
    return 0


def _found(answer: Mapping[str, Any], value: str) -> dict[str, Any]:
    """Return the status, result and bracket of a search by name. They are for comparing models, not for design."""
    found: dict[str, Any] = {"status": named(STATUSES, answer["status"])}
    if value in answer:
        bracket = BRACKETS[value]
        lower, upper = answer[bracket]
        found |= {heading(value): answer[value], heading(bracket): f"{lower:.6g} to {upper:.6g}"}
    return found


def _range(row: Mapping[str, Any]) -> str:
    if row["in_range"]:
        return "in range"
    return "out of range" if row["range_known"] else "range not known"


FLAGS = (*IMPACT, *BODY)
PARTS = {"projectile", "target", "impact"}
LIMITS = ("penetration_depth_m", "scabbing_thickness_m", "perforation_thickness_m")


def add_formulas(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet formulas`."""
    parser.description = (
        "Evaluate the empirical formulas: the depth of penetration into thick concrete, and the least thickness of a "
        "wall that does not scab and of one that is not perforated. Each formula says whether the strike is in the "
        "range it was fitted to. The formulas have no angle: as is common practice, they use the component of the "
        "velocity along the normal. Everything in the file but projectile, target and impact is ignored."
    )
    parser.epilog = examples("ricochet formulas strike.toml", "ricochet formulas strike.toml --velocity 60 --csv")
    add_case(parser, FLAGS)
    add_formats(parser, json="print the answer as the service sends it", csv="print the table")
    add_verbose(parser, "print the warnings in full, with the standing notes")
    add_url(parser)
    parser.set_defaults(run=run_formulas)


def run_formulas(args: argparse.Namespace) -> int:
    """Evaluate the empirical formulas, and print them."""
    body = read_body(args.case, args, FLAGS)
    for name in body.content.keys() - PARTS:
        del body.content[name]
    text = answer_of("formulas", body, args.url)
    answer: dict[str, Any] = json.loads(text)
    if args.json:
        print_json(text)
    elif args.csv:
        from service.cache.tables import formula_columns

        print_csv(formula_columns(answer), args.digits)
    else:
        print_formulas(answer, verbose=args.verbose)
    return 0


def _named_input(pointer: str) -> str:
    """Return the display name of the input or result at a pointer."""
    field = pointer[1:].replace("/", ".")
    return (QUANTITIES.get(field) or heading(field)).lower()


def print_formulas(answer: Mapping[str, Any], *, verbose: bool) -> None:
    """Print the table of the formulas, and the spread of their values.

    Inputs outside the range of a formula are listed; such a formula is left out of the spread.
    """
    rows = [
        [named(FORMULAS, row["formula"]), *(row.get(name, "") for name in LIMITS), _marks(row), row["source"]]
        for row in answer["formulas"]
    ]
    print_table(["formula", *map(heading, LIMITS), "", "source"], rows)
    print()
    for row in answer["formulas"]:
        for each in row["out_of_range"]:
            print(f"* {named(FORMULAS, row['formula'])}: {_named_input(each['pointer'])}: {each['detail']}")
    for row in answer["formulas"]:
        if "note" in row:
            print(f"! {named(FORMULAS, row['formula'])}: {row['note']}")
    print("? the range of the formula is not known: it is left out of the figures below")
    print("+ constants from secondary sources, not compared with an original\n")
    values = {}
    for name in ("penetration_depth", "scabbing_thickness", "perforation_thickness"):
        if spread := answer.get(f"{name}_spread"):
            label = f"{name.replace('_', ' ')}, {spread['formulas']} in range m"
            values[label] = f"{spread['lowest']:.4g} to {spread['highest']:.4g}"
    margins = f"{answer['scabbing_margin']:g} on scabbing, {answer['perforation_margin']:g} on perforation"
    print_values(values | {"margins of a design, DOE-STD-3014-2006": margins, "nose class": answer["nose_class"]})
    print_warnings(answer["warnings"], verbose=verbose)


def _marks(row: Mapping[str, Any]) -> str:
    known, verified = row["range_known"], row["verified"]
    marks = (("*", row["out_of_range"]), ("?", not known), ("!", "note" in row), ("+", not verified))
    return "".join(mark for mark, holds in marks if holds)
