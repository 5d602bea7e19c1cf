"""Answers of a study of uncertainty, and the tables of results that they come from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from html import escape
from typing import Any, Generic, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from solver.arrays import ComparedByFields, FloatArray
from solver.checks import ParameterError, RicochetError
from solver.display import Axes, Columns, DataFrame, Figure, card, dataframe, line, plot_endings, plot_probability
from solver.prepared import Exit, Outcome
from solver.search.types import CriticalAngle, SearchStatus
from solver.strike import Impact
from solver.uncertainty.sampling import SCRAMBLINGS, Design, Estimate, Point
from solver.warnings import ModelWarning

LEVELS = (0.025, 0.05, 0.25, 0.5, 0.75, 0.95, 0.975)
"""Probabilities of the quantiles in an answer."""

RANGE = (0.05, 0.95)
"""Of them, those that the 90 % range lies between."""

Quantiles: TypeAlias = tuple[tuple[float, Estimate], ...]
"""Probabilities, each with the value that is not exceeded with it."""
ExitQuantiles: TypeAlias = Mapping[str, Quantiles]
EXIT_QUANTITIES = tuple(each.name for each in fields(Exit))
FlightQuantiles: TypeAlias = Mapping[str, Quantiles]
FLIGHT_QUANTITIES = ("range", "farthest_range")
"""Distances of `solver.Flight` that a study keeps: as computed, and over all elevations."""

Problem = Literal["", "failed", "outside"]
"""Why a sample has no outcome: it could not be computed, or is outside what the model accepts."""


class Crossings(NamedTuple):
    """What a study keeps of one search."""

    angles: tuple[float, ...] = ()
    """At which the outcome changes, in order. [rad]"""
    starts_turned_away: bool = False
    """Whether the projectile is turned away below the first of them."""
    problem: Problem = ""

    @classmethod
    def of(cls, found: CriticalAngle | RicochetError) -> "Crossings":
        """Return what to keep of an answer of `critical_angle`."""
        if isinstance(found, RicochetError):
            return cls(problem="outside" if isinstance(found, ParameterError) else "failed")
        if found.status is SearchStatus.NOT_CONVERGED:
            return cls(problem="failed")
        if found.angle is None:
            return cls(tuple(sorted(found.other_crossings)), found.status is SearchStatus.ALWAYS_RICOCHET)
        return cls(tuple(sorted((found.angle, *found.other_crossings))))

    @property
    def angle(self) -> float:
        """Critical angle; NaN without one in the range. [rad]"""
        return self.angles[0] if self.angles and not self.starts_turned_away else float("nan")

    @property
    def simple(self) -> bool:
        """Whether there is one change of outcome and no more, from retained to turned away."""
        return not self.problem and len(self.angles) == 1 and not self.starts_turned_away


@dataclass(frozen=True, slots=True)
class Change:
    """Critical angle with one input changed and the others at their median, or likeliest value."""

    value: Any
    """Value of the input."""
    angle: float | None
    """None without one. [rad]"""


@dataclass(frozen=True, slots=True)
class AfterShots:
    """Critical angle as it is expected after some shots of one's own into the concrete."""

    shots: int
    dispersion: float
    """Of S of the shot after them, at the stated strength. [ln]"""
    lower: float
    upper: float
    """90 % range, where the shots do not move the median of S. [rad]"""


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Share of one input in the variance of the critical angle, and what the input alone changes."""

    field: str
    first_order: Estimate | None
    total: Estimate | None
    """Indices of Sobol; None where the budget left no samples for them."""
    swing: tuple[Change, ...]
    """At the 5 % and 95 % quantiles of the input, or at each of its discrete values."""
    after_shots: tuple[AfterShots, ...] = ()
    """Of a lognormal factor on S, ``resistance.strength_residual``: what shots of one's own would make of the angle."""


class Tables:
    """Results of a study, as arrays that grow by rounds.

    Parameters
    ----------
    design
        Its points.
    angles
        Oblique angles. [rad]
    """

    def __init__(self, design: Design, angles: FloatArray) -> None:
        self._design = design
        self._angles = angles
        self.found: npt.NDArray[np.object_] = np.empty((SCRAMBLINGS, 0, design.alternatives), object)
        """(scramblings, count, alternatives) results."""
        self.samples = self.failed = self.outside = 0
        self.swing: list[tuple[int, Change]] = []

    def add(self, results: Sequence[Crossings], count: int, others: Sequence[Crossings] = ()) -> None:
        """Add a round of so many points of each scrambling; of `others`, only the number counts."""
        if len(results) != SCRAMBLINGS * count * self._design.alternatives:
            raise ParameterError("results", "must be one for each point")
        self.count_problems([*results, *others])
        new = np.empty(len(results), object)
        for number, each in enumerate(results):  # a tuple each, which a slice would take apart
            new[number] = each
        self.found = np.concatenate((self.found, new.reshape(SCRAMBLINGS, count, -1)), axis=1)
        self.critical = np.array([each.angle for each in self.found.ravel()]).reshape(self.found.shape)
        self.simple = all(each.simple for each in self.found.ravel())
        self._count_outcomes()

    def count_problems(self, results: Sequence[Crossings]) -> None:
        """Count samples, and those without an outcome."""
        self.samples += len(results)
        self.failed += sum(each.problem == "failed" for each in results)
        self.outside += sum(each.problem == "outside" for each in results)

    @property
    def count(self) -> int:
        """Points of each scrambling."""
        return int(self.found.shape[1])

    @property
    def base_samples(self) -> int:
        """Points of all scramblings."""
        return SCRAMBLINGS * self.count

    @property
    def weights(self) -> FloatArray:
        """(scramblings, count, alternatives) weights, which sum to 1 in each scrambling."""
        return np.broadcast_to(self._design.weights / self.count, self.found.shape)

    def _count_outcomes(self) -> None:
        """Set `turned_away`, (scramblings, angles) shares, and `unknown`, (scramblings,) shares without an outcome."""
        self.turned_away = np.zeros((SCRAMBLINGS, self._angles.size))
        self.unknown = np.zeros(SCRAMBLINGS)
        for (number, _, alternative), each in np.ndenumerate(self.found):
            weight = self._design.weights[alternative] / self.count
            if each.problem:
                self.unknown[number] += weight
                continue
            if each.starts_turned_away:
                self.turned_away[number] += weight
            for place, angle in enumerate(each.angles):
                sign = 1.0 if (place % 2 == 0) != each.starts_turned_away else -1.0
                self.turned_away[number, np.searchsorted(self._angles, angle) :] += sign * weight


@dataclass(frozen=True, slots=True)
class Round:
    """One entry of the history of a study."""

    samples: int
    half_width: float
    """Largest of all intervals of a probability. [1]"""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class AngleUncertainty(ComparedByFields):
    """Probability of ricochet over the oblique angle, and the critical angle as a distribution."""

    oblique_angles: FloatArray
    """[rad]"""
    probability: FloatArray
    """Probability of being turned away, at each of them."""
    lower: FloatArray
    upper: FloatArray
    """Its interval."""
    mean: Estimate | None
    standard_deviation: Estimate | None
    """Mean and standard deviation of the critical angle among the samples that have one; None if none has. [rad]"""
    quantiles: tuple[tuple[float, Estimate], ...]
    """Quantiles of the critical angle of these samples, as probability and angle. [1, rad]"""
    share_without: Estimate
    """Share of samples without a critical angle in the range. [1]"""
    sensitivity: tuple[Sensitivity, ...]
    convergence: tuple[Round, ...]
    converged: bool
    """Whether every interval is within the half width wanted."""
    method: Literal["surrogate", "direct"]
    order: int | None
    """Highest order of the polynomials of the surrogate."""
    surrogate_error: float | None
    """Root mean square of its error at held-out points, also where it was too large for use. [rad]"""
    samples: int
    """Searches in all."""
    failed: int
    outside: int
    """Samples that could not be computed, and those outside what the model accepts."""
    seed: int
    warnings: tuple[ModelWarning, ...] = field(default=())

    def columns(self) -> Columns:
        """Return the curve as arrays by name, angles in radians."""
        return {
            "oblique_angle": self.oblique_angles,
            "probability": self.probability,
            "lower": self.lower,
            "upper": self.upper,
        }

    def to_dataframe(self) -> DataFrame:
        """Return the curve as a ``pandas.DataFrame``, which has to be installed."""
        return dataframe(self.columns(), Impact)

    def plot(self, *, ax: "Axes | None" = None) -> Figure:
        """Return the curve as a ``matplotlib.figure.Figure``, of pyplot unless axes are given."""
        return plot_probability(self.columns(), self._summary(), ax)

    def _summary(self) -> str:
        if self.mean is None or self.standard_deviation is None:
            return f"no critical angle in {self.samples} samples"
        middle, deviation = np.degrees((self.mean.value, self.standard_deviation.value))
        levels = dict(self.quantiles)
        low, high = (np.degrees(levels[level].value) for level in (LEVELS[0], LEVELS[-1]))
        return f"critical angle {middle:.2f}° ± {deviation:.2f}° ({low:.1f}° to {high:.1f}°)"

    def __repr__(self) -> str:
        samples = "" if self.mean is None else f"{self.samples} samples"
        return line(self, self._summary(), samples, self.method)

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(each.field)}</td><td>{_share(each.first_order)}</td><td>{_share(each.total)}</td></tr>"
            for each in self.sensitivity
        )
        table = (
            f'<table style="color:inherit"><tr><th>input</th><th>first order</th><th>total</th></tr>{rows}</table>'
            if rows
            else ""
        )
        sampled = {
            "samples": f"{self.samples}, {self.method}",
            "converged": "yes" if self.converged else "no",
            "without a critical angle": _share(self.share_without),
        }
        return card(self._summary(), sampled, self.warnings, table)


def _share(estimate: Estimate | None) -> str:
    return "" if estimate is None else f"{estimate.value:.2f} ({estimate.lower:.2f} to {estimate.upper:.2f})"


@dataclass(frozen=True, slots=True, repr=False)
class TrajectoryUncertainty:
    """Probability of each outcome of one strike, and how deep and how fast it ends."""

    outcomes: tuple[tuple[str, Estimate], ...]
    """Probability of ``ricochet``, ``embedded``, ``in_motion``;
    ``perforated`` where a wall was."""
    maximum_depth: tuple[tuple[float, Estimate], ...]
    """Quantiles over the runs that do not perforate. [1, m]"""
    ricochet_exit: ExitQuantiles
    perforation_exit: ExitQuantiles
    """Quantiles of the exit of those turned away, and of those that perforated: by the names of `solver.Exit`, empty
    where there is none. [1, unit of the quantity]"""
    ricochet_flight: FlightQuantiles
    perforation_flight: FlightQuantiles
    """Quantiles of the distance of flight of these samples, by the names ``range`` and ``farthest_range`` of
    `solver.Flight`; empty unless a flight was wanted. [1, m]"""
    convergence: tuple[Round, ...]
    converged: bool
    samples: int
    failed: int
    outside: int
    seed: int
    warnings: tuple[ModelWarning, ...] = field(default=())

    @property
    def exit_speed(self) -> Quantiles:
        """Quantiles of the speed of those turned away. [1, m/s]"""
        return self.ricochet_exit.get("speed", ())

    @property
    def exit_angle(self) -> Quantiles:
        """Quantiles of the angle of that velocity from the outward normal. [1, rad]"""
        return self.ricochet_exit.get("direction", ())

    @property
    def residual_speed(self) -> Quantiles:
        """Quantiles of the speed of those that perforated. [1, m/s]"""
        return self.perforation_exit.get("speed", ())

    def plot(self, *, ax: "Axes | None" = None) -> Figure:
        """Return the probability of each outcome, depths and exit speeds as a ``matplotlib.figure.Figure``.

        It is one of pyplot unless axes are given; they take the probability of each outcome alone.
        """

        def rows(quantiles: Quantiles) -> list[tuple[float, float, float, float]]:
            return [(level, found.value, found.lower, found.upper) for level, found in quantiles]

        return plot_endings(
            {name: (each.value, each.lower, each.upper) for name, each in self.outcomes},
            rows(self.maximum_depth),
            {Outcome.RICOCHET.value: rows(self.exit_speed), Outcome.PERFORATED.value: rows(self.residual_speed)},
            f"how {self.samples} samples end",
            ax,
        )

    def __repr__(self) -> str:
        shares = (f"{name} {estimate.value:.3f}" for name, estimate in self.outcomes)
        return line(self, *shares, f"{self.samples} samples")

    def _repr_html_(self) -> str:
        rows = {name.replace("_", " "): _share(estimate) for name, estimate in self.outcomes}
        rows |= {"samples": str(self.samples), "converged": "yes" if self.converged else "no"}
        return card("probability of each outcome", rows, self.warnings)


Study = TypeVar("Study", AngleUncertainty, TrajectoryUncertainty)


@dataclass(frozen=True, slots=True)
class Batch(Generic[Study]):
    """Points of a study to compute, in any order and in parts of any size."""

    points: list[Point]
    """Values of the inputs, in their order."""
    so_far: Study | None
    """The answer from what was computed before; None in the first batch."""
