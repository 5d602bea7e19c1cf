"""A law of S over strength and diameter, and what it is worth for a series that it has not seen."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from service.reports import style
from solver import PublishedTests, Resistance, StrengthPowerLaw, strength_factor
from solver.arrays import FloatArray
from validation.depth_ratios import COLORS, MARKS
from validation.depth_tests import (
    CONSTANT,
    POWER_LAW,
    TRAJECTORY,
    Assessment,
    PublishedStrike,
    agreement,
    percent,
    trajectory_depth,
)
from validation.report import Comparison, Figure, ReportTable, Section

REFERENCE_STRENGTH, REFERENCE_DIAMETER = 39e6, 0.0762
"""Strength and diameter at which S is the coefficient of the law. [Pa, m]"""
RIGID_UP_TO = 900.0
"""Tests above this speed, where noses erode, are predicted but not fitted to. [m/s]"""
VARIABLES: Mapping[str, tuple[Callable[[PublishedStrike], float], float]] = {
    "speed [m/s]": (lambda strike: strike.test.velocity, 1.0),
    "f'c [MPa]": (lambda strike: strike.test.compressive_strength, 1e-6),
    "diameter [mm]": (lambda strike: strike.test.diameter, 1e3),
}
"""What the residual may depend on, and its unit of the drawings."""
LARGE = "all of 76.2 mm"


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeLaw:
    """A fitted law ``S = c (f'c / 39 MPa)^a (d / 76.2 mm)^b``, with b = 0 if the diameter is left out."""

    model: StrengthPowerLaw
    standard_errors: tuple[float, ...]
    """Standard errors of ln c, a and, with the diameter, b."""

    def factor(self, strike: PublishedStrike) -> float:
        """Strength factor of a test. [1]"""
        resistance = Resistance(strength_factor=self.model)
        return strength_factor(
            resistance=resistance, oblique_angle=0.0, target=strike.target, projectile=strike.projectile
        )


def fit_size_law(strikes: Sequence[PublishedStrike], factors: FloatArray, *, diameter: bool = True) -> SizeLaw:
    """Fit a law by ordinary least squares between the logarithms.

    Parameters
    ----------
    strikes
        The tests.
    factors
        (n,) strength factor with which the model meets the depth of each exactly. [1]
    diameter
        Whether S depends on the diameter.
    """
    columns = [
        np.ones(len(strikes)),
        np.log([strike.test.compressive_strength / REFERENCE_STRENGTH for strike in strikes]),
    ]
    if diameter:
        columns.append(np.log([strike.test.diameter / REFERENCE_DIAMETER for strike in strikes]))
    matrix, values = np.column_stack(columns), np.log(factors)
    solution = np.linalg.lstsq(matrix, values, rcond=None)[0]
    variance = float(np.sum((values - matrix @ solution) ** 2)) / (len(strikes) - len(columns))
    errors = np.sqrt(np.diagonal(np.linalg.inv(matrix.T @ matrix)) * variance)
    return SizeLaw(
        model=StrengthPowerLaw(
            coefficient=math.exp(solution[0]),
            exponent=float(solution[1]),
            reference_strength=REFERENCE_STRENGTH,
            diameter_exponent=float(solution[2]) if diameter else 0.0,
            reference_diameter=REFERENCE_DIAMETER,
        ),
        standard_errors=tuple(map(float, errors)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """Tests that a law was not fitted to, and what it predicts for them."""

    name: str
    places: Sequence[int]
    """Indices of the tests among all."""
    law: SizeLaw
    diameter: bool
    ratios: FloatArray
    """Predicted over measured depth. [1]"""
    slow: FloatArray
    """Scatter of those up to 900 m/s. [1]"""


def leave_out(assessment: Assessment, *, diameter: bool) -> list[LeftOut]:
    """Fit on all other series and predict each series; at last on all smaller and predict the largest projectiles."""
    groups = {
        series: [place for place in assessment.chosen() if assessment.strikes[place].test.series == series]
        for series in assessment.series
    }
    groups[LARGE] = [
        place for place in assessment.chosen() if assessment.strikes[place].test.diameter == REFERENCE_DIAMETER
    ]
    found = []
    for name, places in groups.items():
        law = fit_places(
            assessment, [place for place in fitted_places(assessment) if place not in places], diameter=diameter
        )
        ratios = predicted_ratios(assessment, law, places)
        rigid = [assessment.strikes[place].test.velocity <= RIGID_UP_TO for place in places]
        found.append(
            LeftOut(name=name, places=places, law=law, diameter=diameter, ratios=ratios, slow=ratios[np.array(rigid)])
        )
    return found


def fitted_places(assessment: Assessment) -> list[int]:
    """Places of the tests that laws are fitted to."""
    return [place for place in assessment.chosen() if assessment.strikes[place].test.velocity <= RIGID_UP_TO]


def fit_places(assessment: Assessment, places: Sequence[int], *, diameter: bool) -> SizeLaw:
    """Fit a law to the tests at some places."""
    strikes = [assessment.strikes[place] for place in places]
    return fit_size_law(strikes, assessment.exact_factors[list(places)], diameter=diameter)


def predicted_ratios(assessment: Assessment, law: SizeLaw, places: Sequence[int]) -> FloatArray:
    """Predicted over measured depth of the tests at some places. [1]"""
    strikes = [assessment.strikes[place] for place in places]
    return np.array([trajectory_depth(strike, law.factor(strike)) / strike.test.depth for strike in strikes])


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """How predicted over measured depth goes with one variable: as a power of it."""

    exponent: float
    standard_error: float
    change: float
    """Change of the ratio from the least value of the variable to the greatest. [1]"""


def trend(values: FloatArray, ratios: FloatArray) -> Trend:
    """Fit a power to ratios by least squares between the logarithms."""
    x, y = np.log(values) - np.log(values).mean(), np.log(ratios)
    square = float(x @ x)
    slope = float(x @ y) / square
    scatter = float(np.sum((y - y.mean() - slope * x) ** 2)) / (len(x) - 2)
    return Trend(
        exponent=slope,
        standard_error=math.sqrt(scatter / square),
        change=math.exp(slope * float(np.ptp(x))) - 1.0,
    )


def pooled(found: Sequence[LeftOut]) -> tuple[list[int], FloatArray]:
    """Places and ratios of several groups together."""
    places = [place for each in found for place in each.places]
    return places, np.concatenate([each.ratios for each in found])


def log_scatter(ratios: FloatArray) -> float:
    """Root mean square of the logarithms: how far off a prediction is, bias included. [1]"""
    return math.sqrt(float(np.mean(np.log(ratios) ** 2)))


def trends(assessment: Assessment, places: Sequence[int], ratios: FloatArray) -> list[Trend]:
    """Trend with each variable."""
    strikes = [assessment.strikes[place] for place in places]
    return [trend(np.array([value(strike) for strike in strikes]), ratios) for value, _ in VARIABLES.values()]


PUBLISHED = {
    "coefficient": ("coefficient", PublishedTests.law.coefficient),
    "exponent of the strength": ("exponent", PublishedTests.law.exponent),
    "exponent of the diameter": ("diameter_exponent", PublishedTests.law.diameter_exponent),
}
"""Constants of the law of the solver, which were fitted separately to the same tests. [1]"""
CLOSE = 0.01
"""How near ours have to come to them. [1]"""
TICKS = {"speed [m/s]": (150, 300, 600, 1200), "f'c [MPa]": (25, 50, 100), "diameter [mm]": (20, 30, 50, 75)}
SHORT = ("with diameter", "without diameter")


def size_law_section(assessment: Assessment) -> Section:
    """What a law of strength and diameter is worth for a series that it has not seen."""
    fitted = {
        diameter: fit_places(assessment, fitted_places(assessment), diameter=diameter) for diameter in (True, False)
    }
    left_out = {diameter: leave_out(assessment, diameter=diameter) for diameter in (True, False)}
    series = {diameter: [each for each in found if each.name != LARGE] for diameter, found in left_out.items()}
    return Section(
        title="Strength factor over strength and diameter",
        text=_text(assessment, fitted, left_out),
        comparisons=tuple(
            Comparison(
                what=f"law over strength and diameter, {what}",
                ours=getattr(fitted[True].model, name),
                reference=value,
                unit="1",
                tolerance=CLOSE,
                reference_source="the law `published_tests`, fitted separately to the same tests",
            )
            for what, (name, value) in PUBLISHED.items()
        ),
        tables=(_left_out_table(left_out), _trend_table(assessment, fitted, series)),
        figures=(_figure(assessment, series),),
    )


def _text(
    assessment: Assessment, fitted: Mapping[bool, SizeLaw], left_out: Mapping[bool, Sequence[LeftOut]]
) -> tuple[str, ...]:
    law, places = fitted[True], fitted_places(assessment)
    errors = law.standard_errors
    scatter = {
        diameter: log_scatter(np.concatenate([each.slow for each in found if each.name != LARGE]))
        for diameter, found in left_out.items()
    }
    better = [
        each.name
        for each, plain in zip(left_out[True], left_out[False], strict=True)
        if each.name != LARGE and log_scatter(each.slow) < log_scatter(plain.slow)
    ]
    large = {diameter: agreement(found[-1].ratios) for diameter, found in left_out.items()}
    both = np.log([[getattr(assessment.strikes[place].test, name) for place in places] for name in _CONFOUNDED])
    related = np.corrcoef(both)
    everything = assessment.chosen()
    own = trends(assessment, everything, predicted_ratios(assessment, law, everything))
    unseen = trends(assessment, *pooled([each for each in left_out[True] if each.name != LARGE]))
    of_exact = assessment.exact_factors[places] / [law.factor(assessment.strikes[place]) for place in places]
    return (
        (
            f"S of a test is here the one with which the trajectory model meets its depth exactly. Over the "
            f"{len(places)} counted tests up to {RIGID_UP_TO:g} m/s, least squares between the logarithms give "
            f"**S = {law.model.coefficient:.2f} (f'c / 39 MPa)^{_power(law.model.exponent)} "
            f"(d / 76.2 mm)^{_power(law.model.diameter_exponent)}**, with standard errors of {percent(errors[0])}, "
            f"{errors[1]:.2f} and {errors[2]:.2f}; the exact S are {of_exact.mean():.2f} times it on average, with a "
            f"coefficient of variation of {of_exact.std(ddof=1) / of_exact.mean():.2f}. Without the diameter S would "
            f"hardly depend on anything: {fitted[False].model.coefficient:.2f} (f'c / 39 MPa)^"
            f"{_power(fitted[False].model.exponent)}."
        ),
        (
            "**Leave-one-series-out**: the law is fitted to the other series and predicts the one it has not seen. "
            f"Root mean square of the logarithm of predicted over measured depth, up to {RIGID_UP_TO:g} m/s: "
            f"{scatter[True]:.3f} with the diameter, {scatter[False]:.3f} without. "
            f"{_verdict(scatter, better, law, left_out[True])}"
        ),
        (
            "The reason is in the table of the tests: strength, diameter and size of the target go together. Over the "
            f"tests fitted to, the correlation of the logarithm of the diameter is {_power(related[0, 1])} with that "
            f"of the strength and {_power(related[0, 2])} with that of the diameter of the target. Without "
            "forrestal-1994 no concrete above 60 MPa is left, and both exponents change sign; without forrestal-2003 "
            "the large projectiles met one concrete only. What the law ascribes to the diameter may be the target's."
        ),
        (
            "Trend of predicted over measured depth, as a power of speed, strength and diameter: with the law fitted "
            f"to all series {_powers(own)}{_none_left(own)}; each series left out {_powers(unseen)}. The table has the "
            f"other laws: S = {POWER_LAW} leaves "
            f"{_powers(trends(assessment, everything, assessment.ratios(TRAJECTORY, POWER_LAW)[everything]))}."
        ),
        (
            f"**The largest projectiles are beyond it.** Fitted to diameters up to 30.5 mm, the law gives the "
            f"{large[True].number} tests of 76.2 mm {large[True].mean_ratio:.2f} of their depth, without the diameter "
            f"{large[False].mean_ratio:.2f}. Their S is lower than the smaller ones foretell by any of these laws. "
            "Inside the range of the data the law serves to interpolate; to another size or another series it carries "
            "over with the scatter of the table, not with that of the fit. Another 41 tests, on which the constants "
            "were checked elsewhere (mean ratio 1.02, coefficient of variation 0.16), are not among the data of this "
            "report."
        ),
    )


_CONFOUNDED = ("diameter", "compressive_strength", "target_diameter")


def _verdict(scatter: Mapping[bool, float], better: Sequence[str], law: SizeLaw, found: Sequence[LeftOut]) -> str:
    exponents = [each.law.model.diameter_exponent for each in found if each.name != LARGE]
    named = " and ".join(better) if better else "no series"
    if scatter[True] < scatter[False]:
        return f"The diameter helps, for {named}."
    return (
        f"**On these series the diameter does not help**: a law with it predicts {named} better, the others worse. "
        f"Its exponent, {_power(law.model.diameter_exponent)} from all series, lies between "
        f"{_power(min(exponents))} and {_power(max(exponents))} when one of them is left out."
    )


def _none_left(trends: Sequence[Trend]) -> str:
    small = all(abs(each.exponent) <= 2.0 * each.standard_error for each in trends)
    return ", none beyond two standard errors" if small else ""


def _powers(trends: Sequence[Trend]) -> str:
    texts = [f"{_power(each.exponent)} ± {each.standard_error:.2f}" for each in trends]
    return f"{', '.join(texts[:-1])} and {texts[-1]}"


def _power(value: float) -> str:
    return f"{value:.2f}".replace("-", "\N{MINUS SIGN}")


def _left_out_table(left_out: Mapping[bool, Sequence[LeftOut]]) -> ReportTable:
    rows: list[Sequence[object]] = []
    for diameter, found in left_out.items():
        rows += [_row(each.name, each.law, diameter, each.slow) for each in found]
        slow = np.concatenate([each.slow for each in found if each.name != LARGE])
        rows.append(_row("each series in turn", None, diameter, slow))
    return ReportTable(
        name="leave-one-series-out",
        caption=f"Predicted over measured depth of tests that the law was not fitted to, up to {RIGID_UP_TO:g} m/s, "
        "and the law fitted to the others: S = c (f'c / 39 MPa)^a (d / 76.2 mm)^b.",
        columns=("law", "left out", "c", "a", "b", "tests", "mean", "variation", "rms of ln"),
        rows=rows,
    )


def _row(name: str, law: SizeLaw | None, diameter: bool, ratios: FloatArray) -> tuple[object, ...]:
    constants: tuple[float | None, ...] = (None, None, None)
    if law is not None:
        exponent = round(law.model.diameter_exponent, 2) if diameter else None
        constants = (round(law.model.coefficient, 2), round(law.model.exponent, 2), exponent)
    found = agreement(ratios)
    statistics = (found.mean_ratio, found.coefficient_of_variation, log_scatter(ratios))
    return (
        SHORT[0] if diameter else SHORT[1],
        name,
        *constants,
        found.number,
        *(round(each, 3) for each in statistics),
    )


def _trend_table(
    assessment: Assessment, fitted: Mapping[bool, SizeLaw], series: Mapping[bool, Sequence[LeftOut]]
) -> ReportTable:
    everything = assessment.chosen()
    cases: dict[str, tuple[Sequence[int], FloatArray]] = {}
    for name in (POWER_LAW, CONSTANT):
        cases[f"S = {name}"] = (everything, assessment.ratios(TRAJECTORY, name)[everything])
    for diameter, name in zip((True, False), SHORT, strict=True):
        cases[f"{name}, fitted to all"] = (everything, predicted_ratios(assessment, fitted[diameter], everything))
        cases[f"{name}, series left out"] = pooled(series[diameter])
    rows: list[Sequence[object]] = []
    for name, (places, ratios) in cases.items():
        cells: list[object] = []
        for found in trends(assessment, places, ratios):
            cells += [f"{_power(found.exponent)} ± {found.standard_error:.2f}", float(round(100.0 * found.change))]
        rows.append((name, len(places), *cells))
    columns = [cell for name in ("speed", "f'c", "diameter") for cell in (f"power of {name}", "change [%]")]
    return ReportTable(
        name="residual-trends",
        caption="Trend of predicted over measured depth with one variable at a time, over all counted tests: the power "
        "of the variable that it follows, with its standard error, and the change over the range of the variable.",
        columns=("law", "tests", *columns),
        rows=rows,
    )


def _figure(assessment: Assessment, series: Mapping[bool, Sequence[LeftOut]]) -> Figure:
    figure, panels = style.panels(6, rows=2, height=5.6, sharey=True)
    data: dict[str, list[object]] = {}
    for row, diameter in enumerate((True, False)):
        places, ratios = pooled(series[diameter])
        for axes, (label, (value, unit)) in zip(panels[3 * row :], VARIABLES.items(), strict=False):
            axes.axhline(1.0, color=style.FACE, linewidth=1.0)
            for each, mark, color in zip(series[diameter], MARKS, COLORS, strict=False):
                x = [unit * value(assessment.strikes[place]) for place in each.places]
                axes.plot(x, each.ratios, mark, color=color, markerfacecolor="none", label=each.name)
            values = np.array([value(assessment.strikes[place]) for place in places])
            found = trend(values, ratios)
            ends = np.array([values.min(), values.max()])
            center = np.exp(np.log(ratios).mean())
            line = center * (ends / np.exp(np.log(values).mean())) ** found.exponent
            axes.plot(unit * ends, line, color=style.HINT, linestyle="--", label="trend")
            axes.set(xscale="log", xlabel=label if row else "", ylim=(0.4, 1.9))
            axes.set_title(f"power {_power(found.exponent)} ± {found.standard_error:.2f}")
            _plain_ticks(axes, label)
        panels[3 * row].set_ylabel(f"ratio, {SHORT[row]}")
        for name, column in _data(assessment, series[diameter], SHORT[row]).items():
            data.setdefault(name, []).extend(column)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    caption = (
        "Predicted over measured depth of every counted test, its series left out of the fit, over speed, strength and "
        "diameter: with the diameter in the law (above) and without (below). Broken: the trend over all."
    )
    return Figure(name="size-law", caption=caption, figure=figure, data=data)


def _plain_ticks(axes: Axes, label: str) -> None:
    axes.set_xticks(TICKS[label])
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _data(assessment: Assessment, found: Sequence[LeftOut], law: str) -> dict[str, list[object]]:
    tests = [(each, assessment.strikes[place].test) for each in found for place in each.places]
    return {
        "law": [law] * len(tests),
        "series": [test.series for _, test in tests],
        "row": [test.row for _, test in tests],
        "velocity_m_s": [test.velocity for _, test in tests],
        "compressive_strength_pa": [test.compressive_strength for _, test in tests],
        "diameter_m": [test.diameter for _, test in tests],
        "ratio": pooled(found)[1].tolist(),
    }
