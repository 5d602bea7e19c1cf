"""`ricochet trajectory`: one strike, and how it goes."""

import argparse

from service.commands.flags import BODY, STRIKE, add_alternatives, add_case, add_forms, add_plot, add_url
from service.commands.parsers import examples
from service.commands.single import alternatives_of, answer_one, history_of, loads, print_csv, print_json, print_motion

FLAGS = (*STRIKE, *BODY)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its flags."""
    parser.description = (
        "Compute the motion of a projectile from first contact until it is turned away, at rest, or out of time."
    )
    parser.epilog = examples(
        "ricochet trajectory strike.toml --angle 45",
        "ricochet trajectory strike.toml --velocity 300 --angle 55 --csv",
    )
    add_case(parser, FLAGS)
    add_forms(parser, json="print the answer as the service gives it", csv="print the motion over time")
    add_plot(parser, "the projectile from the side, at instants of its motion")
    add_alternatives(parser)
    add_url(parser)


def run(asked: argparse.Namespace) -> int:
    """Compute it and print how it ended."""
    body, text = answer_one("trajectory", asked, FLAGS)
    answer = loads(text)
    if asked.plot:
        from service.commands.pictures import draw_motion

        draw_motion(asked.plot, body.content, answer, history_of(answer))
    if asked.json:
        print_json(text)
    elif asked.csv and asked.alternatives:
        print_csv(alternatives_of(answer))
    elif asked.csv:
        print_csv(history_of(answer))
    else:
        print_motion(answer)
    return 0
