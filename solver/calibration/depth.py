"""Strength factor fitted to the depths of tests in normal impact (section 3.1)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver import warnings as model_warnings
from solver.arrays import ComparedByFields, FloatArray
from solver.calibration.strength_factor import (
    Estimate,
    Residuals,
    build_estimate,
    coarse_strengths,
    log_slope,
    minimise,
    require_confidence_level,
    valleys,
)
from solver.checks import ParameterError, require, require_bounds, require_positive, rows_of
from solver.display import Axes, DataFrame, Figure, dataframe, plot_depths
from solver.motion import Run, Termination
from solver.prepared import PreparedCase, integrate, prepare
from solver.projectile import Projectile
from solver.resistance import (
    FIELD,
    ConstantStrengthFactor,
    OwnTests,
    PublishedTests,
    Resistance,
    Shot,
    StrengthPosterior,
    usual_unless_given,
)
from solver.strike import Impact, Numerics
from solver.target import Target
from solver.uncertainty.distributions import LogStudentT
from solver.warnings import ModelWarning

# Depth decreases with S, so the sum of squares has a single minimum in nearly all fits, and a coarse grid finds it.
FIRST_LOOK = 9
"""Number of strength factors on the grid that provides the starting value of a fit."""
# A starting value need not be accurate, so a subset of the tests is enough.
FIRST_TESTS = 20
"""Largest number of tests computed at each strength factor on the grid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthTest:
    """Speed and depth of a test in normal impact.

    Parameters
    ----------
    velocity
        Speed at first contact. [m/s]
    depth
        Greatest depth of the nose tip. [m]
    mass
        Mass of the projectile in this test; by default the mass of the projectile that all tests share. [kg]
    weight
        Weight of the squared residual of this test. [1]
    group
        Name of the group to which the test belongs, if the tests have groups.
    """

    velocity: float
    depth: float
    mass: float | None = None
    weight: float = 1.0
    group: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthFit(ComparedByFields):
    """Strength factor fitted to the depths of tests by least squares."""

    estimate: Estimate
    """Fitted strength factor with its interval."""
    predicted: FloatArray
    """(n,) greatest depths of the nose tip at the fitted S. [m]"""
    residuals: FloatArray
    """(n,) measured minus predicted depths. [m]"""
    root_mean_square: float
    """Weighted root mean square of the residuals. [m]"""
    groups: Mapping[str, "DepthFit"]
    """Fits of the groups with two or more tests, by name; empty if the tests have no groups."""
    posterior: LogStudentT
    """Posterior distribution of S for the next shot into the same concrete. The published tests are the prior; weights
    of the tests have no effect."""
    resistance: Resistance
    """Resistance of the fit, with the fitted S."""
    warnings: tuple[ModelWarning, ...]
    """Warnings about the tests and the fit."""

    def to_dataframe(self) -> DataFrame:
        """Return measured and predicted depths and residuals as a ``pandas.DataFrame``, with a row for each test."""
        measured = self.predicted + self.residuals
        columns = {"depth": measured, "predicted": self.predicted, "residuals": self.residuals}
        return dataframe(columns, DepthTest, DepthFit)

    def plot(self, *, ax: "Axes | None" = None) -> Figure:
        """Plot measured against predicted depths, in a new pyplot figure unless axes are given; return the figure."""
        error = "" if math.isnan(self.estimate.standard_error) else f" ± {self.estimate.standard_error:.2g}"
        title = f"S = {self.estimate.strength_factor:.3g}{error}"
        return plot_depths(self.predicted, self.predicted + self.residuals, title, ax)


class _Shots:
    """Normal impacts of a projectile on a target, with a prepared case for each mass of the projectile."""

    def __init__(
        self, projectile: Projectile, target: Target, resistance: Resistance | None, numerics: Numerics | None
    ) -> None:
        self.projectile, self.target = projectile, target
        self.resistance = usual_unless_given(resistance)
        self.numerics = (numerics or Numerics()).resolved()
        self.shots: dict[float, PreparedCase] = {}

    def run(self, velocity: float, mass: float | None, strength_factor: float) -> Run:
        key = self.projectile.mass if mass is None else mass
        if key not in self.shots:
            self.shots[key] = prepare(
                projectile=replace(self.projectile, mass=key),
                target=self.target,
                resistance=self.resistance,
                numerics=self.numerics,
            )
        law = replace(self.resistance, strength_factor=ConstantStrengthFactor(value=strength_factor))
        prepared, impact = replace(self.shots[key], resistance=law), Impact(velocity=velocity, oblique_angle=0.0)
        run, _ = integrate(prepared, prepared.model._replace(law=prepared.law_at(impact)), impact, keep_steps=False)
        return run

    def runs(self, tests: Sequence[DepthTest], strength_factor: float) -> list[Run]:
        return [self.run(test.velocity, test.mass, strength_factor) for test in tests]

    def depths(self, tests: Sequence[DepthTest], strength_factor: float) -> FloatArray:
        """Return the greatest depth in each of several tests. [m]"""
        return np.array([run.maximum_depth for run in self.runs(tests, strength_factor)])


def penetration_depths(
    *,
    projectile: Projectile,
    target: Target,
    velocities: Sequence[float] | FloatArray,
    strength_factor: float,
    masses: Sequence[float] | FloatArray | None = None,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
) -> FloatArray:
    """Compute the greatest depth of the nose tip in normal impact for several velocities.

    Parameters
    ----------
    projectile, target
        Projectile and concrete.
    velocities
        (n,) speeds at first contact. [m/s]
    strength_factor
        Strength factor S, the same for all velocities. [1]
    masses
        (n,) masses of the projectiles, if they differ from the mass of `projectile`. [kg]
    resistance
        Inertia factor and decay; its strength factor is not used.
    numerics
        Integration method and resolution; adaptive unless given.

    Returns
    -------
    (n,) array
        Greatest depths. [m]

    Raises
    ------
    ParameterError
        If an input is outside its range.
    """
    for index, velocity in enumerate(velocities):
        require_positive(f"velocities.{index}", velocity)
    if masses is not None:
        require(
            len(masses) == len(velocities),
            "masses",
            f"must be as many as the velocities, {len(velocities)}, got {len(masses)}",
        )
        for index, mass in enumerate(masses):
            require_positive(f"masses.{index}", mass)
    require_positive("strength_factor", strength_factor)
    shots = _Shots(projectile, target, resistance, numerics)
    each = [None] * len(velocities) if masses is None else [float(mass) for mass in masses]
    runs = [shots.run(float(velocity), mass, strength_factor) for velocity, mass in zip(velocities, each, strict=True)]
    return np.array([run.maximum_depth for run in runs])


def fit_depth(
    *,
    projectile: Projectile,
    target: Target,
    tests: "Sequence[DepthTest] | DataFrame",
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    confidence_level: float = 0.95,
) -> DepthFit:
    """Fit the strength factor to depths of tests in normal impact by weighted least squares.

    Parameters
    ----------
    projectile, target
        Projectile and concrete, shared by the tests.
    tests
        One or more tests, or a DataFrame with the fields of `DepthTest` as columns. If one test names a group, all
        tests must; each group of two or more tests then has its own fit, in addition to the common one.
    resistance
        Inertia factor and decay; its strength factor is not used.
    numerics
        Integration method and resolution; adaptive unless given.
    confidence_level
        Confidence level of the interval. [1]

    Returns
    -------
    DepthFit

    Raises
    ------
    ParameterError
        If a test is outside its range, or the tests do not determine the strength factor.

    Notes
    -----
    The method is that of section 3.1 of the source paper. The standard error follows from the derivatives of the depths
    with respect to S and the scatter of the residuals, and the interval from Student's distribution. The interval
    covers the scatter of the tests, but no error that all of them share. Two tests may agree by chance, and would then
    seem exact. The scatter within the series of published tests is therefore included, with the weight of
    `PublishedTests.degrees_of_freedom` additional tests.

    Examples
    --------
    >>> fit = fit_depth(
    ...     projectile=projectile,
    ...     target=target,
    ...     tests=[DepthTest(velocity=238.1, depth=0.30), DepthTest(velocity=314.0, depth=0.45)],
    ... )
    >>> fit.estimate.strength_factor, fit.estimate.confidence_interval
    """
    require_confidence_level(confidence_level)
    tests = rows_of("tests", tests, DepthTest)
    _check(tests, target)
    shots = _Shots(projectile, target, resistance, numerics)
    common = _fit(tests, shots, confidence_level)
    members: dict[str, list[DepthTest]] = {}
    for test in tests:
        if test.group is not None:
            members.setdefault(test.group, []).append(test)
    groups = {name: _fit(group, shots, confidence_level) for name, group in members.items() if len(group) > 1}
    alone = tuple(model_warnings.group_of_one(name) for name, group in members.items() if len(group) == 1)
    return replace(common, groups=groups, warnings=common.warnings + alone)


def _check(tests: Sequence[DepthTest], target: Target) -> None:
    require(len(tests) >= 1, "tests", "must be at least one")
    grouped = [test.group is not None for test in tests]
    for index, test in enumerate(tests):
        field = f"tests.{index}"
        require_bounds(f"{field}.velocity", test.velocity, "impact.velocity")
        require_bounds(f"{field}.depth", test.depth, "shot.depth")
        stopped = target.thickness is None or test.depth < target.thickness
        require(stopped, f"{field}.depth", "must be less than the thickness: a perforated target shows no depth")
        require_positive(f"{field}.weight", test.weight)
        if test.mass is not None:
            require_bounds(f"{field}.mass", test.mass, "projectile.mass")
        require(grouped[index] or not any(grouped), f"{field}.group", "must be given, since other tests have one")


def _fit(tests: Sequence[DepthTest], shots: _Shots, confidence_level: float) -> DepthFit:
    measured = np.array([test.depth for test in tests])
    weights = np.array([test.weight for test in tests])
    roots = np.sqrt(weights / weights.mean())

    def residuals(strength_factor: float) -> FloatArray:
        weighted: FloatArray = roots * (measured - shots.depths(tests, strength_factor))
        return weighted

    few = slice(None, None, 1 + len(tests) // FIRST_TESTS)
    start = _first_look(lambda factor: roots[few] * (measured[few] - shots.depths(tests[few], factor)))
    best = minimise(residuals, start, "tests")
    slope = log_slope(residuals, best)
    runs = shots.runs(tests, best)
    predicted = np.array([run.maximum_depth for run in runs])
    misses = measured - predicted
    posterior = _posterior(tests, shots)
    return DepthFit(
        estimate=_estimate(best, roots * misses, slope, confidence_level),
        predicted=predicted,
        residuals=misses,
        root_mean_square=math.sqrt(float(np.average(misses**2, weights=weights))),
        groups={},
        resistance=replace(shots.resistance, strength_factor=ConstantStrengthFactor(value=best)),
        posterior=LogStudentT(
            median=posterior.median, scale=posterior.scale, degrees_of_freedom=posterior.degrees_of_freedom
        ),
        warnings=_warnings(tests, runs, shots) + model_warnings.own_tests_apart(posterior),
    )


def _estimate(best: float, misses: FloatArray, slope: FloatArray, confidence_level: float) -> Estimate:
    """Return the estimate of S, given the weighted residuals [m] and their derivatives with respect to ln S [m].

    The scatter within the series of published tests is the prior of the residual variance.
    """
    count, prior = len(misses), PublishedTests.degrees_of_freedom
    if count == 1:
        return Estimate(
            strength_factor=best,
            standard_error=math.nan,
            confidence_interval=(math.nan, math.nan),
            confidence_level=confidence_level,
            degrees_of_freedom=0.0,
        )
    squared = float(slope @ slope)
    usual = PublishedTests.within_series**2 * squared / count
    freedom = prior + count - 1.0
    variance = (prior * usual + float(misses @ misses)) / freedom
    return build_estimate(
        strength_factor=best,
        standard_error=best * math.sqrt(variance / squared),
        degrees_of_freedom=freedom,
        confidence_level=confidence_level,
    )


def _posterior(tests: Sequence[DepthTest], shots: _Shots) -> StrengthPosterior:
    own = [Shot(velocity=test.velocity, depth=test.depth, mass=test.mass) for test in tests]
    try:
        return OwnTests(shots=tuple(own)).posterior(
            target=shots.target,
            projectile=shots.projectile,
            inertia_factor=shots.resistance.inertia_factor,
            crater=shots.resistance.crater,
        )
    except ParameterError as error:
        raise error.at(error.field.replace(f"{FIELD}.shots", "tests")) from None


def _first_look(residuals: Residuals) -> float:
    """Return the strength factor with the least sum of squares on a coarse grid, where the fit starts. [1]"""
    strengths = coarse_strengths(FIRST_LOOK)
    costs = np.array([float(np.sum(residuals(float(value)) ** 2)) for value in strengths])
    _, start, _ = valleys(strengths, costs)[0]
    return start


def _warnings(tests: Sequence[DepthTest], runs: Sequence[Run], shots: _Shots) -> tuple[ModelWarning, ...]:
    found = list(model_warnings.range_warnings(target=shots.target, velocity=max(test.velocity for test in tests)))
    masses = [shots.projectile.mass if test.mass is None else test.mass for test in tests]
    bodies = [replace(shots.projectile, mass=mass) for mass in (min(masses), max(masses))]
    found += dict.fromkeys(warning for body in bodies for warning in model_warnings.body_warnings(body))
    found += model_warnings.shallow_shots(
        depths=[test.depth for test in tests], diameters=[shots.projectile.diameter] * len(tests)
    )
    if any(run.end == Termination.TIME for run in runs):
        found.append(model_warnings.undecided(termination_time=shots.numerics.termination_time))
    return tuple(found)
