"""Results of uncertainty studies, and tables of sample results from which they are computed."""

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

# These are the ends of the 95 % and the 90 % range, the quartiles and the median.
LEVELS = (0.025, 0.05, 0.25, 0.5, 0.75, 0.95, 0.975)
"""Probabilities of the quantiles in results of studies."""

RANGE = (0.05, 0.95)
"""Probabilities of the quantiles at the ends of the 90 % range."""

Quantiles: TypeAlias = tuple[tuple[float, Estimate], ...]
"""Probabilities, each with its quantile."""
ExitQuantiles: TypeAlias = Mapping[str, Quantiles]
"""Quantiles of the quantities of an `Exit`, by name."""
EXIT_QUANTITIES = tuple(each.name for each in fields(Exit))
"""Names of the quantities of an `Exit`."""
FlightQuantiles: TypeAlias = Mapping[str, Quantiles]
"""Quantiles of flight distances, by name."""
FLIGHT_QUANTITIES = ("range", "farthest_range")
"""Distances in `solver.Flight` that a study keeps: at the computed elevation, and the farthest over all elevations."""

Problem = Literal["", "failed", "outside"]
"""Reason why a sample has no outcome: it could not be computed (``failed``), or is outside the ranges of the model
(``outside``); empty if it has one."""


class Crossings(NamedTuple):
    """Result of a search for the critical angle, in the form that a study stores."""

    angles: tuple[float, ...] = ()
    """Angles at which ricochet begins or ends, in increasing order. [rad]"""
    starts_turned_away: bool = False
    """True if the projectile is turned away at the lower end of the range."""
    problem: Problem = ""
    """Reason why there is no result; empty if there is a result."""

    @classmethod
    def of(cls, found: CriticalAngle | RicochetError) -> "Crossings":
        """Extract the result of `critical_angle`, or the reason for its error."""
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
        """True if ricochet begins at one angle in the range, and does not end."""
        return not self.problem and len(self.angles) == 1 and not self.starts_turned_away


@dataclass(frozen=True, slots=True)
class Change:
    """Critical angle with one input changed, and all others at their median or likeliest value."""

    value: Any
    """Value of the input."""
    angle: float | None
    """Critical angle; None if there is none in the range. [rad]"""


@dataclass(frozen=True, slots=True)
class AfterShots:
    """Expected range of the critical angle after some further shots into the same concrete."""

    shots: int
    """Number of shots."""
    dispersion: float
    """Standard deviation of ln S for the next shot after these shots, at the stated strength. [ln]"""
    lower: float
    """Lower end of the 90 % range, if the shots do not move the median of S. [rad]"""
    upper: float
    """Upper end of the 90 % range. [rad]"""


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Sensitivity of the critical angle to one input."""

    field: str
    """Dotted name of the input."""
    first_order: Estimate | None
    """First-order Sobol index; None if too few samples were left to compute it, or one of them had no outcome. [1]"""
    total: Estimate | None
    """Total Sobol index; None if too few samples were left to compute it, or one of them had no outcome. [1]"""
    swing: tuple[Change, ...]
    """Critical angles at the 5 % and 95 % quantiles of the input, or at each of its discrete values."""
    after_shots: tuple[AfterShots, ...] = ()
    """90 % ranges of the critical angle to be expected after one or more shots into the same concrete. Empty for
    every input except ``resistance.strength_residual``."""


class Tables:
    """Sample results of a study, in arrays that grow with each round.

    Parameters
    ----------
    design
        Sample points of the study.
    angles
        Oblique angles of the probability curve. [rad]
    """

    def __init__(self, design: Design, angles: FloatArray) -> None:
        self._design = design
        self._angles = angles
        self.found: npt.NDArray[np.object_] = np.empty((SCRAMBLINGS, 0, design.alternatives), object)
        """(scramblings, count, alternatives) results of searches."""
        self.samples = self.failed = self.outside = 0
        self.swing: list[tuple[int, Change]] = []

    def add(self, results: Sequence[Crossings], count: int, others: Sequence[Crossings] = ()) -> None:
        """Add the results of a round.

        Parameters
        ----------
        results
            Results at the points of the round.
        count
            Number of points of each scrambling in the round.
        others
            Further results, which are included in the numbers of samples and of problems, but not in the probabilities.
        """
        if len(results) != SCRAMBLINGS * count * self._design.alternatives:
            raise ParameterError("results", "must be one for each point")
        self.count_problems([*results, *others])
        new = np.empty(len(results), object)
        for number, each in enumerate(results):  # a slice assignment would unpack the tuples
            new[number] = each
        self.found = np.concatenate((self.found, new.reshape(SCRAMBLINGS, count, -1)), axis=1)
        self.critical = np.array([each.angle for each in self.found.ravel()]).reshape(self.found.shape)
        self.simple = all(each.simple for each in self.found.ravel())
        self._count_outcomes()

    def count_problems(self, results: Sequence[Crossings]) -> None:
        """Add to the numbers of samples, of failed ones, and of those outside the ranges of the model."""
        self.samples += len(results)
        self.failed += sum(each.problem == "failed" for each in results)
        self.outside += sum(each.problem == "outside" for each in results)

    @property
    def count(self) -> int:
        """Number of points of each scrambling."""
        return int(self.found.shape[1])

    @property
    def base_samples(self) -> int:
        """Number of points in all scramblings."""
        return SCRAMBLINGS * self.count

    @property
    def weights(self) -> FloatArray:
        """(scramblings, count, alternatives) weights, which sum to 1 in each scrambling."""
        return np.broadcast_to(self._design.weights / self.count, self.found.shape)

    def _count_outcomes(self) -> None:
        """Compute the probabilities of ricochet and the weights of samples without an outcome in each scrambling.

        They are `turned_away`, of shape (scramblings, angles), and `unknown`, of shape (scramblings,).
        """
        self.turned_away = np.zeros((SCRAMBLINGS, self._angles.size))
        self.unknown = np.zeros(SCRAMBLINGS)
        for (number, _, alternative), each in np.ndenumerate(self.found):
            weight = self._design.weights[alternative] / self.count
            if each.problem:
                self.unknown[number] += weight
                continue
            if each.starts_turned_away:
                self.turned_away[number] += weight
            # Outcomes alternate: changes to ricochet add the weight from their angle on, and changes back remove it.
            for place, angle in enumerate(each.angles):
                sign = 1.0 if (place % 2 == 0) != each.starts_turned_away else -1.0
                self.turned_away[number, np.searchsorted(self._angles, angle) :] += sign * weight


@dataclass(frozen=True, slots=True)
class Round:
    """Entry of the convergence history of a study."""

    samples: int
    """Number of samples so far."""
    half_width: float
    """Half width of the widest interval of any probability. [1]"""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class AngleUncertainty(ComparedByFields):
    """Probability of ricochet as a function of the oblique angle, and distribution of the critical angle."""

    oblique_angles: FloatArray
    """Oblique angles of the probability curve. [rad]"""
    probability: FloatArray
    """Probability of ricochet at each oblique angle."""
    lower: FloatArray
    """Lower end of the interval of each probability."""
    upper: FloatArray
    """Upper end of the interval of each probability."""
    mean: Estimate | None
    """Mean of the critical angle among the samples that have one; None if none has, or only samples of a single
    scrambling. [rad]"""
    standard_deviation: Estimate | None
    """Standard deviation of the critical angle among the samples that have one; None if the mean is. [rad]"""
    quantiles: tuple[tuple[float, Estimate], ...]
    """Quantiles of the critical angle among the samples that have one, as probability and angle. [1, rad]"""
    share_without: Estimate
    """Share of samples without a critical angle in the range. [1]"""
    sensitivity: tuple[Sensitivity, ...]
    """Sensitivity to each input; empty unless requested."""
    convergence: tuple[Round, ...]
    """Number of samples, and half width reached, after each round."""
    converged: bool
    """True if every interval is within the requested half width."""
    method: Literal["surrogate", "direct"]
    """Source of the probabilities: ``surrogate`` for the polynomial chaos, ``direct`` for counted outcomes."""
    order: int | None
    """Highest order of the polynomials of the surrogate; None for counted outcomes."""
    surrogate_error: float | None
    """Root mean square error of the surrogate at held-out points, also if it was too large for the surrogate to be
    used; None if no surrogate was fitted. [rad]"""
    samples: int
    """Total number of searches."""
    failed: int
    """Number of samples that could not be computed."""
    outside: int
    """Number of samples outside the ranges of the model."""
    seed: int
    """Seed of the sample points."""
    warnings: tuple[ModelWarning, ...] = field(default=())
    """Warnings about the strike and the study."""

    def columns(self) -> Columns:
        """Return the probability curve as arrays by name, with angles in radians."""
        return {
            "oblique_angle": self.oblique_angles,
            "probability": self.probability,
            "lower": self.lower,
            "upper": self.upper,
        }

    def to_dataframe(self) -> DataFrame:
        """Return the probability curve as a ``pandas.DataFrame``; requires pandas."""
        return dataframe(self.columns(), Impact)

    def plot(self, *, ax: "Axes | None" = None) -> Figure:
        """Plot the probability curve, in a new pyplot figure unless axes are given; return the figure."""
        return plot_probability(self.columns(), self._summary(), ax)

    def _summary(self) -> str:
        if self.mean is None or self.standard_deviation is None:
            # Samples of a single scrambling have quantiles, but no mean.
            found = "too few critical angles" if self.quantiles else "no critical angle"
            return f"{found} in {self.samples} samples"
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
    """Probability of each outcome of one strike, with quantiles of depth, exit and flight."""

    outcomes: tuple[tuple[str, Estimate], ...]
    """Probability of each outcome: ``ricochet``, ``embedded``, ``in_motion``, and ``perforated`` if any run does."""
    maximum_depth: tuple[tuple[float, Estimate], ...]
    """Quantiles of the greatest depth over the runs that do not perforate. [1, m]"""
    ricochet_exit: ExitQuantiles
    """Quantiles of the quantities of `solver.Exit`, by name, over the runs that end in ricochet; empty if none does.
    [1, unit of the quantity]"""
    perforation_exit: ExitQuantiles
    """Quantiles of the quantities of `solver.Exit`, by name, over the runs that perforate; empty if none does.
    [1, unit of the quantity]"""
    ricochet_flight: FlightQuantiles
    """Quantiles of the flight distances ``range`` and ``farthest_range`` of `solver.Flight` after a ricochet, by name;
    empty unless a flight was requested. [1, m]"""
    perforation_flight: FlightQuantiles
    """Quantiles of the flight distances behind a wall, by the same names. [1, m]"""
    convergence: tuple[Round, ...]
    """Number of samples, and half width reached, after each round."""
    converged: bool
    """True if every interval is within the requested half width."""
    samples: int
    """Total number of runs."""
    failed: int
    """Number of samples that could not be computed."""
    outside: int
    """Number of samples outside the ranges of the model."""
    seed: int
    """Seed of the sample points."""
    warnings: tuple[ModelWarning, ...] = field(default=())
    """Warnings about the strike and the study."""

    @property
    def exit_speed(self) -> Quantiles:
        """Quantiles of the speed of projectiles that are turned away. [1, m/s]"""
        return self.ricochet_exit.get("speed", ())

    @property
    def exit_angle(self) -> Quantiles:
        """Quantiles of the angle between the exit velocity of ricochets and the outward normal. [1, rad]"""
        return self.ricochet_exit.get("direction", ())

    @property
    def residual_speed(self) -> Quantiles:
        """Quantiles of the speed of projectiles that perforate. [1, m/s]"""
        return self.perforation_exit.get("speed", ())

    def plot(self, *, ax: "Axes | None" = None) -> Figure:
        """Plot the probability of each outcome, and quantiles of depth and exit speed; return the figure.

        It is a new pyplot figure unless axes are given, which show the probabilities only.
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
    """Points at which a study needs results; they may be computed in any order and in parts of any size."""

    points: list[Point]
    """Values of all inputs at each point, in the order of the inputs."""
    so_far: Study | None
    """Result of the study from the previous batches; None in the first batch."""
