"""A law of S over strength and diameter, and its predictions for tests that it was not fitted to."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.reports.validation.assessment import Assessment
from service.reports.validation.predictions import Strike, trajectory_depth
from solver import Resistance, StrengthPowerLaw, strength_factor
from solver.arrays import FloatArray

REFERENCE_STRENGTH, REFERENCE_DIAMETER = 39e6, 0.0762
"""Where the law has its coefficient. [Pa, m]"""
RIGID_UP_TO = 900.0
"""Tests above this speed, where noses erode, are predicted but not fitted to. [m/s]"""
VARIABLES: Mapping[str, tuple[Callable[[Strike], float], float]] = {
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

    def factor(self, strike: Strike) -> float:
        """Strength factor of a test. [1]"""
        resistance = Resistance(strength_factor=self.model)
        return strength_factor(
            resistance=resistance, oblique_angle=0.0, target=strike.target, projectile=strike.projectile
        )


def fit_size_law(strikes: Sequence[Strike], factors: FloatArray, *, diameter: bool = True) -> SizeLaw:
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
