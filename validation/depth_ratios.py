"""Ratios of predicted to measured depths, and the difference between the closed form and the trajectory model."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from service.reports import style
from solver import Projectile, solid_properties
from solver.arrays import FloatArray
from validation.depth_tests import (
    ALL_MODELS,
    BAND,
    CLOSED_FORM,
    LEFT_OUT,
    METHODS,
    OUTLIER_ROW,
    POWER_LAW,
    TRAJECTORY,
    Agreement,
    Assessment,
    PublishedStrike,
    agreement,
    every,
    of_series,
    percent,
)
from validation.report import Comparison, Figure, ReportTable, Section

MARKS = ("o", "s", "^", "D", "v", "P")
COLORS = (style.MODEL, style.FINITE_ELEMENT, style.PAPER, "#8a4fae")
DEPTHS = (0.12, 4.0)
"""Limits of the depth axes. [m]"""


def depth_figure(assessment: Assessment, factor_model: str, name: str) -> Figure:
    """Draw predicted against measured depth, and their ratio against velocity, for each method in `METHODS`."""
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
    """Draw a mark for each counted test, by series, and a cross for each test that is not counted."""
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
"""Series for which the reference values below, for the ratio of predicted to measured depth by the closed form with
S = 82.6 f'c^−0.544, were set before the comparison was made."""
MEAN_RATIO, MEAN_RATIO_TOLERANCE = 1.02, 0.03
VARIATION, VARIATION_TOLERANCE = 0.08, 0.02
FIGURE_NAMES = ("power-law-82.6", "power-law-72", "constant-8.52", "leave-one-out")


def ratios_section(assessment: Assessment) -> Section:
    """Return the section on ratios of predicted to measured depth, for every choice of S and both methods."""
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
        tables=(_ratio_table(assessment),),
        figures=figures,
    )


def agreement_1994(assessment: Assessment, method: str) -> Agreement:
    """Return the agreement for the 1994 series with S = 82.6 f'c^−0.544."""
    return assessment.agreement(method, POWER_LAW, of_series(SERIES))


def _reading(assessment: Assessment) -> str:
    """Return the text that compares the expected mean ratio with the results of three definitions of the ratio."""
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


def _ratio_table(assessment: Assessment) -> ReportTable:
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

    return ReportTable(name="agreement", caption=caption, columns=columns, rows=rows)


FASTEST = 1300.0
"""Upper end of the velocity axis. [m/s]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class CraterDifference:
    """Closed-form depth minus depth by the trajectory model, for the counted tests with one nose and diameter."""

    diameter: float
    """Diameter of the projectiles. [m]"""
    caliber_radius_head: float
    static: float
    """Difference without inertia, which is the same at every speed and strength. [m]"""
    strikes: Sequence[PublishedStrike]
    differences: FloatArray
    """Difference for each test. [m]"""

    @property
    def extent(self) -> str:
        """Range of the differences, as text."""
        return f"{self.differences.min() * 1e3:.1f} to {self.differences.max() * 1e3:.1f} mm"


def static_difference(projectile: Projectile) -> float:
    """Return the closed-form depth minus the depth by the trajectory model, for a resistance of S f'c only. [m]

    Notes
    -----
    If the resistance acted on the full area A from the face onward, the projectile would stop at m V² / (2 S f'c A). A
    crater two diameters deep, which resists as a linear spring, adds one diameter. The trajectory model loads the part
    of the nose inside the target, which adds the length of the nose minus its volume over A.
    """
    nose = replace(projectile, length=projectile.nose_length, center_of_gravity=None)
    area = math.pi * projectile.radius**2
    return projectile.diameter - (projectile.nose_length - solid_properties(nose).volume / area)


def crater_differences(assessment: Assessment) -> Sequence[CraterDifference]:
    """Return the differences between the two depths for S = 82.6 f'c^−0.544, grouped by diameter and nose."""
    closed, ours = (assessment.predictions[method, POWER_LAW].depths for method in (CLOSED_FORM, TRAJECTORY))
    kinds: dict[tuple[float, float], list[int]] = {}
    for place in assessment.chosen():
        test = assessment.strikes[place].test
        kinds.setdefault((test.diameter, test.caliber_radius_head), []).append(place)
    return [
        CraterDifference(
            diameter=diameter,
            caliber_radius_head=caliber_radius_head,
            static=static_difference(assessment.strikes[places[0]].projectile),
            strikes=[assessment.strikes[place] for place in places],
            differences=(closed - ours)[places],
        )
        for (diameter, caliber_radius_head), places in sorted(kinds.items())
    ]


def crater_section(assessment: Assessment) -> Section:
    """Return the section on the difference between the closed form and the trajectory model."""
    differences = crater_differences(assessment)
    return Section(
        title="The closed form and the trajectory model",
        text=_crater_text(assessment, differences),
        tables=(_crater_table(differences),),
        figures=(_crater_figure(differences),),
    )


def _crater_text(assessment: Assessment, differences: Sequence[CraterDifference]) -> tuple[str, ...]:
    ours, closed = (agreement_1994(assessment, method) for method in (TRAJECTORY, CLOSED_FORM))
    (tested,) = (each for each in differences if each.strikes[0].test.series == SERIES)
    sharpest = max(differences, key=lambda each: each.caliber_radius_head)
    added = np.concatenate([each.differences / each.static - 1.0 for each in differences if each.static > 0.0])
    return (
        (
            f"On {SERIES} with S = {POWER_LAW} the trajectory model has a mean ratio of {ours.mean_ratio:.3f} and "
            f"a coefficient of variation of {ours.coefficient_of_variation:.3f}, the closed form "
            f"{closed.mean_ratio:.3f} and {closed.coefficient_of_variation:.3f}. Once the nose is in, both resist "
            "alike. They differ in how it gets in: the crater of the closed form, two diameters deep, resists as "
            "a linear spring, with half of the full force on average; the trajectory model resists in full from "
            "the tip on, on as much of the nose as is inside."
        ),
        (
            "Were there no inertia, the difference would be one diameter, which the crater saves, less what the "
            "gradual entry of the nose saves, its length less its volume over the area of the shank: a constant "
            "of the projectile, whatever the speed and the concrete. Inertia adds to it, since the crater leaves "
            f"a higher speed than the entry does: {percent(added.min())} at the slowest of the tests, "
            f"{percent(added.max())} at the fastest."
        ),
        (
            f"So the depths differ by nearly a constant, {tested.extent} in {SERIES}, where "
            f"{tested.static * 1e3:.1f} mm follow without inertia. Over these depths it is "
            f"{100.0 * (closed.mean_ratio - ours.mean_ratio):.1f} % on average, and more where the depth is small. "
            f"A nose of ψ {sharpest.caliber_radius_head:g} enters more gradually than two diameters of crater do; "
            f"there the closed form is the shallower, by {-sharpest.differences.max() * 1e3:.1f} to "
            f"{-sharpest.differences.min() * 1e3:.1f} mm."
        ),
        (
            "A strength factor belongs to the model that it was fitted with. Those fitted with the closed form "
            "make the trajectory model somewhat too shallow for most noses; its own, in the table above, are "
            "lower."
        ),
    )


def _crater_table(differences: Sequence[CraterDifference]) -> ReportTable:
    rows = [
        (
            each.diameter * 1e3,
            each.caliber_radius_head,
            len(each.strikes),
            each.static * 1e3,
            float(each.differences.mean()) * 1e3,
            float(each.differences.min()) * 1e3,
            float(each.differences.max()) * 1e3,
            float(each.differences.mean()) / each.diameter,
        )
        for each in differences
    ]
    columns = (
        "d [mm]",
        "ψ",
        "tests",
        "without inertia [mm]",
        "mean [mm]",
        "least [mm]",
        "most [mm]",
        "mean [diameters]",
    )
    caption = f"Depth of the closed form less that of the trajectory model, S = {POWER_LAW}."
    return ReportTable(name="crater", caption=caption, columns=columns, rows=rows)


def _crater_figure(differences: Sequence[CraterDifference]) -> Figure:
    figure, (axes,) = style.panels(1, height=4.0)
    data: dict[str, list[object]] = {
        name: [] for name in ("diameter_m", "caliber_radius_head", "row", "velocity_m_s", "difference_m", "static_m")
    }
    for each, color, mark in zip(differences, style.shades(len(differences)), MARKS, strict=False):
        velocities = [strike.test.velocity for strike in each.strikes]
        label = f"{each.diameter * 1e3:g} mm, ψ {each.caliber_radius_head:g}"
        axes.plot([0.0, FASTEST], [each.static / each.diameter] * 2, color=color, linewidth=1.0)
        axes.plot(velocities, each.differences / each.diameter, mark, color=color, markerfacecolor="none", label=label)
        for row in zip(velocities, each.differences.tolist(), each.strikes, strict=True):
            values = (each.diameter, each.caliber_radius_head, row[2].test.row, *row[:2], each.static)
            for name, value in zip(data, values, strict=True):
                data[name].append(value)
    axes.set(xlabel="striking velocity [m/s]", ylabel="closed form less trajectory [diameters]", xlim=(0.0, FASTEST))
    axes.legend(ncols=3, loc="center right")
    caption = (
        f"Depth of the closed form less that of the trajectory model over velocity, S = {POWER_LAW}. Lines: "
        "without inertia, where the nose alone sets it."
    )
    return Figure(name="crater", caption=caption, figure=figure, data=data)
