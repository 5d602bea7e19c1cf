"""`ricochet sweep`: one case over ranges of its numbers."""

import argparse
from collections.abc import Sequence
from typing import Any, NamedTuple

from service.commands.body import Body, read_body
from service.commands.errors import CommandError, RefusedError, UsageError
from service.commands.flags import (
    BODY,
    STRIKE,
    add_case,
    add_data_dir,
    add_forms,
    add_operation,
    add_output,
    add_plot,
    add_url,
)
from service.commands.parsers import examples

FLAGS = (*STRIKE, *BODY)
MOST_DRAWN = 2
MOST_POINTS = 100_000
"""Of a sweep: the service takes no more."""


class Axis(NamedTuple):
    """A field, the values it takes, and how that was typed and is sent."""

    field: str
    values: list[float]
    text: str
    sent: dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its flags."""
    parser.description = (
        "Compute a case for every combination of the values of up to four of its numbers, the last axis fastest. What "
        "an axis sets may be missing in the case."
    )
    parser.epilog = examples(
        "ricochet sweep strike.toml --axis impact.velocity_m_s=200:300:3 --csv",
        "ricochet sweep strike.toml --axis impact.velocity_m_s=240,280 "
        "--axis target.compressive_strength_pa=30e6:40e6:2 --plot map.svg",
    )
    add_case(parser, FLAGS)
    parser.add_argument(
        "--axis",
        action="append",
        required=True,
        type=_axis,
        metavar="FIELD=VALUES",
        help="values with commas between them, or START:STOP:COUNT at even distances; given up to four times",
    )
    add_operation(parser)
    add_output(parser)
    add_forms(parser, json="give the results as JSON lines", csv="give the summaries as a table")
    add_plot(parser, "the angle, or the depth, over one axis or as a map over two")
    add_data_dir(parser)
    add_url(parser)


def run(asked: argparse.Namespace) -> int:
    """Have the points computed; return 3 if some have a problem."""
    from service.commands.client import JSON, encoded
    from service.commands.many import Work, compute_many
    from service.commands.sinks import Sink

    axes: list[Axis] = asked.axis
    body = read_body(asked.case, asked, FLAGS)
    content = encoded({"base": _filled(body.content, axes), "axes": [axis.sent for axis in axes]})
    values = {axis.field: axis.values for axis in axes}
    more: list[Sink] = []
    if asked.plot:
        from service.commands.pictures import Map, check_picture

        if len(axes) > MOST_DRAWN:
            raise UsageError(f"--plot draws over one axis or two, not {len(axes)}")
        check_picture(asked.plot)
        more = [Map(asked.plot, asked.operation, values)]
    work = Work(
        asked.operation, f"/{asked.operation}/sweep", lambda: content, JSON["Content-Type"], axes=values, more=more
    )
    try:
        return compute_many(asked, work)
    except RefusedError as error:
        raise _explained(error, body, axes) from None


def _axis(text: str) -> Axis:
    field, equals, range_ = text.partition("=")
    try:
        if not equals or not all(field.split(".")):
            raise ValueError(text)
        if ":" not in range_:
            values = [float(value) for value in range_.split(",")]
            return Axis(field, values, text, {"field": field, "values": values})
        first, last, number = range_.split(":")
        start, stop, count = float(first), float(last), int(number)
        sent = {"field": field, "start": start, "stop": stop, "count": count}
        return Axis(field, _even(start, stop, count), text, sent)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be FIELD=A,B,C or FIELD=START:STOP:COUNT with up to {MOST_POINTS:,} values, got {text!r}"
        ) from None


def _even(start: float, stop: float, count: int) -> list[float]:
    """Return values as the service spaces them."""
    if not 1 <= count <= MOST_POINTS:
        raise ValueError(count)
    if count == 1:
        return [start]
    step = (stop - start) / (count - 1)
    return [start + step * i for i in range(count - 1)] + [stop]


def _filled(body: dict[str, Any], axes: Sequence[Axis]) -> dict[str, Any]:
    """Return the body with the first value of each axis where it has none: it has to be a whole request."""
    for axis in axes:
        *steps, last = axis.field.split(".")
        place: Any = body
        for step in steps:
            place = place.setdefault(step, {}) if isinstance(place, dict) else None
        if isinstance(place, dict):
            place.setdefault(last, axis.values[0])
    return body


def _explained(error: RefusedError, body: Body, axes: Sequence[Axis]) -> CommandError:
    """Return a refusal in the words of whoever gave what is refused."""
    told = []
    by_pointer = {"/" + axis.field.replace(".", "/"): axis for axis in axes}
    for each in error.errors:
        _, part, *steps = each["pointer"].split("/") if each["pointer"].count("/") else ("", "")
        pointer = "".join(f"/{step}" for step in steps)
        if part == "base" and pointer not in by_pointer:
            told.append(body.told(pointer, each["detail"]))
        elif part == "base":
            told.append(f"--axis {by_pointer[pointer].text}: {each['detail']}")
        elif part == "axes" and steps:
            told.append(f"--axis {axes[int(steps[0])].text}: {each['detail']}")
        else:
            told.append(f"--axis: {each['detail']}")
    return CommandError("\n".join(told), error.status) if told else error
