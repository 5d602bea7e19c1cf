"""`ricochet formulas`: the empirical formulas of the field for one strike."""

import argparse
import json
from collections.abc import Mapping
from typing import Any

from service.cli.arguments import BODY, IMPACT, add_case, add_formats, add_url, examples
from service.cli.request_body import read_body
from service.cli.single import answer_of, print_csv, print_json
from service.cli.writers import heading, print_table, print_values, print_warnings

FLAGS = (*IMPACT, *BODY)
PARTS = {"projectile", "target", "impact"}
LIMITS = ("penetration_depth_m", "scabbing_thickness_m", "perforation_thickness_m")


def add_formulas(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet formulas`."""
    parser.description = (
        "Evaluate the empirical formulas of the field: how deep a projectile goes into thick concrete, and the least "
        "thickness of a wall that does not scab, and that is not perforated. Each formula says whether the strike is "
        "in the range it was fitted to. The formulas have no angle: as is common practice, an oblique strike "
        "counts with the component of its velocity along the normal. "
        "Other parts of a file than projectile, target and impact are left out."
    )
    parser.epilog = examples("ricochet formulas strike.toml", "ricochet formulas strike.toml --velocity 60 --csv")
    add_case(parser, FLAGS)
    add_formats(parser, json="print the answer as the service sends it", csv="print the table")
    add_url(parser)
    parser.set_defaults(run=run_formulas)


def run_formulas(args: argparse.Namespace) -> int:
    """Evaluate and print."""
    body = read_body(args.case, args, FLAGS)
    for name in body.content.keys() - PARTS:
        del body.content[name]
    text = answer_of("formulas", body, args.url)
    answer: dict[str, Any] = json.loads(text)
    if args.json:
        print_json(text)
    elif args.csv:
        from service.cache.tables import formula_columns

        print_csv(formula_columns(answer))
    else:
        print_formulas(answer)
    return 0


def print_formulas(answer: Mapping[str, Any]) -> None:
    """Print the table, what is out of range, and how far those in range differ."""
    rows = [
        [row["formula"], *(row.get(name, "") for name in LIMITS), _marks(row), row["source"]]
        for row in answer["formulas"]
    ]
    print_table(["formula", *map(heading, LIMITS), "", "source"], rows)
    print()
    for row in answer["formulas"]:
        for each in row["out_of_range"]:
            print(f"* {row['formula']}: {each['pointer']}: {each['detail']}")
    print("? the range of the formula is not known: it is left out of the figures below")
    print("+ constants from secondary sources, not compared with an original\n")
    values = {}
    for name in ("penetration_depth", "scabbing_thickness", "perforation_thickness"):
        if spread := answer.get(f"{name}_spread"):
            label = f"{name.replace('_', ' ')}, {spread['formulas']} in range m"
            values[label] = f"{spread['lowest']:.4g} to {spread['highest']:.4g}"
    margins = f"{answer['scabbing_margin']:g} on scabbing, {answer['perforation_margin']:g} on perforation"
    print_values(values | {"margins of a design, DOE-STD-3014-2006": margins, "nose class": answer["nose_class"]})
    print_warnings(answer["warnings"])


def _marks(row: Mapping[str, Any]) -> str:
    marks = (("*", row["out_of_range"]), ("?", not row["range_known"]), ("+", not row["verified"]))
    return "".join(mark for mark, holds in marks if holds)
