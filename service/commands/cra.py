"""`ricochet cra`: the critical ricochet angle of one strike."""

import argparse

from service.commands.flags import ATTACK, BODY, VELOCITY, add_alternatives, add_case, add_forms, add_plot, add_url
from service.commands.parsers import examples
from service.commands.single import alternatives_of, answer_one, loads, print_csv, print_json, print_search

FLAGS = (VELOCITY, *ATTACK, *BODY)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its flags."""
    parser.description = (
        "Find the smallest oblique angle, from the normal of the face, at which a projectile is turned away. That "
        "there is none in the range is an answer too."
    )
    parser.epilog = examples(
        "ricochet cra strike.toml",
        "ricochet cra strike.toml --velocity 300 --set search.tolerance_deg=0.1 --json",
    )
    add_case(parser, FLAGS)
    add_forms(parser, json="print the answer as the service gives it", csv="print the angles that were tried")
    add_plot(parser, "the angles that were tried, and what was found")
    add_alternatives(parser)
    add_url(parser)


def run(asked: argparse.Namespace) -> int:
    """Find it and print it."""
    _, text = answer_one("cra", asked, FLAGS)
    answer = loads(text)
    if asked.plot:
        from service.commands.pictures import draw_search

        draw_search(asked.plot, answer)
    if asked.json:
        print_json(text)
    elif asked.csv and asked.alternatives:
        print_csv(alternatives_of(answer))
    elif asked.csv:
        trials = answer["iterations"]
        print_csv({name: [trial[name] for trial in trials] for name in trials[0]})
    else:
        print_search(answer)
    return 0
