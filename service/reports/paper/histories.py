"""Histories of lateral displacement, depth displacement and rotation, side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes

from service.reports import style
from service.reports.contents import stack
from solver.arrays import FloatArray
from solver.calibration import MotionHistory

LABELS = {
    "lateral_displacement": "lateral displacement [m]",
    "depth_displacement": "depth displacement [m]",
    "rotation": "rotation [°]",
}
"""Of each quantity as it is shown."""
END = 5e-3
"""Of the paper's oblique runs. [s]"""


@dataclass(frozen=True, slots=True)
class Curve:
    """A history and how it is drawn."""

    label: str
    history: MotionHistory
    line: Mapping[str, Any]


def column(history: MotionHistory, quantity: str) -> FloatArray:
    """One quantity of a history, as it is shown. [m, m, °]"""
    values: FloatArray = np.asarray(getattr(history, quantity), dtype=np.float64)
    return np.degrees(values) if quantity == "rotation" else values


def draw_histories(
    curves: Sequence[Curve], *, mark: float | None = None, against: MotionHistory | None = None
) -> matplotlib.figure.Figure:
    """Draw the three quantities over time.

    Parameters
    ----------
    curves
        The last on top.
    mark
        Time of a dotted line. [s]
    against
        A history at the times of the curves: a second row shows their differences to it.
    """
    rows = 1 if against is None else 2
    figure, panels = style.panels(len(LABELS) * rows, height=1.2 + 2.3 * rows, rows=rows, sharex=True)
    for axes, (quantity, label) in zip(panels, LABELS.items(), strict=False):
        for curve in curves:
            axes.plot(curve.history.time * 1e3, column(curve.history, quantity), label=curve.label, **curve.line)
        if mark is not None:
            axes.axvline(mark * 1e3, color=style.HINT, linestyle=":", linewidth=1.0)
        axes.set(title=label, xlim=(0.0, END * 1e3))
    if against is not None:
        for axes, quantity in zip(panels[len(LABELS) :], LABELS, strict=True):
            _draw_differences(axes, curves, against, quantity)
    for axes in panels[-len(LABELS) :]:
        axes.set_xlabel("time [ms]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def _draw_differences(axes: Axes, curves: Sequence[Curve], against: MotionHistory, quantity: str) -> None:
    """Differences in mm and degrees."""
    scale, unit = (1.0, "°") if quantity == "rotation" else (1e3, "mm")
    for curve in curves:
        differences = column(curve.history, quantity) - column(against, quantity)
        axes.plot(curve.history.time * 1e3, differences * scale, **curve.line)
    axes.set_title(f"difference to adaptive [{unit}]")


def history_columns(curves: Sequence[Curve]) -> dict[str, list[object]]:
    """The numbers of these curves, for `Figure.data`."""
    return stack(
        "series",
        {
            curve.label: {
                "time_s": curve.history.time,
                "lateral_displacement_m": column(curve.history, "lateral_displacement"),
                "depth_displacement_m": column(curve.history, "depth_displacement"),
                "rotation_deg": column(curve.history, "rotation"),
            }
            for curve in curves
        },
    )
