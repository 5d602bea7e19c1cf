"""Drawings of the validation report."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from service.reports import style
from service.reports.contents import Figure
from service.reports.validation.assessment import BAND, Assessment, of_series, percent
from service.reports.validation.predictions import LEFT_OUT, METHODS
from service.reports.validation.strikes import OUTLIER_ROW
from solver.arrays import FloatArray

MARKS = ("o", "s", "^", "D", "v", "P")
COLORS = (style.MODEL, style.FINITE_ELEMENT, style.PAPER, "#8a4fae")
DEPTHS = (0.12, 4.0)
"""Ends of the axes. [m]"""


def depth_figure(assessment: Assessment, factor_model: str, name: str) -> Figure:
    """Predicted against measured depth, and their ratio over velocity, by both methods."""
    figure, axes = style.panels(4, rows=2, height=7.4)
    velocities = np.array([strike.test.velocity for strike in assessment.strikes])
    columns: dict[str, Sequence[object]] = {
        "series": [strike.test.series for strike in assessment.strikes],
        "row": [strike.test.row for strike in assessment.strikes],
        "counted": ["yes" if strike.counted else "no" for strike in assessment.strikes],
        "velocity_m_s": velocities.tolist(),
        "measured_depth_m": assessment.measured.tolist(),
    }
    for column, method in enumerate(METHODS):
        depths, ratios = assessment.predictions[method, factor_model].depths, assessment.ratios(method, factor_model)
        _scatter(axes[column], assessment, depths)
        _ratio(axes[2 + column], assessment, velocities, ratios)
        axes[column].set_title(method)
        key = method.replace(" ", "_")
        columns |= {f"{key}_depth_m": depths.tolist(), f"{key}_ratio": ratios.tolist()}
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    left_out = ": S of each test from the others of its group" if factor_model == LEFT_OUT else ""
    caption = (
        f"**S = {factor_model}**{left_out}. Above, predicted against measured depth; below, their ratio over "
        f"velocity. Broken lines at ±{percent(BAND)}; the cross is row {OUTLIER_ROW}, in no fit and no statistic."
    )
    return Figure(name=name, caption=caption, figure=figure, data=columns)


def _marks(axes: Axes, assessment: Assessment, x: FloatArray, y: FloatArray) -> None:
    """One mark a test, by series, and a cross for what is not counted."""
    for series, mark, color in zip(assessment.series, MARKS, COLORS, strict=False):
        places = assessment.chosen(of_series(series))
        axes.plot(x[places], y[places], mark, color=color, markerfacecolor="none", label=series)
    places = [place for place, strike in enumerate(assessment.strikes) if not strike.counted]
    axes.plot(x[places], y[places], "x", color=style.TEST, markersize=8, markeredgewidth=2, label=f"row {OUTLIER_ROW}")


def _scatter(axes: Axes, assessment: Assessment, depths: FloatArray) -> None:
    ends = np.array(DEPTHS)
    axes.plot(ends, ends, color=style.FACE, linewidth=1.0)
    for factor in (1.0 - BAND, 1.0 + BAND):
        axes.plot(ends, factor * ends, "--", color=style.FACE, linewidth=1.0)
    _marks(axes, assessment, assessment.measured, depths)
    axes.set(xscale="log", yscale="log", xlim=DEPTHS, ylim=DEPTHS, aspect="equal")
    axes.set(xlabel="measured depth [m]", ylabel="predicted depth [m]")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_ticks([0.2, 0.5, 1.0, 2.0])
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def _ratio(axes: Axes, assessment: Assessment, velocities: FloatArray, ratios: FloatArray) -> None:
    axes.axhline(1.0, color=style.FACE, linewidth=1.0)
    for factor in (1.0 - BAND, 1.0 + BAND):
        axes.axhline(factor, linestyle="--", color=style.FACE, linewidth=1.0)
    _marks(axes, assessment, velocities, ratios)
    axes.set(xlabel="striking velocity [m/s]", ylabel="predicted / measured", xlim=(0.0, 1300.0), ylim=(0.4, 1.6))
