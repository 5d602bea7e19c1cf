"""work_precision.svg and throughput.svg, from the results.json in this folder or another.

python benchmarks/plots.py [FOLDER]
"""

import json
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

HERE = Path(__file__).parent
STYLE: dict[Any, Any] = {
    "svg.hashsalt": "ricochet",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}
FIGURE_SIZE = (7.3, 4.4)  # about 700 px wide on a page

SCRIPT_COLOR, SECANT_COLOR = "#c8102e", "#d95f00"
PANEL_COLORS = ("#e0a050", "#8a5a00")
SEQUENCE = ("#b5d3ee", "#7fb2dd", "#3a83c4", "#123f73")  # from coarse to fine
WAYS = {
    ("threads", 2): ("2 threads", "#123f73", "o", "-"),
    ("threads", 1): ("1 thread", "#3a83c4", "o", "--"),
    ("processes", 2): ("2 processes", "#e07b00", "s", "-"),
    ("processes", 1): ("1 process", "#e0a050", "s", "--"),
}


def draw_all(results: dict[str, Any], folder: Path, suffix: str = "svg") -> None:
    """Write both pictures, the same bytes for the same results."""
    mpl.use("Agg")
    mpl.rcParams.update(STYLE)
    for name, draw in (("work_precision", draw_work_precision), ("throughput", draw_throughput)):
        figure, axes = plt.subplots(figsize=FIGURE_SIZE, layout="constrained")
        draw(axes, results)
        figure.legend(fontsize=9, frameon=False, loc="outside lower center", ncols=2)
        _save(figure, folder / f"{name}.{suffix}")


def _save(figure: Figure, picture: Path) -> None:
    figure.savefig(picture, dpi=96, metadata={"Date": None} if picture.suffix == ".svg" else None)
    plt.close(figure)


def draw_work_precision(axes: Axes, results: dict[str, Any]) -> None:
    """Error against CPU time; a line for each series, the NumPy script and its compiled twin as single marks."""
    found = results["work_precision"]
    series: dict[str, list[dict[str, Any]]] = {}
    for point in found["points"]:
        series.setdefault(point["series"], []).append(point)
    adaptive = [name for name, points in series.items() if points[0]["route"] == "adaptive"]
    others = [name for name in series if name not in adaptive]
    shades = SEQUENCE[-len(adaptive) :] if adaptive else ()
    styles = dict(zip(adaptive, ((color, "o") for color in shades), strict=True))
    styles |= dict(zip(others, ((color, "s") for color in PANEL_COLORS), strict=False))
    for name, points in series.items():
        color, marker = styles[name]
        times = [point["cpu_s"]["median"] for point in points]
        errors = [max(point["error_deg"], found["bracket_deg"]) for point in points]
        axes.loglog(times, errors, marker=marker, markersize=4.5, linewidth=1.4, color=color, label=name)
    for key, color in (("panels_secant", SECANT_COLOR), ("numpy_script", SCRIPT_COLOR)):
        row = results["angles"][key]
        time, error = row["cpu_s"]["median"], row["error_of_own_criterion_deg"]
        axes.loglog(time, error, "*", markersize=14, color=color, zorder=5, label=row["label"])
    axes.axhline(0.01, color="#999999", linewidth=0.8, linestyle=":")
    axes.annotate(
        "default bracket, 0.01°", (1.0, 0.01), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8.5
    )
    axes.set(xlabel="CPU time of a critical angle [s]", ylabel="error of the critical angle [°]")
    axes.grid(visible=True, which="major", color="#eeeeee")


def draw_throughput(axes: Axes, results: dict[str, Any]) -> None:
    """Cases per second against the number of cases, with the extremes of the repetitions."""
    for (kind, workers), (label, color, marker, line) in WAYS.items():
        found = results["throughput"] + results.get("long_batches", [])
        rows = [row for row in found if (row["kind"], row["workers"]) == (kind, workers)]
        if not rows:
            continue
        speeds = [row["cases_per_second"] for row in rows]
        middle = [speed["median"] for speed in speeds]
        below = [speed["median"] - speed["lowest"] for speed in speeds]
        above = [speed["highest"] - speed["median"] for speed in speeds]
        axes.errorbar(
            [row["cases"] for row in rows],
            middle,
            yerr=[below, above],
            color=color,
            marker=marker,
            markersize=5,
            linestyle=line,
            linewidth=1.6,
            capsize=2.5,
            label=label,
        )
    axes.set_xscale("log")
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.4g}"))
    axes.set(xlabel="random strikes in one call", ylabel="critical angles per second")
    axes.grid(visible=True, which="major", color="#eeeeee")


def main() -> None:
    folder = Path(sys.argv[1]) if sys.argv[1:] else HERE
    draw_all(json.loads((folder / "results.json").read_text(encoding="utf-8")), folder)
    print(f"wrote work_precision.svg and throughput.svg to {folder}", file=sys.stderr)


if __name__ == "__main__":
    main()
