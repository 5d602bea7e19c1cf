"""Study of the outcomes of a strike at one angle: their probabilities, and quantiles of depth, exit and flight."""

import math
from collections.abc import Callable, Generator, Sequence
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.checks import ParameterError, RicochetError
from solver.flight import Flight
from solver.prepared import Exit, Outcome
from solver.trajectory import Trajectory
from solver.uncertainty.results import (
    EXIT_QUANTITIES,
    FLIGHT_QUANTITIES,
    LEVELS,
    Batch,
    ExitQuantiles,
    FlightQuantiles,
    Problem,
    Quantiles,
    Round,
    TrajectoryUncertainty,
)
from solver.uncertainty.sampling import (
    FIRST_POINTS,
    SCRAMBLINGS,
    Design,
    Estimate,
    Sampling,
    Uncertain,
    check_inputs,
    quantile_estimates,
    share_half_width,
)
from solver.warnings import ModelWarning


class Ending(NamedTuple):
    """Result of a run, in the form that a study stores."""

    outcome: str = ""
    """Outcome of the run; empty if it has none."""
    maximum_depth: float = math.nan
    """Greatest depth; NaN if the projectile perforates. [m]"""
    exit: Exit | None = None
    """State of the projectile as it leaves the target; None if it stays in it."""
    problem: Problem = ""
    """Reason why there is no result; empty if there is a result."""
    range: float = math.nan
    """Flight distance; NaN if the projectile stays in the target, or no flight was requested. [m]"""
    farthest_range: float = math.nan
    """Farthest flight distance over all elevations; NaN as for `range`. [m]"""

    @classmethod
    def of(cls, found: Trajectory | RicochetError, flight: Flight | None = None) -> "Ending":
        """Extract the result of `simulate`, or the reason for its error, and the distances of the flight after it."""
        if isinstance(found, RicochetError):
            return cls(problem="outside" if isinstance(found, ParameterError) else "failed")
        depth = math.nan if found.maximum_depth is None else found.maximum_depth
        distances = {} if flight is None else {name: getattr(flight, name) for name in FLIGHT_QUANTITIES}
        return cls(found.outcome.value, depth, found.exit, **distances)


TrajectorySteps = Generator[Batch[TrajectoryUncertainty], Sequence[Ending], TrajectoryUncertainty]
"""Generator that yields batches of points, receives the results at these points, and returns the result of the
study."""


class TrajectoryStudy:
    """Study that samples runs until the probability of each outcome is known to the requested half width.

    It ends earlier if the budget of samples is used up.

    Parameters
    ----------
    uncertain
        Independent inputs with their distributions.
    sampling
        Accuracy, budget and seed.
    warnings
        Warnings about the strike, which are added to those of the study.

    Notes
    -----
    `steps` works as in `AngleStudy`. Outcomes are not continuous in the inputs, so there is no surrogate.
    """

    def __init__(
        self, uncertain: Sequence[Uncertain], sampling: Sampling, *, warnings: tuple[ModelWarning, ...] = ()
    ) -> None:
        check_inputs(uncertain)
        self.warnings = warnings
        self.design = Design(uncertain, sampling)
        self.sampling = sampling

    def steps(self) -> TrajectorySteps:
        """Yield batches of points, receive the results at them, and return the result of the study."""
        design, inputs = self.design, len(self.design.uncertain)
        found: list[list[Ending]] = [[] for _ in range(SCRAMBLINGS)]
        history: list[Round] = []
        answer: TrajectoryUncertainty | None = None
        count, points = 0, FIRST_POINTS
        while True:
            new = design.unit(points)[:, count:points, :inputs].reshape(-1, inputs)
            results = yield Batch(design.points(new), answer)
            share = (points - count) * design.alternatives
            if len(results) != SCRAMBLINGS * share:
                raise ParameterError("results", "must be one for each point")
            for number, row in enumerate(found):
                row.extend(results[number * share : (number + 1) * share])
            count, points = points, 2 * points
            answer = self._answer(found, count, history)
            history = list(answer.convergence)
            following = 2 * SCRAMBLINGS * count * design.alternatives
            if answer.converged or following > self.sampling.max_samples:
                return answer

    def _answer(self, found: list[list[Ending]], count: int, history: Sequence[Round]) -> TrajectoryUncertainty:
        sampling, base = self.sampling, SCRAMBLINGS * count
        weights = np.tile(self.design.weights / count, (SCRAMBLINGS, count))
        outcomes = np.array([[each.outcome for each in row] for row in found])
        unknown = float(np.where(outcomes == "", weights, 0.0).sum() / SCRAMBLINGS)
        shares, widest = [], 0.0
        for outcome in Outcome:
            if outcome is Outcome.PERFORATED and not (outcomes == outcome.value).any():
                continue  # left out if no run perforates, as for any half-space
            by_scrambling = np.where(outcomes == outcome.value, weights, 0.0).sum(axis=1)
            value, half = float(by_scrambling.mean()), float(share_half_width(by_scrambling, sampling, base))
            estimate = Estimate(value, max(0.0, value - half), min(1.0, value + unknown + half))
            widest = max(widest, 0.5 * (estimate.upper - estimate.lower))
            shares.append((outcome.value, estimate))
        samples = base * self.design.alternatives
        problems = [each.problem for row in found for each in row]
        failed, outside = problems.count("failed"), problems.count("outside")
        return TrajectoryUncertainty(
            outcomes=tuple(shares),
            maximum_depth=self._quantiles([[each.maximum_depth for each in row] for row in found], weights),
            ricochet_exit=self._exits(found, weights, Outcome.RICOCHET),
            perforation_exit=self._exits(found, weights, Outcome.PERFORATED),
            ricochet_flight=self._flights(found, weights, Outcome.RICOCHET),
            perforation_flight=self._flights(found, weights, Outcome.PERFORATED),
            convergence=(*history, Round(samples, widest)),
            converged=widest <= sampling.half_width,
            samples=samples,
            failed=failed,
            outside=outside,
            seed=sampling.seed,
            warnings=self.warnings + _warnings(samples, failed, outside),
        )

    def _exits(self, found: list[list[Ending]], weights: FloatArray, outcome: Outcome) -> ExitQuantiles:
        def quantity(each: Ending, name: str) -> float:
            left = each.outcome == outcome.value and each.exit is not None
            return getattr(each.exit, name) if left else math.nan

        return self._quantiles_by_name(found, weights, EXIT_QUANTITIES, quantity)

    def _flights(self, found: list[list[Ending]], weights: FloatArray, outcome: Outcome) -> FlightQuantiles:
        def quantity(each: Ending, name: str) -> float:
            return getattr(each, name) if each.outcome == outcome.value else math.nan

        return self._quantiles_by_name(found, weights, FLIGHT_QUANTITIES, quantity)

    def _quantiles_by_name(
        self,
        found: list[list[Ending]],
        weights: FloatArray,
        names: Sequence[str],
        quantity: Callable[[Ending, str], float],
    ) -> dict[str, Quantiles]:
        """Return the quantiles of quantities by name, except for quantities that no sample has."""
        rows = {name: [[quantity(each, name) for each in row] for row in found] for name in names}
        known = {name: self._quantiles(row, weights) for name, row in rows.items()}
        return {name: quantiles for name, quantiles in known.items() if quantiles}

    def _quantiles(self, rows: list[list[float]], weights: FloatArray) -> tuple[tuple[float, Estimate], ...]:
        values = np.array(rows)
        known = ~np.isnan(values)
        if not known.any():
            return ()
        values, shared = np.where(known, values, 0.0), np.where(known, weights, 0.0)
        return quantile_estimates(values, shared, LEVELS, self.sampling)


def _warnings(samples: int, failed: int, outside: int) -> tuple[ModelWarning, ...]:
    found = []
    if outside:
        detail = f"{outside} of {samples} samples are outside what the model accepts; they count as not known"
        found.append(ModelWarning("samples_outside", detail))
    if failed:
        detail = f"{failed} of {samples} samples could not be computed; they count as not known"
        found.append(ModelWarning("samples_failed", detail))
    return tuple(found)
