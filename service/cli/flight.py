"""`ricochet flight`: compute where a body lands after it leaves a face."""

import argparse
import json

from service.cli.arguments import Flag, add_numbers, add_url, examples
from service.cli.outputs import add_formats
from service.cli.request_body import RequestBody
from service.cli.single import answer_of, print_json
from service.cli.writers import heading, print_csv, print_values

FLAGS = (
    Flag("--speed", ("speed_m_s",), "speed at launch [m/s]"),
    Flag("--elevation", ("elevation_deg",), "elevation of the launch above the horizontal [°]"),
    Flag("--mass", ("mass_kg",), "mass [kg]"),
    Flag("--area", ("projected_area_m2",), "projected area: a quarter of the surface of a body that tumbles [m²]"),
    Flag("--drag-coefficient", ("drag_coefficient",), "drag coefficient [1] (default: 1)"),
    Flag("--height", ("height_m",), "height of the launch above level ground [m] (default: 0)"),
)


def add_flight(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet flight`."""
    parser.description = (
        "Compute where a body lands after it leaves a face with a given speed and elevation, as a point mass with "
        "quadratic drag. The direction in which a tumbling body leaves is the least certain input, so the farthest "
        "distance at any elevation is printed too."
    )
    parser.epilog = examples("ricochet flight --speed 101.1 --elevation 19.18 --mass 13 --area 0.0321")
    add_numbers(parser, FLAGS)
    add_formats(parser, json="print the answer as the service sends it", csv="print the values as one row")
    add_url(parser)
    parser.set_defaults(run=run_flight)


def run_flight(args: argparse.Namespace) -> int:
    """Compute a flight, and print it."""
    given = {flag: getattr(args, flag.steps[0]) for flag in FLAGS}
    known = {flag: value for flag, value in given.items() if value is not None}
    body = RequestBody(
        {flag.steps[0]: value for flag, value in known.items()},
        None,
        {flag.pointer: flag for flag in FLAGS},
        {flag.pointer: flag.name for flag in known},
    )
    text = answer_of("flight", body, args.url)
    answer = {name: value for name, value in json.loads(text).items() if name not in {"key", "engine_version"}}
    if args.json:
        print_json(text)
    elif args.csv:
        print_csv({name: [value] for name, value in answer.items()}, args.digits)
    else:
        from solver.flight import landing_sentence

        print(
            landing_sentence(answer["range_m"], answer["farthest_range_m"], answer["range_without_drag_m"]), end="\n\n"
        )
        print_values({heading(name): value for name, value in answer.items()})
    return 0
