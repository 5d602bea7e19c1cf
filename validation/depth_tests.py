"""Published depth tests, the depths predicted for them, and their agreement."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.optimize import brentq, minimize_scalar

from solver import (
    ConstantStrengthFactor,
    ModelWarning,
    Ogive,
    Projectile,
    Resistance,
    StrengthPowerLaw,
    Target,
    solid_properties,
    strength_factor,
)
from solver.arrays import FloatArray
from solver.calibration import penetration_depths
from solver.resistance import StrengthFactor, closed_form_depth
from solver.warnings import input_warnings
from validation.reference import PenetrationTest, penetration_tests
from validation.report import Progress

OUTLIER_ROW = 55
LIKELY_VELOCITY = 690.0
"""Probable velocity of the test in row `OUTLIER_ROW`, whose 590 m/s seem to be a misprint. [m/s]"""
STEEL_DENSITY = 7850.0
"""Density of steel. [kg/m³]"""
NEXT_GRADE = 1.25
"""Ratio of a strength to the next lower strength of its series, above which a new grade of concrete begins. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedStrike:
    """A published test, with the inputs of the solver for it."""

    test: PenetrationTest
    projectile: Projectile
    target: Target
    group: str
    """Series and grade of concrete, within which one strength factor is fitted."""
    flags: tuple[ModelWarning, ...]
    """Warnings of the model, except the warning about assumed mass properties."""

    @property
    def counted(self) -> bool:
        """Whether the test is used in fits and statistics."""
        return self.test.row != OUTLIER_ROW


def strikes(tests: Sequence[PenetrationTest]) -> tuple[PublishedStrike, ...]:
    """Return the solver inputs for every test, in the given order."""
    groups = grades(tests)
    return tuple(_strike(test, group) for test, group in zip(tests, groups, strict=True))


def grades(tests: Sequence[PenetrationTest]) -> list[str]:
    """Return series and grade of concrete of each test.

    Strengths of a series belong to one grade as long as each is at most `NEXT_GRADE` times the next lower one.
    """
    names: dict[tuple[str, float], str] = {}
    for series in dict.fromkeys(test.series for test in tests):
        grade: list[float] = []
        for strength in sorted({test.compressive_strength for test in tests if test.series == series}):
            if grade and strength > NEXT_GRADE * grade[-1]:
                grade = []
            grade.append(strength)
            names |= {(series, member): f"{series}, {_range(grade)} MPa" for member in grade}
    return [names[test.series, test.compressive_strength] for test in tests]


def _range(strengths: Sequence[float]) -> str:
    lowest, highest = (f"{strength / 1e6:.3g}" for strength in (strengths[0], strengths[-1]))
    return lowest if lowest == highest else f"{lowest} to {highest}"


def _strike(test: PenetrationTest, group: str) -> PublishedStrike:
    projectile = _projectile(test)
    target = Target(compressive_strength=test.compressive_strength, density=test.density)
    warnings = input_warnings(projectile=projectile, target=target, velocity=test.velocity, angle_of_attack=0.0)
    # Assumed mass properties have no effect, since the projectile does not turn.
    flags = tuple(warning for warning in warnings if warning.code != "mass_properties_assumed")
    return PublishedStrike(test=test, projectile=projectile, target=target, group=group, flags=flags)


def _projectile(test: PenetrationTest) -> Projectile:
    """Return the projectile of a test. If its length is unknown, a solid steel body of the same mass is assumed."""
    nose = Ogive(caliber_radius_head=test.caliber_radius_head)
    nose_length = nose.length(test.diameter / 2.0)
    body = Projectile(nose=nose, diameter=test.diameter, length=test.length or nose_length, mass=test.mass)
    if test.length is not None:
        return body
    shank_volume = test.mass / STEEL_DENSITY - solid_properties(body).volume
    return replace(body, length=nose_length + shank_volume / (math.pi * body.radius**2))


FIT_RANGE = (3.0, 15.0)
"""Range of the search for the best strength factor. [1]"""
CURVE_DEGREE = 6
"""Degree of the polynomial that approximates ln depth as a function of ln S in a fit, with a relative error of the
depth below 10⁻⁶."""

DepthCurve: TypeAlias = Callable[[float], float]
"""Function of the strength factor that returns the depth of the nose tip. [m]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """Depths of all tests with one choice of the strength factor and one method."""

    factor_model: str
    method: str
    factors: FloatArray
    """Strength factor of each test. [1]"""
    depths: FloatArray
    """Predicted depth of each test. [m]"""


TRAJECTORY, CLOSED_FORM = "trajectory model", "closed form"
POWER_LAW, SQUARE_ROOT, CONSTANT, LEFT_OUT = "82.6 f'c^−0.544", "72 f'c^−0.5", "constant 8.52", "leave-one-out"
FACTOR_MODELS: Mapping[str, StrengthFactor] = {
    POWER_LAW: StrengthPowerLaw(coefficient=82.6, exponent=-0.544),
    SQUARE_ROOT: StrengthPowerLaw(coefficient=72.0, exponent=-0.5),
    CONSTANT: ConstantStrengthFactor(value=8.52),
}
"""Choices of S: correlations of Frew et al. (1998) and of Li and Chen (2003), and the paper's value at 0°."""
ALL_MODELS = (POWER_LAW, SQUARE_ROOT, CONSTANT, LEFT_OUT)


def trajectory_depth(strike: PublishedStrike, factor: float) -> float:
    """Return the greatest depth of the nose tip by the trajectory model. [m]"""
    depths = penetration_depths(
        projectile=strike.projectile,
        target=strike.target,
        velocities=[strike.test.velocity],
        strength_factor=factor,
    )
    return float(depths[0])


def crater_depth(strike: PublishedStrike, factor: float) -> float:
    """Return the depth by the closed form with a crater two diameters deep. [m]"""
    return closed_form_depth(
        projectile=strike.projectile,
        target=strike.target,
        velocity=strike.test.velocity,
        strength_factor=factor,
    )


METHODS: Mapping[str, Callable[[PublishedStrike, float], float]] = {
    TRAJECTORY: trajectory_depth,
    CLOSED_FORM: crater_depth,
}


def predict(strikes: Sequence[PublishedStrike], method: str, curves: Sequence[DepthCurve]) -> list[Prediction]:
    """Predict all depths with one method, for every choice of S; `curves` are the depth curves of the strikes."""
    depth = METHODS[method]
    found = [
        Prediction(
            factor_model=name,
            method=method,
            factors=(factors := model_factors(strikes, model)),
            depths=np.array([depth(*pair) for pair in zip(strikes, factors.tolist(), strict=True)]),
        )
        for name, model in FACTOR_MODELS.items()
    ]
    factors = leave_one_out(strikes, curves)
    depths = np.array([curve(factor) for curve, factor in zip(curves, factors.tolist(), strict=True)])
    return [*found, Prediction(factor_model=LEFT_OUT, method=method, factors=factors, depths=depths)]


def model_factors(strikes: Sequence[PublishedStrike], model: StrengthFactor) -> FloatArray:
    """Return the strength factor of each strike by a law of S. [1]"""
    resistance = Resistance(strength_factor=model)
    return np.array(
        [
            strength_factor(resistance=resistance, oblique_angle=0.0, target=each.target, projectile=each.projectile)
            for each in strikes
        ]
    )


def depth_curve(strike: PublishedStrike, method: str) -> DepthCurve:
    """Return depth as a function of S, approximated by a polynomial for ln depth in ln S.

    The polynomial is computed from `CURVE_DEGREE` + 1 depths, so a fit needs no further ones.
    """
    depth = METHODS[method]

    def logarithms(factors: FloatArray) -> FloatArray:
        return np.array([math.log(depth(strike, math.exp(factor))) for factor in factors.tolist()])

    domain = [math.log(factor) for factor in FIT_RANGE]
    curve = Chebyshev.interpolate(logarithms, CURVE_DEGREE, domain=domain)
    return lambda factor: math.exp(float(curve(math.log(factor))))


def leave_one_out(strikes: Sequence[PublishedStrike], curves: Sequence[DepthCurve]) -> FloatArray:
    """Return the strength factor of each strike, fitted to the other counted strikes of its group. [1]"""
    factors = []
    for index, strike in enumerate(strikes):
        others = [
            (other.test.depth, curve)
            for place, (other, curve) in enumerate(zip(strikes, curves, strict=True))
            if place != index and other.counted and other.group == strike.group
        ]
        factors.append(fit_factor(others))
    return np.array(factors)


def fit_factor(measured: Sequence[tuple[float, DepthCurve]]) -> float:
    """Return the strength factor with the least sum of squared differences between depths. [1]"""

    def squares(factor: float) -> float:
        return sum((curve(factor) - depth) ** 2 for depth, curve in measured)

    return float(minimize_scalar(squares, bounds=FIT_RANGE, method="bounded", options={"xatol": 1e-7}).x)


def exact_factor(strike: PublishedStrike, curve: DepthCurve) -> float:
    """Return the strength factor that gives the measured depth of a test; nan if none in `FIT_RANGE` does. [1]"""

    def difference(factor: float) -> float:
        return curve(factor) - strike.test.depth

    if difference(FIT_RANGE[0]) * difference(FIT_RANGE[1]) > 0.0:
        return math.nan
    return float(brentq(difference, *FIT_RANGE))


BAND = 0.2
"""Deviation of a ratio from 1 within which `Agreement` counts it; the figures mark this band. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Statistics of the ratio of predicted to measured depth over a set of tests."""

    number: int
    mean_ratio: float
    """Mean ratio of predicted to measured depth. [1]"""
    coefficient_of_variation: float
    """Sample standard deviation, with n - 1, divided by the mean. [1]"""
    within_band: int
    """Number of tests whose ratio differs from 1 by at most `BAND`."""


def agreement(ratios: FloatArray) -> Agreement:
    """Return the statistics of ratios of predicted to measured depth."""
    mean = float(ratios.mean())
    return Agreement(
        number=len(ratios),
        mean_ratio=mean,
        coefficient_of_variation=float(ratios.std(ddof=1)) / mean,
        within_band=int(np.sum(np.abs(ratios - 1.0) <= BAND)),
    )


Choice: TypeAlias = Callable[[PublishedStrike], bool]
"""Predicate that selects tests for statistics."""


def every(_: PublishedStrike) -> bool:
    """Select every test."""
    return True


def of_series(series: str) -> Choice:
    """Return a predicate that selects the tests of one series."""
    return lambda strike: strike.test.series == series


def of_group(group: str) -> Choice:
    """Return a predicate that selects the tests of one series and grade of concrete."""
    return lambda strike: strike.group == group


def of_diameter(diameter: float) -> Choice:
    """Return a predicate that selects the tests with projectiles of one diameter. [m]"""
    return lambda strike: strike.test.diameter == diameter


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """All tests, with the predictions of their depths and the fitted strength factors."""

    strikes: Sequence[PublishedStrike]
    predictions: Mapping[tuple[str, str], Prediction]
    """Predictions by method and choice of the strength factor."""
    group_factors: Mapping[tuple[str, str], float]
    """Strength factor fitted to all counted tests of a group, by method and group. [1]"""
    exact_factors: FloatArray
    """Strength factor with which the trajectory model gives the measured depth, by test; nan if there is none. [1]"""

    @property
    def measured(self) -> FloatArray:
        """Measured depth of each test. [m]"""
        return np.array([strike.test.depth for strike in self.strikes])

    def ratios(self, method: str, factor_model: str) -> FloatArray:
        """Return the ratio of predicted to measured depth of each test, counted or not. [1]"""
        return self.predictions[method, factor_model].depths / self.measured

    def chosen(self, choice: Choice = every) -> list[int]:
        """Return the indices of the counted tests that `choice` selects."""
        return [place for place, strike in enumerate(self.strikes) if strike.counted and choice(strike)]

    def agreement(self, method: str, factor_model: str, choice: Choice = every) -> Agreement:
        """Return the statistics of the counted tests that `choice` selects."""
        return agreement(self.ratios(method, factor_model)[self.chosen(choice)])

    @property
    def series(self) -> list[str]:
        """Names of the series, oldest first."""
        return sorted({strike.test.series for strike in self.strikes}, key=lambda name: name[-4:])

    @property
    def groups(self) -> list[str]:
        """Names of the groups, in the order of the series."""
        return sorted({strike.group for strike in self.strikes}, key=lambda name: (name.split(",")[0][-4:], name))


def percent(share: float) -> str:
    """Return a fraction as text in percent."""
    return f"{100.0 * share:.0f} %"


def assess(progress: Progress) -> Assessment:
    """Compute all predictions and fits."""
    prepared = strikes(penetration_tests())
    predictions: dict[tuple[str, str], Prediction] = {}
    group_factors: dict[tuple[str, str], float] = {}
    exact = np.full(len(prepared), np.nan)
    for method in METHODS:
        progress(f"depths by the {method}")
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
