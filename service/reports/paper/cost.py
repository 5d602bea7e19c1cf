"""Figure 16: what a critical angle costs."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from service.reports import style
from service.reports.contents import Figure, Section, Table, Tell, paragraphs
from service.reports.paper.searches import search
from service.reports.reference import finite_element_runs, paper_value
from solver.search.types import SearchMethod

REPEATS: dict[SearchMethod, int] = {"bisection": 2, "secant": 2, "outcome": 15}
PAPER_RUNS, PAPER_CORES = 5, 4
"""Finite element runs behind the paper's critical angle, at least, and cores that each took."""
NEAR = 45.0
"""Our finite element runs from this angle on bracket the critical one. [°]"""


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU time of one way to the critical angle."""

    way: str
    seconds: float
    remark: str


def section(tell: Tell) -> Section:
    """Return Figure 16."""
    tell("cost of the searches")
    costs = [*_finite_elements(), *(_measured(method) for method in REPEATS)]
    secant = next(each.seconds for each in costs if each.way.startswith("secant"))
    paper, ours = costs[0].seconds, costs[-1].seconds
    return Section(
        title="Figure 16: cost",
        text=paragraphs(
            f"""
            CPU time to the critical angle, the shortest of several runs on this machine, over that of the
            secant search with the paper's 12,000 elements and steps of 0.01 ms. Measured times, here and in
            the section on finite elements, are all that differs between two reports.

            The paper prints no bar of its Figure 16, only that one LS-DYNA run takes about 5 h on 4 cores
            and that at least {PAPER_RUNS} were made: {paper:,.0f} s if all four cores were busy. Our own
            finite element runs are coarser, and their program was compiled partly without optimisation. So
            the order of magnitude counts here, no digit.

            In the paper the secant search is the cheapest. Here the bisection is, since it needs fewer
            trials. The outcome search takes {ours * 1e3:.0f} ms of CPU and goes to 0.01° instead of 1 %,
            over 5° to 85° instead of 40° to 60°.
            """
        ),
        tables=[
            Table(
                name="cost",
                caption="CPU time of a critical angle, over that of the secant search and over that of the finite "
                "elements of the paper.",
                columns=["way", "CPU s", "over secant", "over LS-DYNA", "remark"],
                rows=[
                    (each.way, each.seconds, each.seconds / secant, each.seconds / paper, each.remark) for each in costs
                ],
            )
        ],
        figures=[_figure(costs, secant)],
    )


def _finite_elements() -> tuple[Cost, Cost]:
    hours = paper_value("finite_element_hours")
    near = [run for run in finite_element_runs() if run.name.startswith("oblique") and _degrees(run.name) >= NEAR]
    return (
        Cost(
            "LS-DYNA (paper)",
            PAPER_RUNS * hours * 3600.0 * PAPER_CORES,
            f"{PAPER_RUNS} runs of {hours:g} h on {PAPER_CORES} cores, 159,200 solids, as printed",
        ),
        Cost(
            "OpenRadioss (ours)",
            sum(run.cpu_seconds or 0.0 for run in near),
            f"{len(near)} runs from {NEAR:g}° to 55°, up to 77,000 solids, measured when they were made",
        ),
    )


def _degrees(name: str) -> float:
    return float(name.partition("-")[2])


def _measured(method: SearchMethod) -> Cost:
    """The shortest of several searches, on one thread."""
    search(method)
    shortest = min(_cpu_seconds(method) for _ in range(REPEATS[method]))
    way = "outcome search (ours)" if method == "outcome" else f"{method} (paper's elements)"
    trials = len(search(method).iterations)
    return Cost(way, shortest, f"{trials} trials, shortest of {REPEATS[method]}")


def _cpu_seconds(method: SearchMethod) -> float:
    start = time.process_time()
    search(method)
    return time.process_time() - start


def _figure(costs: Sequence[Cost], secant: float) -> Figure:
    figure, (axes,) = style.panels(1, height=2.9)
    ways, ratios = [each.way for each in costs], [each.seconds / secant for each in costs]
    colors = [style.PAPER, style.FINITE_ELEMENT, "#7fb2dd", "#3a83c4", style.MODEL]
    axes.barh(ways, ratios, color=colors, height=0.6)
    for position, ratio in enumerate(ratios):
        label = f"{float(f'{ratio:.2g}'):,g}"
        axes.annotate(label, (ratio, position), xytext=(5, 0), textcoords="offset points", va="center")
    axes.set(xscale="log", xlabel="CPU time over that of the secant search", xlim=(min(ratios) / 2.5, max(ratios) * 12))
    axes.axvline(1.0, color=style.HINT, linewidth=0.8)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    return Figure(
        name="figure-16",
        caption="Figure 16. CPU time to the critical angle over that of the secant search, logarithmic.",
        figure=figure,
        data={"way": ways, "cpu_s": [each.seconds for each in costs], "over_secant": ratios},
    )
