"""How every figure of the reports looks."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "ricochet",
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#5c6670",
    "axes.linewidth": 0.8,
    "grid.color": "#e3e6e9",
    "grid.linewidth": 0.7,
    "xtick.color": "#3c444c",
    "ytick.color": "#3c444c",
    "lines.linewidth": 1.5,
    "lines.markersize": 5.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "savefig.dpi": 150,
}
WIDTH = 8.0
"""Size of a figure that fills the column of the page. [in]"""

TEST, FINITE_ELEMENT, MODEL, PAPER = "#c8102e", "#d95f00", "#123f73", "#1d7a46"
"""Measured, finite elements, this model, printed in the paper."""
CONCRETE, FACE, HINT = "#e4e1dc", "#8a8378", "#5c6670"


@contextmanager
def styled() -> Iterator[None]:
    """Draw and save in this style."""
    with mpl.rc_context(SETTINGS):
        yield


def panels(count: int, *, height: float = 3.2, rows: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """Return an empty figure as wide as the page, with panels laid out by rows.

    Parameters
    ----------
    count
        Number of panels.
    height
        Height of the figure. [in]
    rows
        The panels are spread over these, the last row may end early.
    **options
        For `Figure.subplots`: `sharex`, `sharey`, ...
    """
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    grid = figure.subplots(rows, -(-count // rows), squeeze=False, **options).ravel().tolist()
    for spare in grid[count:]:
        spare.remove()
    return figure, grid[:count]


def shades(count: int) -> list[tuple[float, float, float]]:
    """Colours of a family of curves, from light to dark."""
    shaded = mpl.colormaps["viridis"](np.linspace(0.88, 0.0, count))
    return [(float(red), float(green), float(blue)) for red, green, blue, _ in shaded]
