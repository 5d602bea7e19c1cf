"""`ricochet uncertainty`: estimate the uncertainty of a critical angle or of the outcome of one strike."""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from uuid import uuid4

from service.cli.arguments import (
    FAILED,
    STRIKE,
    CommandError,
    RefusedError,
    add_case,
    add_url,
    add_verbose,
    examples,
    problem_text,
)
from service.cli.outputs import OutputFile, add_formats, add_plot
from service.cli.plots import check_plot, figure_file
from service.cli.request_body import RequestBody, read_body
from service.cli.single import of_search, print_json
from service.cli.writers import cell, heading, print_csv, print_table, print_values, print_warnings, progress
from service.names import QUANTITIES, named

PARAMETERS = {
    "normal": ("mean", "standard_deviation"),
    "truncated_normal": ("mean", "standard_deviation", "lower", "upper"),
    "lognormal": ("median", "dispersion"),
    "log_student_t": ("median", "scale", "degrees_of_freedom", "lower", "upper"),
    "uniform": ("lower", "upper"),
    "triangular": ("lower", "mode", "upper"),
}
"""Parameters of each distribution, in the order of the command line."""
BOUNDS = ("lower", "upper")
"""Last parameters of `log_student_t`, which are optional."""
WIDE = (7.0, 4.0)
"""Size of the figure, which fits on a page in portrait [in]."""


def add_uncertainty(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet uncertainty`."""
    parser.description = (
        "Estimate the probability of ricochet over the oblique angle, and the sensitivity of the critical angle to "
        "each input; with --angle, the probability of each outcome of that strike. If no input is uncertain, the "
        "usual scatter of the inputs is assumed."
    )
    parser.epilog = examples(
        "ricochet uncertainty strike.toml",
        "ricochet uncertainty strike.toml --uncertain impact.velocity_m_s=normal:238:2.4",
        "ricochet uncertainty strike.toml --next-shot",
        "ricochet uncertainty strike.toml --angle 50 --uncertain resistance.strength_residual=lognormal:1:0.1",
    )
    add_case(parser, STRIKE)
    parser.add_argument(
        "--uncertain",
        action="append",
        default=[],
        metavar="FIELD=TYPE:...",
        help="scatter of a field: normal:MEAN:DEVIATION, truncated_normal:MEAN:DEVIATION:LOWER:UPPER, "
        "lognormal:MEDIAN:DISPERSION, log_student_t:MEDIAN:SCALE:FREEDOM with an optional :LOWER:UPPER, "
        "uniform:LOWER:UPPER, triangular:LOWER:MODE:UPPER, or discrete:VALUE@WEIGHT:VALUE@WEIGHT...; adds to "
        "[[uncertain]] tables of the file",
    )
    parser.add_argument(
        "--next-shot",
        action="store_true",
        help="print the 90 %% range to expect after one and after three shots of your own into the concrete",
    )
    add_formats(parser, json="print the answer as the service sends it", csv="print the probabilities")
    add_verbose(parser, "print the warnings in full, with the standing notes")
    add_plot(parser, "the probability of ricochet with its interval")
    add_url(parser)
    parser.set_defaults(run=run_uncertainty)


def run_uncertainty(args: argparse.Namespace) -> int:
    """Run an uncertainty study, and print its answer."""
    body = read_body(args.case, args, STRIKE)
    given = dict(body.given)
    for text in args.uncertain:
        inputs = body.content.setdefault("uncertain", [])
        inputs.append(uncertain_input(text))
        place, flag = f"/uncertain/{len(inputs) - 1}", f"--uncertain {text}"
        given |= dict.fromkeys((place, f"{place}/field", f"{place}/distribution"), flag)
        given |= {f"{place}/distribution/{name}": f"{flag}: {name}" for name in inputs[-1]["distribution"]}
    body = replace(body, given=given)
    strike = "oblique_angle_deg" in body.content.get("impact", {})
    if args.plot:
        if strike:
            raise CommandError("--plot: only a study without --angle has a curve to plot")
        check_plot()
    if args.next_shot and strike:
        raise CommandError("--next-shot: goes without --angle: shots narrow the range of the critical angle")
    with_usual_scatter(body)
    operation = "trajectory_uncertainty" if strike else "cra_uncertainty"
    text = estimate(operation, body, args.url) if args.url else estimate_here(operation, body)
    answer: dict[str, Any] = json.loads(text)
    advice = next_shot_advice(answer) if args.next_shot else ""
    if args.plot:
        plot_probability(args.plot, answer["probability"])
    if args.json:
        print_json(text)
    elif args.csv:
        print_csv(outcomes_of(answer) if strike else answer["probability"], args.digits)
    else:
        print_answer(answer, verbose=args.verbose)
        if advice:
            print(f"\n{advice}")
    return 0


def with_usual_scatter(body: RequestBody) -> None:
    """Add the usual scatter to a case without uncertain inputs, and print a note.

    Raises
    ------
    CommandError
        If the case is invalid.
    """
    from service.cli.local import usual_scatter

    if "uncertain" not in body.content:
        try:
            body.content["uncertain"] = usual_scatter(of_search(body).content)
        except RefusedError as error:
            raise body.explain(error) from None
        names = ", ".join(named(QUANTITIES, each["field"]) for each in body.content["uncertain"])
        print(f"no input is given with --uncertain: the usual scatter of {names}", file=sys.stderr)


def next_shot_advice(answer: Mapping[str, Any]) -> str:
    """Return a sentence on how much further shots into the same concrete would narrow the range of the critical angle.

    Raises
    ------
    CommandError
        If the study has no factor on S with a lognormal or log-Student distribution.
    """
    from service.schemas.verdict import next_shot_advice_in

    advice = next_shot_advice_in(answer)
    if not advice:
        raise CommandError(
            "--next-shot: needs the scatter of S, which shots narrow: add "
            "--uncertain resistance.strength_residual=lognormal:1:DISPERSION"
        )
    return advice


def estimate_here(operation: str, body: RequestBody) -> bytes:
    """Compute a study in this process, and return its answer as JSON.

    Raises
    ------
    CommandError
        If the request is refused or fails. The message names the invalid flag or field of the file.
    """
    from service.cli.local import compute
    from service.schemas.uncertainty import SAMPLING

    sampling = body.content.get("sampling", {})
    with progress("sampling") as report:

        def show(samples: int, half_width: float | None) -> None:
            wanted = sampling.get("half_width", SAMPLING.half_width)
            report(samples, sampling.get("max_samples", SAMPLING.max_samples), reached(half_width, wanted))

        try:
            return compute(operation, body.content, show)
        except RefusedError as error:
            raise body.explain(error) from None


def reached(half_width: float | None, requested: float) -> str:
    """Describe the half width reached so far and the one requested; empty before the first is known."""
    return "" if half_width is None else f"half width {half_width:.2g}, requested {requested:g}"


def estimate(operation: str, body: RequestBody, url: str) -> bytes:
    """Have a service compute a study as a job, show its progress, and return the answer as JSON.

    Raises
    ------
    CommandError
        If the request is refused or fails. The message names the invalid flag or field of the file.
    """
    from service.cli.client import JSON, POLL_SECONDS, UNFINISHED, connect, dumps, without_secrets

    content = dumps(body.content)
    with connect(url) as client, progress("sampling") as report:
        try:
            job = client.submit(f"/{operation.replace('_', '/')}", lambda: content, JSON, uuid4().hex)
        except RefusedError as error:
            raise body.explain(error) from None
        try:
            while job["status"] in UNFINISHED:
                time.sleep(POLL_SECONDS)
                job = client.job(job["id"])
                if "progress" in job:
                    now = job["progress"]
                    width = reached(now.get("half_width"), now["requested_half_width"])
                    report(now["samples"], now["max_samples"], width)
        except KeyboardInterrupt:
            command = f"ricochet jobs results {job['id']} --url {without_secrets(url)}"
            print(f"the job continues; for its results: {command}", file=sys.stderr)
            raise
        if job["status"] != "successful":
            reason = problem_text(job["problem"]) if "problem" in job else "it was cancelled"
            raise CommandError(f"job {job['id']} ended early: {reason}", FAILED)
        # A study is the single case of its job; the answer is read by its key, as the service sends it.
        [item] = client.page(job["id"], "")["results"]
        return client.result(key_of(item))


def key_of(item: Mapping[str, Any]) -> str:
    """Return the key of the result of a study.

    Raises
    ------
    CommandError
        If the study failed.
    """
    if "problem" in item:
        raise CommandError(f"the study failed: {problem_text(item['problem'])}", FAILED)
    key: str = item["result"]["key"]
    return key


def uncertain_input(text: str) -> dict[str, Any]:
    """Parse the value of `--uncertain`.

    Raises
    ------
    CommandError
        If the text does not have the form FIELD=TYPE:...
    """
    field, equals, rest = text.partition("=")
    kind, *numbers = rest.split(":")
    if equals and kind == "discrete" and numbers:
        pairs = [each.partition("@") for each in numbers]
        found: dict[str, Any] = {"type": kind, "values": [_number(value, text) for value, _, _ in pairs]}
        if any(weight for _, _, weight in pairs):
            found["weights"] = [_number(weight, text) for _, _, weight in pairs]
        return {"field": field, "distribution": found}
    names = PARAMETERS.get(kind, ())
    if kind == "log_student_t" and len(numbers) == len(names) - len(BOUNDS):
        numbers += ["" for _ in BOUNDS]
    if not equals or not names or len(names) != len(numbers):
        raise CommandError(f"--uncertain {text}: must be FIELD=TYPE:..., such as impact.velocity_m_s=normal:238:2.4")
    values = {name: _number(number, text) for name, number in zip(names, numbers, strict=True) if number}
    return {"field": field, "distribution": {"type": kind, **values}}


def _number(word: str, text: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        if not word:
            raise CommandError(f"--uncertain {text}: a value is missing") from None
        return word  # A word may be the name of a model; otherwise validation refuses it.


def print_answer(answer: Mapping[str, Any], *, verbose: bool) -> None:
    """Print estimates, sensitivities, and the number of samples."""
    if "outcomes" in answer:
        columns = outcomes_of(answer)
        print_table([heading(name) for name in columns], list(zip(*columns.values(), strict=True)))
    else:
        angle = answer["critical_angle"]
        names = ("mean_deg", "standard_deviation_deg", "share_without_angle")
        rows = [[heading(name), *_interval(angle[name])] for name in names if name in angle]
        rows += [[f"{100.0 * each['level']:g} % quantile °", *_interval(each)] for each in angle["quantiles"]]
        print_table(["critical angle", "", "from", "to"], rows)
        if "sensitivity" in answer:
            print()
            print_table(["input", "first order", "total", "swing °"], [_shares(each) for each in answer["sensitivity"]])
    half_width = answer["convergence"]["half_width"][-1]
    sampled = {"samples": answer["samples"], "half width": half_width, "converged": str(answer["converged"]).lower()}
    if "method" in answer:
        sampled["method"] = answer["method"]
    print()
    print_values(sampled)
    print_warnings(answer["warnings"], verbose=verbose)


def outcomes_of(answer: Mapping[str, Any]) -> Mapping[str, Sequence[Any]]:
    """Return the probabilities of the outcomes as columns."""
    return {name: [each[name] for each in answer["outcomes"]] for name in ("outcome", "value", "lower", "upper")}


def _interval(estimate: Mapping[str, float]) -> list[float]:
    return [estimate["value"], estimate["lower"], estimate["upper"]]


def _shares(sensitivity: Mapping[str, Any]) -> list[str]:
    shares = [cell(sensitivity[name]["value"]) if name in sensitivity else "" for name in ("first_order", "total")]
    angles = [each["critical_angle_deg"] for each in sensitivity["swing"] if "critical_angle_deg" in each]
    return [named(QUANTITIES, sensitivity["field"]), *shares, " to ".join(f"{angle:.4g}" for angle in angles)]


def plot_probability(output: OutputFile, curve: Mapping[str, Sequence[float]]) -> None:
    """Plot the probability of ricochet with its interval."""
    with figure_file(output, WIDE) as (_, panel):
        angles = curve["oblique_angle_deg"]
        panel.fill_between(angles, curve["lower"], curve["upper"], color="#123f73", alpha=0.25, linewidth=0.0)
        panel.plot(angles, curve["ricochet_probability"], color="#123f73")
        panel.set(xlabel="oblique angle from the normal [°]", ylabel="probability of ricochet", ylim=(0.0, 1.0))
