"""Models of the request for a calibration by motion, and the base class of requests that fit a strength factor."""

from typing import Annotated, Any

import numpy as np
from pydantic import MISSING, ConfigDict, Field

import solver
from service.columns import Column
from service.schemas.numerics import Method, Numerics
from service.schemas.quantities import Flag, Num, Of, Part, SolverPart, with_examples
from service.schemas.requests import MOST_ROWS
from service.schemas.resistance import MOHR_COULOMB, Crater, Decay, InertiaFactor, ShearPlug
from service.schemas.strike import PROJECTILE, STRIKE, TARGET, Impact, Projectile, Target
from solver.arrays import FloatArray
from solver.calibration import MotionHistory, MotionRun, Weights
from solver.checks import ParameterError
from solver.strike import TERMINATION_TIME

MOST_COMPARED = 20
"""Largest number of strength factors to compare, an arbitrary choice: more curves cannot be told apart in a plot."""

StrengthFactorValue = Annotated[
    Num, Field(ge=0.1, le=1000.0, description="Strength factor. Most measured ones lie between 5 and 25. [1]")
]
StandardError = Annotated[Num, Field(ge=0.0, description="Standard error of the strength factor. [1]")]
ConfidenceInterval = Annotated[
    list[Num],
    Field(
        min_length=2,
        max_length=2,
        description="Ends of the confidence interval at the requested level, from Student's distribution. [1]",
    ),
]
Residuals = Annotated[list[Num], Field(description="Given minus predicted values, in the order of the request.")]


class CalibrationResistance(SolverPart[solver.Resistance]):
    """Resistance of the target without the strength factor, which is fitted."""

    model_config = with_examples(
        {"inertia_factor": 0.9, "free_surface": MOHR_COULOMB}, {"crater": {"depth_diameters": 2.0}}
    )

    inertia_factor: InertiaFactor = 1.0
    free_surface: Decay
    crater: Crater | MISSING = MISSING
    rear_plug: ShearPlug | MISSING = MISSING


class Calibration(Part):
    """Base class of the requests that fit a strength factor."""

    projectile: Projectile
    target: Target
    resistance: Annotated[CalibrationResistance, Field(default_factory=CalibrationResistance)]
    numerics: Numerics | MISSING = MISSING
    """Method and resolution of the runs. In a fit to motions, each run ends when its history ends."""
    # With a level below one half, an interval is more often wrong than right; the upper bound is arbitrary.
    confidence_level: Annotated[Num, Field(ge=0.5, le=0.9999)] = 0.95
    """Confidence level of the interval of the strength factor. [1]"""
    compare_strength_factors: (
        Annotated[list[StrengthFactorValue], Field(min_length=1, max_length=MOST_COMPARED)] | MISSING
    ) = MISSING
    """Strength factors for which the answer contains predictions, in addition to the fitted one. [1]"""

    def canonical(self) -> dict[str, Any]:
        """Return the request as JSON data, with defaults filled in."""
        return self.model_dump(mode="json")

    def model_arguments(self) -> dict[str, Any]:
        """Return the arguments that the solver's fits and predictions have in common."""
        return {
            "projectile": self.projectile.to_solver(),
            "target": self.target.to_solver(),
            "resistance": self.resistance.to_solver(),
            "numerics": None if self.numerics is MISSING else self.numerics.to_solver(),
        }

    def longest_run(self) -> float:
        """Return the time at which the longest run ends. [s]"""
        end = MISSING if self.numerics is MISSING else self.numerics.termination_time_s
        return TERMINATION_TIME if end is MISSING else end

    def panel_steps(self) -> float:
        """Return the panels times the time steps of the longest run; 0 with the adaptive method. [1]"""
        numerics = self.numerics
        if numerics is MISSING or numerics.method is not Method.PANELS:
            return 0.0
        return numerics.panels * self.longest_run() / numerics.time_step_s

    def compared(self) -> tuple[float, ...]:
        """Return the strength factors to compare."""
        return () if self.compare_strength_factors is MISSING else tuple(self.compare_strength_factors)


class FittedStrength(Part):
    """A fitted strength factor with its standard error."""

    strength_factor: Annotated[Num, Field(gt=0.0), Of("estimate.strength_factor")]
    """Strength factor that fits best. [1]"""
    standard_error: Annotated[StandardError, Of("estimate.standard_error")]
    confidence_interval: Annotated[
        ConfidenceInterval,
        Of("estimate.confidence_interval"),
        Column("confidence_low", "lower end of the confidence interval of the strength factor"),
        Column("confidence_high", "upper end of the confidence interval of the strength factor"),
    ]


COMPARED_ROWS = 1000
"""Largest number of rows of a motion predicted for comparison, enough for a smooth curve in a plot."""
MOST_RUNS = 20
"""Largest number of runs of a calibration by motion. Each run takes three fits, which cost 20 cases each with the
adaptive method, so a request costs up to 1,200 cases."""

AT_30: dict[str, Any] = {
    "time_s": [0.0, 0.0005, 0.001, 0.0015, 0.002, 0.0025],
    "depth_displacement_m": [0.0, 0.098, 0.173, 0.226, 0.252, 0.256],
    "lateral_displacement_m": [0.0, 0.06, 0.111, 0.147, 0.169, 0.173],
    "rotation_deg": [0.0, 1.9, 7.1, 11.0, 11.6, 11.6],
}
"""Motion that the model predicts with a strength factor of 7.91."""
STRIKE_AT_30 = STRIKE | {"oblique_angle_deg": 30.0}

# The time has the bound of a termination time. The other bounds are arbitrary, far beyond any motion in a target.
Time = Annotated[Num, Field(ge=0.0, le=1.0)]
Displacement = Annotated[Num, Field(ge=-1000.0, le=1000.0)]
Rotation = Annotated[Num, Field(ge=-36_000.0, le=36_000.0)]
DisplacementColumn = Annotated[list[Displacement], Field(min_length=2, max_length=MOST_ROWS, fail_fast=True)]


class MotionRecord(SolverPart[MotionHistory]):
    """Motion of a projectile since first contact: columns of equal length, at least one in addition to the time."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [AT_30, {"time_s": [0.0, 0.001], "rotation_deg": [0.0, 7.1]}],
            "minProperties": 2,
        }
    )

    time_s: Annotated[list[Time], Field(min_length=2, max_length=MOST_ROWS, fail_fast=True)]
    """Time since first contact, increasing. [s]"""
    depth_displacement_m: DisplacementColumn | MISSING = MISSING
    """Displacement of the centre of gravity along the inward normal of the face. [m]"""
    lateral_displacement_m: DisplacementColumn | MISSING = MISSING
    """Displacement of the centre of gravity along the face, positive in the direction of travel. [m]"""
    rotation_deg: Annotated[list[Rotation], Field(min_length=2, max_length=MOST_ROWS, fail_fast=True)] | MISSING = (
        MISSING
    )
    """Change of the axis angle, positive if the nose turns toward the face. [°]"""


class MotionWeights(SolverPart[Weights]):
    """Relative weights of the squared residuals of each quantity, which are first divided by its span."""

    model_config = with_examples({"depth": 1.0, "lateral": 1.0, "rotation": 0.5})

    # Only ratios of weights matter, and 0 leaves a quantity out. The upper bound is arbitrary.
    depth: Annotated[Num, Field(ge=0.0, le=1e6)] = 1.0
    """Weight of the displacement along the normal. [1]"""
    lateral: Annotated[Num, Field(ge=0.0, le=1e6)] = 1.0
    """Weight of the displacement along the face. [1]"""
    rotation: Annotated[Num, Field(ge=0.0, le=1e6)] = 1.0
    """Weight of the rotation. [1]"""


Until = Annotated[Num, Field(gt=0.0, le=1.0, description="Time of the last row to fit. [s]")]
UntilGreatestDepth = Annotated[
    Flag, Field(description="Fit the rows up to the greatest depth only. Not allowed together with `until_s`.")
]


class CalibrationRun(Part):
    """One of several strikes that are fitted together. Omitted fields default to the values of the request."""

    model_config = with_examples(
        {"impact": STRIKE_AT_30, "history": AT_30},
        {"impact": STRIKE_AT_30, "history": AT_30, "weights": {"rotation": 0.0}, "until_s": 0.0015},
    )

    impact: Impact
    history: MotionRecord
    weights: MotionWeights | MISSING = MISSING
    until_s: Until | MISSING = MISSING
    until_greatest_depth: UntilGreatestDepth | MISSING = MISSING


class MotionCalibrationRequest(Calibration):
    """Strikes with the motion of the projectile, from measurements or from finite element runs.

    The request has either `impact` and `history` of one strike, or `runs`.
    """

    model_config = with_examples(
        {
            "projectile": PROJECTILE,
            "target": TARGET,
            "impact": STRIKE_AT_30,
            "history": AT_30,
        },
        {
            "projectile": PROJECTILE,
            "target": TARGET,
            "impact": STRIKE_AT_30,
            "history": AT_30,
            "weights": {"rotation": 0.0},
            "until_s": 0.0015,
            "compare_strength_factors": [7.0, 9.0],
        },
        {
            "projectile": PROJECTILE,
            "target": TARGET,
            "runs": [
                {"impact": STRIKE_AT_30, "history": AT_30},
                {"impact": STRIKE_AT_30, "history": AT_30, "until_s": 0.0015},
            ],
        },
    )

    impact: Impact | MISSING = MISSING
    history: MotionRecord | MISSING = MISSING
    runs: Annotated[list[CalibrationRun], Field(min_length=1, max_length=MOST_RUNS)] | MISSING = MISSING
    """Strikes at any angles and speeds, in place of `impact` and `history`. One strength factor is fitted to all of
    them with equal weight."""
    weights: Annotated[MotionWeights, Field(default_factory=MotionWeights)]
    until_s: Until | MISSING = MISSING
    until_greatest_depth: UntilGreatestDepth = False

    def motion_runs(self) -> list[MotionRun]:
        """Return the runs for the solver, each with the rows to fit.

        Raises
        ------
        ParameterError
            If there are no runs, or a single strike is given as well.
        """
        if self.runs is MISSING:
            if self.impact is MISSING:
                raise ParameterError("impact", "must be given unless there are runs")
            if self.history is MISSING:
                raise ParameterError("history", "must be given unless there are runs")
            used = _used(self.history, self.until_s, self.until_greatest_depth)
            return [MotionRun(impact=self.impact.to_solver(), history=used, weights=self.weights.to_solver())]
        for name in ("impact", "history"):
            if getattr(self, name) is not MISSING:
                raise ParameterError(name, "must not be given together with runs")
        return [self._run(index, run) for index, run in enumerate(self.runs)]

    def _run(self, index: int, run: CalibrationRun) -> MotionRun:
        """Return a run of `runs` for the solver; its weights and end of fit default to the values of the request."""
        until, greatest = run.until_s, run.until_greatest_depth
        # `until_s` and `until_greatest_depth` exclude each other, so a run that sets one must not inherit the other.
        if until is MISSING and greatest is MISSING:
            until, greatest = self.until_s, self.until_greatest_depth
        weights = self.weights if run.weights is MISSING else run.weights
        try:
            used = _used(run.history, until, greatest is not MISSING and greatest)
        except ParameterError as error:
            raise error.at(f"runs.{index}.{error.field}") from None
        return MotionRun(impact=run.impact.to_solver(), history=used, weights=weights.to_solver())

    @property
    def several(self) -> bool:
        """True if the request has `runs`, even a single one."""
        return self.runs is not MISSING

    @property
    def run_count(self) -> int:
        """Number of runs. A request without `runs` has one."""
        return 1 if self.runs is MISSING else len(self.runs)

    def longest_run(self) -> float:
        """Return the time at which the longest history ends. [s]"""
        histories = [self.history] if self.runs is MISSING else [run.history for run in self.runs]
        return max((each.time_s[-1] for each in histories if each is not MISSING), default=0.0)

    def located(self, error: ParameterError) -> ParameterError:
        """Return a solver error with the field name that the request uses.

        The solver does not number a single run, which the request may list as `runs.0`.
        """
        if self.several and error.field.startswith(("history.", "weights")):
            return error.at(f"runs.0.{error.field}")
        return error.at("runs") if self.several and error.field == "history" else error

    def arguments(self) -> tuple[dict[str, Any], tuple[float, ...], list[FloatArray]]:
        """Return the arguments of `fit_decay_laws`, the strength factors to compare, and the times of their motions.

        Raises
        ------
        ParameterError
            If values contradict each other.
        """
        runs = self.motion_runs()
        fit = self.model_arguments() | {"runs": runs, "confidence_level": self.confidence_level}
        return fit, self.compared(), [_thinned(run.history.time) for run in runs]


def _used(record: MotionRecord, until_s: Any, until_greatest_depth: bool) -> MotionHistory:
    """Return the part of a history to which the model is fitted."""
    history = record.to_solver()
    if until_greatest_depth:
        if until_s is not MISSING:
            raise ParameterError("until_greatest_depth", "must not be given together with until_s")
        return history.until(history.time_of_greatest_depth)
    if until_s is MISSING:
        return history
    # A fit needs at least one instant after first contact.
    if until_s < history.time[1]:
        raise ParameterError("until", f"must leave two rows or more, got {until_s:g} s")
    return history.until(until_s)


def _thinned(times: FloatArray) -> FloatArray:
    """Return at most `COMPARED_ROWS` evenly chosen times, for a motion that is predicted for comparison."""
    # A short motion has fewer rows than that, so some rows are chosen repeatedly; `unique` removes the repeats.
    rows = np.unique(np.linspace(0, times.size - 1, COMPARED_ROWS).round().astype(int))
    thinned: FloatArray = times[rows]
    return thinned
