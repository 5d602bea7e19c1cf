"""Ratios of predicted to measured depths, and how they are drawn."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from service.reports import style
from service.reports.contents import Comparison, Figure, Section, Table
from service.reports.validation.assessment import BAND, Agreement, Assessment, agreement, every, of_series, percent
from service.reports.validation.predictions import (
    ALL_MODELS,
    CLOSED_FORM,
    LEFT_OUT,
    METHODS,
    OUTLIER_ROW,
    POWER_LAW,
    TRAJECTORY,
)
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


SERIES = "forrestal-1994"
"""With power law and closed form, the one that numbers were set for beforehand."""
MEAN_RATIO, MEAN_RATIO_TOLERANCE = 1.02, 0.03
VARIATION, VARIATION_TOLERANCE = 0.08, 0.02
FIGURE_NAMES = ("power-law-82.6", "power-law-72", "constant-8.52", "leave-one-out")


def ratios_section(assessment: Assessment) -> Section:
    """Every choice of the strength factor, by both methods."""
    text = (
        (
            "Four choices of the strength factor S. Two are correlations with the strength f'c in MPa, of Frew et "
            "al. (1998) and of Li and Chen (2003); both were made with tests of the 1994 and 1998 series, among "
            "others. The third is the paper's value at 0°, fitted to four tests of the 2003 series with another "
            "diameter (80 mm) and density. The fourth is **leave-one-out**: S of a test is fitted, by least "
            "squares in depth, to the other tests of its series and grade of concrete, never to itself. It shows "
            "what the form of the model is worth once its constant is known."
        ),
        (
            "Two ways from S to the depth: the trajectory model in normal impact, and the closed form of "
            "Forrestal et al. (1994) with a crater two diameters deep."
        ),
        _reading(assessment),
    )
    figures = tuple(depth_figure(assessment, *each) for each in zip(ALL_MODELS, FIGURE_NAMES, strict=True))
    return Section(
        title="Predicted over measured depth",
        text=text,
        comparisons=_comparisons(assessment),
        tables=(_table(assessment),),
        figures=figures,
    )


def agreement_1994(assessment: Assessment, method: str) -> Agreement:
    """The 1994 series with the power law 82.6."""
    return assessment.agreement(method, POWER_LAW, of_series(SERIES))


def _reading(assessment: Assessment) -> str:
    """Which definition gives the mean that was set."""
    ratios = assessment.ratios(CLOSED_FORM, POWER_LAW)
    with_outlier = agreement(ratios[[strike.test.series == SERIES for strike in assessment.strikes]])
    without = agreement_1994(assessment, CLOSED_FORM)
    inverse = agreement(1.0 / ratios[assessment.chosen(of_series(SERIES))])
    return (
        f"The mean ratio set for {SERIES}, {MEAN_RATIO:g}, is read as predicted over measured without row "
        f"{OUTLIER_ROW}: {without.mean_ratio:.3f} over {without.number} tests, with a coefficient of variation of "
        f"{without.coefficient_of_variation:.3f}. With row {OUTLIER_ROW} counted, the {with_outlier.number} tests "
        f"give {with_outlier.mean_ratio:.3f} and {with_outlier.coefficient_of_variation:.3f}; measured over "
        f"predicted, without it, would be {inverse.mean_ratio:.3f} and {inverse.coefficient_of_variation:.3f}. "
        "Nearest to what was set are the numbers with the row."
    )


def _comparisons(assessment: Assessment) -> tuple[Comparison, ...]:
    found = []
    for method in (CLOSED_FORM, TRAJECTORY):
        ours, claimed = agreement_1994(assessment, method), method == CLOSED_FORM
        for what, value, reference, tolerance in (
            ("mean ratio", ours.mean_ratio, MEAN_RATIO, MEAN_RATIO_TOLERANCE),
            ("coefficient of variation", ours.coefficient_of_variation, VARIATION, VARIATION_TOLERANCE),
        ):
            found.append(
                Comparison(
                    what=f"{SERIES}, S = {POWER_LAW}, {method}: {what}",
                    ours=value,
                    reference=reference,
                    unit="1",
                    tolerance=tolerance if claimed else None,
                    reference_source="set beforehand, for the closed form",
                    note="" if claimed else "not held to: see the last section",
                )
            )
    return tuple(found)


def _table(assessment: Assessment) -> Table:
    rows = []
    for model in ALL_MODELS:
        for series in (*assessment.series, "all"):
            choice = every if series == "all" else of_series(series)
            found = [assessment.agreement(method, model, choice) for method in METHODS]
            values = [
                (round(each.mean_ratio, 3), round(each.coefficient_of_variation, 3), each.within_band) for each in found
            ]
            rows.append((model, series, found[0].number, *(value for each in values for value in each)))
    columns = ["S", "series", "tests"]
    for name in ("trajectory", "closed form"):
        columns += [f"{name}: mean", "variation", f"±{percent(BAND)}"]
    caption = (
        "Predicted over measured depth by both methods: mean, coefficient of variation, and how many tests are "
        f"within {percent(BAND)}."
    )

    return Table(name="agreement", caption=caption, columns=columns, rows=rows)
