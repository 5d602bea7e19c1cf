"""pandas tables, matplotlib figures, and texts in consoles and notebooks that show answers of the solver.

pandas and matplotlib are optional, and imported by the functions that need them. A plot is drawn into the given axes,
or into a new pyplot figure, to which `savefig` and `show` of pyplot then apply.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from solver.arrays import FloatArray
from solver.projectile import Line, Projectile
from solver.quantities import described

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import pandas as pd

Axes: TypeAlias = "matplotlib.axes.Axes"
Figure: TypeAlias = "matplotlib.figure.Figure"
DataFrame: TypeAlias = "pd.DataFrame"
Columns: TypeAlias = dict[str, npt.NDArray[Any]]
"""Arrays of equal length by name."""
Row: TypeAlias = Mapping[str, str | float | None]
"""Strings and numbers of one answer by column name; None for a missing value."""

# With more outlines, neighbouring ones overlap along a usual path; the value is arbitrary.
INSTANTS = 5
"""Number of instants at which a side view shows the projectile."""
# With 40 points, the chords of a quarter circle deviate from it by 2e-4 of its radius, less than a pixel.
ARC_POINTS = 40
"""Number of points of a drawn arc."""
COLORS: Mapping[str, str] = {
    "ricochet": "#c8102e",
    "embedded": "#123f73",
    "in_motion": "#8a8378",
    "perforated": "#2e7d32",
}
"""Colours of the outcomes."""
BLUE, RED, GREY, CONCRETE = "#123f73", "#c8102e", "#5c6670", "#e4e1dc"


def optional(module: str, needed_by: str, instead: str) -> Any:
    """Import a module from an optional package.

    Parameters
    ----------
    module
        Name of the module.
    needed_by, instead
        Function that needs the module, and an alternative that does not, for the error message.

    Raises
    ------
    ModuleNotFoundError
        If the package is not installed. The message gives the command that installs it, and the alternative.
    """
    package = module.partition(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] != package:
            raise
        text = f"{needed_by} needs {package}: pip install {package}; {instead}"
        raise ModuleNotFoundError(text, name=package) from None


def column_attributes(name: str, values: Any, *kinds: type) -> dict[str, str]:
    """Return the name, description and unit of a column, as attributes of a table or dataset.

    Parameters
    ----------
    name
        Name of a field, or a dotted name.
    values
        Values of the column; only numbers get a unit.
    kinds
        Classes in which to look for the field.
    """
    found = described(name, *kinds)
    numbers = bool(found.unit) and np.asarray(values).dtype.kind in "fi"
    attributes = {"long_name": name.rpartition(".")[2].replace("_", " "), "description": found.short}
    attributes["units"] = found.unit if numbers else ""
    return {attribute: value for attribute, value in attributes.items() if value}


def dataframe(columns: Mapping[str, npt.NDArray[np.generic]], *kinds: type, index: str | None = None) -> DataFrame:
    """Return the columns as a ``pandas.DataFrame``, with their units in its `attrs`.

    Parameters
    ----------
    kinds
        Classes that have the columns as fields.
    index
        Name of the column that becomes the index.
    """
    pandas = optional("pandas", "to_dataframe()", "columns() gives the same as arrays")
    table: DataFrame = pandas.DataFrame(dict(columns))
    found = {name: column_attributes(name, values, *kinds).get("units") for name, values in columns.items()}
    table.attrs["units"] = {name: unit for name, unit in found.items() if unit}
    return table if index is None else table.set_index(index)


class Warned(Protocol):
    """Interface of a warning about an answer."""

    @property
    def code(self) -> str:
        """Stable name of the warning."""

    @property
    def detail(self) -> str:
        """Human-readable explanation."""

    @property
    def standing(self) -> bool:
        """True for a standing note, such as a warning that most answers have."""


def line(answer: object, *parts: str) -> str:
    """Return a one-line representation of an answer: its class and the parts that are not empty."""
    return f"<{type(answer).__name__}: {', '.join(filter(None, parts))}>"


def card(title: str, rows: Mapping[str, str], warnings: Iterable[Warned] = (), more: str = "") -> str:
    """Return an answer as HTML, in the light or dark colours of the notebook that shows it.

    Parameters
    ----------
    title
        Summary of the answer, as plain text.
    rows
        Names and values, as plain text; empty values are left out.
    warnings
        Warnings of the answer, in a collapsed list. Standing notes have a list of their own and are not counted.
    more
        Further HTML, which is not escaped.
    """
    cells = "".join(
        f'<tr><th style="text-align:left;font-weight:normal">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows.items()
        if value
    )
    found: tuple[list[str], list[str]] = ([], [])
    for each in warnings:
        found[each.standing].append(f"<li><code>{escape(each.code)}</code> {escape(each.detail)}</li>")
    count = "1 warning" if len(found[0]) == 1 else f"{len(found[0])} warnings"
    folded = "".join(
        f"<details><summary>{title}</summary><ul>{''.join(items)}</ul></details>"
        for title, items in zip((count, "Standing notes"), found, strict=True)
        if items
    )
    table = f'<table style="color:inherit">{cells}</table>'
    return f"<div><strong>{escape(title)}</strong>{table}{more}{folded}</div>"


def new_figure(width: float, height: float) -> Any:
    """Create a pyplot figure; its size is in inches."""
    pyplot = optional("matplotlib.pyplot", "plot()", "columns() returns the plotted data as arrays")
    figure = pyplot.figure(figsize=(width, height), layout="constrained")
    figure._ipython_display_ = partial(_show_once, figure)
    return figure


def _show_once(figure: Any) -> None:
    """Close a figure, so that a notebook that shows it as the result of a cell does not show it again."""
    pyplot = import_module("matplotlib.pyplot")
    if "inline" in pyplot.get_backend():
        pyplot.close(figure)
    raise NotImplementedError  # makes IPython fall back to its usual display


def finished(panel: Any, title: str) -> Figure:
    """Add a title, a grid and a legend to a panel; return its figure."""
    panel.set_title(title, loc="left", fontsize="medium")
    panel.grid(visible=True, alpha=0.3)
    panel.legend(frameon=False, fontsize="small")
    figure: Figure = panel.figure
    return figure


def plot_motion(history: Columns, title: str, projectile: Projectile | None, ax: Any) -> Figure:
    """Plot the side view of a motion and its histories, or only the side view if axes are given.

    Parameters
    ----------
    history
        Columns of `Motion`.
    title
        Title of the side view.
    projectile
        Projectile to draw at some instants; if None, only the axis from nose tip to centre of gravity is drawn.
    """
    figure: Figure = new_figure(9.0, 5.0) if ax is None else ax.figure
    if ax is not None:
        _draw_side(ax, history, projectile, title)
        return figure
    names = ("depth", "angle", "speed", "force")
    panels = figure.subplot_mosaic([["side", name] for name in names], width_ratios=(1.3, 1.0))
    _draw_side(panels["side"], history, projectile, title)
    milliseconds = 1e3 * history["time"]
    speed = np.hypot(history["depth_velocity"], history["lateral_velocity"])
    force = np.hypot(history["depth_force"], history["lateral_force"])
    curves = {
        "depth": (history["nose_tip_depth"], "tip depth\n[m]"),
        "angle": (np.degrees(history["axis_angle"]), "axis angle\n[°]"),
        "speed": (speed, "speed\n[m/s]"),
        "force": (force / 1e3, "resistance\n[kN]"),
    }
    for name, (values, label) in curves.items():
        panels[name].plot(milliseconds, values, color=BLUE)
        panels[name].set_ylabel(label)
        panels[name].grid(visible=True, alpha=0.3)
        panels[name].sharex(panels["force"])
        panels[name].tick_params(labelbottom=name == "force")
    panels["force"].set_xlabel("time [ms]")
    figure.align_ylabels([panels[name] for name in names])
    return figure


def _draw_side(panel: Any, history: Columns, projectile: Projectile | None, title: str) -> None:
    """Draw the projectile from the side, with the depth downwards, and the path of its nose tip."""
    time, angle = history["time"], history["axis_angle"]
    cosine = np.cos(angle)
    row = int(np.argmax(np.abs(cosine)))
    ahead = float((history["nose_tip_depth"][row] - history["center_of_gravity_depth"][row]) / cosine[row])
    lateral = history["center_of_gravity_lateral"] + ahead * np.sin(angle)
    lateral, depth = lateral - lateral[0], history["nose_tip_depth"]
    outline = np.array([(0.0, 0.0), (ahead, 0.0)]) if projectile is None else _silhouette(projectile)
    rows = np.searchsorted(time, np.linspace(0.0, time[-1], INSTANTS)).clip(0, time.size - 1)
    for shade, i in zip(np.linspace(0.25, 1.0, INSTANTS), rows, strict=True):
        along, across = outline.T
        x = lateral[i] - along * np.sin(angle[i]) + across * cosine[i]
        y = depth[i] - along * cosine[i] - across * np.sin(angle[i])
        if projectile is None:
            panel.plot(x, y, color=BLUE, alpha=shade, linewidth=3.0, solid_capstyle="round")
        else:
            panel.fill(x, y, facecolor=BLUE, alpha=0.3 * shade, edgecolor="none")
            panel.plot(np.append(x, x[0]), np.append(y, y[0]), color=BLUE, alpha=shade, linewidth=1.0)
        panel.annotate(f"{1e3 * time[i]:.1f} ms", (x[along.argmax()], y[along.argmax()]), fontsize="x-small")
    panel.plot(lateral, depth, color=RED, linewidth=1.5, label="nose tip")
    panel.autoscale_view()
    bottom, top = panel.get_ylim()
    panel.axhspan(0.0, max(bottom, top), color=CONCRETE, zorder=0)
    panel.axhline(0.0, color=GREY, linewidth=1.0, zorder=1)
    panel.set(
        aspect="equal", ylim=(max(bottom, top), min(bottom, top)), xlabel="along the face [m]", ylabel="depth [m]"
    )
    panel.legend(loc="upper right", frameon=False, fontsize="small")
    panel.set_title(title, loc="left", fontsize="medium")


def _silhouette(projectile: Projectile) -> FloatArray:
    """Return the (n, 2) closed outline: distance behind the tip and signed distance from the axis. [m]"""
    edge: list[tuple[float, float]] = []
    for piece in projectile.outline():
        x, r, _, _ = piece.at(np.linspace(0.0, 1.0, 2 if isinstance(piece, Line) else ARC_POINTS))
        edge += zip(x.tolist(), r.tolist(), strict=True)
    upper = np.array(edge)
    return np.concatenate([upper, upper[::-1] * (1.0, -1.0)])


def plot_search(trials: Columns, title: str, angle: float | None, ax: Any) -> Figure:
    """Plot the final depth of the nose tip against the angle of each trial, and return the figure.

    Trials with coarse numerical settings have hollow markers.
    """
    panel = new_figure(6.0, 4.0).subplots() if ax is None else ax
    degrees = np.degrees(trials["oblique_angle"])
    for outcome, color in COLORS.items():
        for fine, face in ((True, color), (False, "none")):
            rows = (trials["outcome"] == outcome) & (trials["fine"] == fine)
            if rows.any():
                label = outcome.replace("_", " ") + ("" if fine else ", coarse")
                position = trials["final_position"][rows]
                panel.plot(
                    degrees[rows], position, "o", markeredgecolor=color, markerfacecolor=face, color=color, label=label
                )
    if angle is not None:
        panel.axvline(np.degrees(angle), color=GREY, linestyle="--", label="critical angle")
    panel.set(xlabel="oblique angle from the normal [°]", ylabel="nose tip at the end, depth [m]")
    return finished(panel, title)


def plot_probability(curve: Columns, title: str, ax: Any) -> Figure:
    """Plot the probability of ricochet and its interval against the angle; return the figure."""
    panel = new_figure(6.0, 4.0).subplots() if ax is None else ax
    degrees = np.degrees(curve["oblique_angle"])
    panel.fill_between(degrees, curve["lower"], curve["upper"], color=BLUE, alpha=0.25, linewidth=0.0, label="interval")
    panel.plot(degrees, curve["probability"], color=BLUE, label="probability")
    panel.set(xlabel="oblique angle from the normal [°]", ylabel="probability of ricochet", ylim=(-0.02, 1.02))
    return finished(panel, title)


def plot_perforation(trials: Columns, title: str, label: str, bracket: tuple[float, float] | None, ax: Any) -> Figure:
    """Plot the speed behind the wall in each trial, and the limit; return the figure.

    Parameters
    ----------
    trials
        Columns ``value``, ``outcome`` and ``speed``; the speed is 0 for trials that did not perforate. [m/s]
    title
        Title of the figure.
    label
        Name and unit of the quantity that was varied.
    bracket
        Values between which the outcome changes; None if it does not.
    """
    panel = new_figure(6.0, 4.0).subplots() if ax is None else ax
    for outcome, color in COLORS.items():
        rows = trials["outcome"] == outcome
        if rows.any():
            name = outcome.replace("_", " ")
            panel.plot(trials["value"][rows], trials["speed"][rows], "o", color=color, alpha=0.7, label=name)
    if bracket is not None:
        panel.axvline(0.5 * sum(bracket), color=GREY, linestyle="--", label="limit")
    panel.set(xlabel=label, ylabel="speed behind the wall [m/s]")
    return finished(panel, title)


def plot_depths(predicted: FloatArray, measured: FloatArray, title: str, ax: Any) -> Figure:
    """Plot measured against predicted depths [m]; return the figure."""
    panel = new_figure(6.0, 4.0).subplots() if ax is None else ax
    panel.plot(predicted, measured, "o", color=BLUE, label="tests")
    panel.axline((0.0, 0.0), slope=1.0, color=GREY, linestyle="--", label="as predicted")
    panel.set(xlabel="predicted depth [m]", ylabel="measured depth [m]")
    return finished(panel, title)


def plot_endings(
    outcomes: Mapping[str, Sequence[float]],
    depth: Sequence[Sequence[float]],
    speeds: Mapping[str, Sequence[Sequence[float]]],
    title: str,
    ax: Any,
) -> Figure:
    """Plot the probability of each outcome, and quantiles of depth and exit speed; return the figure.

    If axes are given, only the probabilities are plotted.

    Parameters
    ----------
    outcomes
        Probability of each outcome, with the lower and the upper end of its interval. [1]
    depth
        Quantiles of the greatest depth, as rows of probability, depth, and both ends of its interval. [1, m, m, m]
    speeds
        Quantiles of the exit speed in the same form, by outcome. [1, m/s, m/s, m/s]
    title
        Title of the figure.
    """
    shown = {outcome: found for outcome, found in speeds.items() if len(found)}
    widths = (1.1, 1.0, 1.0) if shown else (1.1, 1.0)
    panels = [ax] if ax is not None else new_figure(9.0, 3.6).subplots(1, len(widths), width_ratios=widths)
    shares: Any = panels[0]
    names = [name.replace("_", " ") for name in outcomes]
    middle, lower, upper = np.array(list(outcomes.values())).T
    whiskers = np.clip([middle - lower, upper - middle], 0.0, None)
    shares.barh(names, middle, xerr=whiskers, color=[COLORS[name] for name in outcomes], ecolor=GREY, capsize=4.0)
    shares.set(xlabel="probability, with its interval", xlim=(0.0, 1.02))
    shares.invert_yaxis()
    shares.set_title(title, loc="left", fontsize="medium")
    if ax is None:
        _draw_quantiles(panels[1], depth, BLUE, "")
        panels[1].set(xlabel="greatest depth [m]", ylabel="share of runs below")
    if ax is None and shown:
        for outcome, found in shown.items():
            _draw_quantiles(panels[2], found, COLORS[outcome], outcome.replace("_", " "))
        panels[2].set(xlabel="speed at the exit [m/s]", ylabel="share of exits below")
        panels[2].legend(frameon=False, fontsize="small")
    for panel in panels:
        panel.grid(visible=True, alpha=0.3)
        panel.set_axisbelow(True)
    figure: Figure = shares.figure
    return figure


def _draw_quantiles(panel: Any, quantiles: Sequence[Sequence[float]], color: str, label: str) -> None:
    """Draw a distribution from rows of probability, quantile, and the ends of the interval of the quantile."""
    level, value, lower, upper = np.array(quantiles).reshape(-1, 4).T
    panel.fill_betweenx(level, lower, upper, color=color, alpha=0.2, linewidth=0.0)
    panel.plot(value, level, color=color, marker="o", markersize=3.0, label=label)
    panel.set_ylim(-0.02, 1.02)
