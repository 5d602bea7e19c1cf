"""Predicted against measured depth, in numbers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from service.reports.contents import Tell
from service.reports.reference import penetration_tests
from service.reports.validation.predictions import (
    METHODS,
    TRAJECTORY,
    Prediction,
    Strike,
    depth_curve,
    exact_factor,
    fit_factor,
    predict,
    strikes,
)
from solver.arrays import FloatArray

BAND = 0.2
"""Distance of the lines in the figures, on either side. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How predicted over measured depth is spread over some tests."""

    number: int
    mean_ratio: float
    """[1]"""
    coefficient_of_variation: float
    """Sample standard deviation, with n - 1, over the mean. [1]"""
    within_band: int
    """Tests with a ratio of 1 ± `BAND`."""


def agreement(ratios: FloatArray) -> Agreement:
    """Mean, spread and number of some ratios."""
    mean = float(ratios.mean())
    return Agreement(
        number=len(ratios),
        mean_ratio=mean,
        coefficient_of_variation=float(ratios.std(ddof=1)) / mean,
        within_band=int(np.sum(np.abs(ratios - 1.0) <= BAND)),
    )


Choice: TypeAlias = Callable[[Strike], bool]
"""Choice of tests."""


def every(_: Strike) -> bool:
    """Choose all tests."""
    return True


def of_series(series: str) -> Choice:
    """Choose the tests of one series."""
    return lambda strike: strike.test.series == series


def of_group(group: str) -> Choice:
    """Choose the tests of one series and grade of concrete."""
    return lambda strike: strike.group == group


def of_diameter(diameter: float) -> Choice:
    """Choose the tests of one calibre. [m]"""
    return lambda strike: strike.test.diameter == diameter


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """All tests, and every prediction of their depths."""

    strikes: Sequence[Strike]
    predictions: Mapping[tuple[str, str], Prediction]
    """By method and choice of the strength factor."""
    group_factors: Mapping[tuple[str, str], float]
    """Strength factor fitted to all counted tests of a group, by method and group. [1]"""
    exact_factors: FloatArray
    """Strength factor of each test with which the trajectory model meets its depth; nan for none. [1]"""

    @property
    def measured(self) -> FloatArray:
        """Depth of each test. [m]"""
        return np.array([strike.test.depth for strike in self.strikes])

    def ratios(self, method: str, factor_model: str) -> FloatArray:
        """Predicted over measured depth of each test, counted or not. [1]"""
        return self.predictions[method, factor_model].depths / self.measured

    def chosen(self, choice: Choice = every) -> list[int]:
        """Places of the tests that are counted and chosen."""
        return [place for place, strike in enumerate(self.strikes) if strike.counted and choice(strike)]

    def agreement(self, method: str, factor_model: str, choice: Choice = every) -> Agreement:
        """Statistics of the tests that are counted and chosen."""
        return agreement(self.ratios(method, factor_model)[self.chosen(choice)])

    @property
    def series(self) -> list[str]:
        """Names, oldest first."""
        return sorted({strike.test.series for strike in self.strikes}, key=lambda name: name[-4:])

    @property
    def groups(self) -> list[str]:
        """Names, in the order of the series."""
        return sorted({strike.group for strike in self.strikes}, key=lambda name: (name.split(",")[0][-4:], name))


def percent(share: float) -> str:
    """A share as text."""
    return f"{100.0 * share:.0f} %"


def assess(tell: Tell) -> Assessment:
    """Compute every depth."""
    prepared = strikes(penetration_tests())
    predictions: dict[tuple[str, str], Prediction] = {}
    group_factors: dict[tuple[str, str], float] = {}
    exact = np.full(len(prepared), np.nan)
    for method in METHODS:
        tell(f"depths by the {method}")
        curves = [depth_curve(strike, method) for strike in prepared]
        for prediction in predict(prepared, method, curves):
            predictions[method, prediction.factor_model] = prediction
        if method == TRAJECTORY:
            exact = np.array([exact_factor(*pair) for pair in zip(prepared, curves, strict=True)])
        for group in {strike.group for strike in prepared}:
            group_factors[method, group] = fit_factor(
                [
                    (strike.test.depth, curve)
                    for strike, curve in zip(prepared, curves, strict=True)
                    if strike.counted and strike.group == group
                ]
            )
    return Assessment(strikes=prepared, predictions=predictions, group_factors=group_factors, exact_factors=exact)
