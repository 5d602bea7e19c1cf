"""Study of the critical angle: probability of ricochet as a function of the angle, and sensitivities to the inputs."""

import math
from collections.abc import Generator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from solver.arrays import FloatArray
from solver.checks import require
from solver.uncertainty.next_shot import NextShot
from solver.uncertainty.results import (
    LEVELS,
    RANGE,
    AfterShots,
    AngleUncertainty,
    Batch,
    Change,
    Crossings,
    Round,
    Sensitivity,
    Tables,
)
from solver.uncertainty.sampling import (
    FIRST_POINTS,
    SCRAMBLINGS,
    Accepts,
    Design,
    Estimate,
    Sampling,
    Uncertain,
    check_inputs,
    moment_estimates,
    quantile_estimates,
    scrambled,
    share_estimate,
    share_half_width,
)
from solver.uncertainty.surrogate import Expansion, Moments, direct_indices, expansion_moments, fit_expansion
from solver.warnings import ModelWarning

# An error of 0.1° is far below the usual scatter of the angle, a few degrees. The samples also correct the
# probabilities for this error.
SURROGATE_ERROR = math.radians(0.1)
"""Largest root mean square error at held-out points with which the surrogate is used. [rad]"""
# Evaluating the surrogate takes microseconds a point, and with so many points its sampling error is negligible.
SURROGATE_POINTS = 4096
"""Number of points in each scrambling at which the surrogate is evaluated."""
# With fewer samples the intervals of the indices are too wide to be useful; the value is arbitrary.
FEWEST_BASE_SAMPLES = 64
"""Least number of base samples for Sobol indices by the direct method."""
# A base sample takes one search for each input, and one more. The limit is well above 512 base samples, with which 95 %
# intervals contained the true first-order indices of Ishigami's function for only 89 or 90 of 100 seeds.
SENSITIVITY_SAMPLES = 4096
"""Largest number of base samples for Sobol indices by the direct method."""
# This is one angle every 0.04° over the default range; the limit is arbitrary.
MOST_ANGLES = 2001
"""Largest number of angles of the probability curve."""


Steps = Generator[Batch[AngleUncertainty], Sequence[Crossings], AngleUncertainty]
"""Generator that yields batches of points, receives the results at these points, and returns the result of the
study."""


class AngleStudy:
    """Study that samples critical angles until the probability of ricochet is known to the requested half width.

    It ends earlier if the budget of samples is used up.

    Parameters
    ----------
    uncertain
        Independent inputs with their distributions.
    oblique_angles
        Increasing angles at which the probability is computed. [rad]
    sampling
        Accuracy, budget and seed.
    sensitivity
        Also compute Sobol indices, and the swing of each input (see `Sensitivity`).
    shots
        Result of `next_shots`: index of the factor on S among the inputs, and expected scatter after further shots.
    bounds
        Bounds of the search. For a sample without an angle, Sobol indices use the bound beyond which its angle lies.
        [rad]
    accepts
        Function that returns whether the model accepts a value, given the index of the input and the value; by default
        all values are accepted. At points with values that are not accepted, the surrogate's outcome counts as unknown.
    warnings
        Warnings about the strike, which are added to those of the study.

    Raises
    ------
    ParameterError
        If arguments are inconsistent, for example if the budget is less than these inputs need.

    Notes
    -----
    `steps` itself computes no strike: it yields points, and receives the results at these points in the same order.

    Examples
    --------
    >>> steps = study.steps()
    >>> batch = next(steps)
    >>> batch = steps.send([evaluate(point) for point in batch.points])  # and so on until StopIteration
    """

    def __init__(
        self,
        uncertain: Sequence[Uncertain],
        oblique_angles: FloatArray,
        sampling: Sampling,
        *,
        sensitivity: bool = True,
        bounds: tuple[float, float] = (math.radians(5.0), math.radians(85.0)),
        accepts: Accepts = lambda _, __: True,
        warnings: tuple[ModelWarning, ...] = (),
        shots: tuple[int, tuple[NextShot, ...]] | None = None,
    ) -> None:
        check_inputs(uncertain)
        angles = np.asarray(oblique_angles, float)
        fits = angles.ndim == 1 and 1 <= angles.size <= MOST_ANGLES
        require(fits, "oblique_angles", f"must hold 1 to {MOST_ANGLES} angles")
        rising = bool(np.isfinite(angles).all() and (np.diff(angles) > 0.0).all())
        require(rising, "oblique_angles", "must be finite and increasing")
        self.design = Design(uncertain, sampling, swings=sensitivity)
        self.angles = angles
        self.sampling = sampling
        self.sensitivity = sensitivity
        self.bounds = bounds
        self.accepts = accepts
        self.warnings = warnings
        self.shots = shots

    @cached_property
    def _unit(self) -> FloatArray:
        """(scramblings, n, inputs) points in (0, 1) at which the surrogate is evaluated."""
        return scrambled(self.sampling.seed, len(self.design.uncertain), SURROGATE_POINTS, stream=1)

    @cached_property
    def _beyond(self) -> npt.NDArray[np.bool_]:
        """Mask of the points in `_unit` at which the model does not accept an input."""
        return self.design.beyond(self._unit, self.accepts)

    def steps(self) -> Steps:
        """Yield batches of points, receive the results at them, and return the result of the study."""
        sampling, design = self.sampling, self.design
        tables = Tables(design, self.angles)
        history: list[Round] = []
        answer: AngleUncertainty | None = None
        count, points = 0, sampling.first_points
        extra = [point for _, point in design.swings]
        while True:
            new = design.unit(points)[:, count:points, : len(design.uncertain)]
            wanted = design.points(new.reshape(-1, new.shape[-1]))
            results = yield Batch(extra + wanted, answer)
            if extra:
                tables.swing = [
                    (i, Change(point[i], None if math.isnan(each.angle) else each.angle))
                    for (i, point), each in zip(design.swings, results[: len(extra)], strict=True)
                ]
            tables.add(results[len(extra) :], points - count, others=results[: len(extra)])
            extra, count = [], points
            answer = self._answer(tables, history)
            history = list(answer.convergence)
            following = tables.samples + SCRAMBLINGS * count * design.alternatives
            points = 2 * count
            # Up to the usual first round nothing is reserved, so that a small study does not end before its surrogate
            # fits.
            reserve = self._reserve() if points > FIRST_POINTS else 0
            if answer.converged or following + reserve > sampling.max_samples:
                break
        if self.sensitivity and answer.method == "direct":
            answer = yield from self._indices(tables, answer)
        return answer

    def _reserve(self) -> int:
        """Return how many samples of the budget are reserved for indices by the direct method."""
        if not self.sensitivity:
            return 0
        # Four times the least number of base samples gives useful indices. At least half of the budget remains for
        # probabilities.
        wanted = 4 * FEWEST_BASE_SAMPLES * (len(self.design.uncertain) + 1)
        return min(wanted, self.sampling.max_samples // 2)

    def _answer(self, tables: Tables, history: Sequence[Round]) -> AngleUncertainty:
        expansion = None if self.sampling.method == "direct" else self._expansion(tables)
        answer = self._direct(tables)
        error = None if expansion is None else math.sqrt(float(self.design.weights @ expansion.errors**2))
        if expansion is not None and error is not None and error <= SURROGATE_ERROR:
            by_surrogate = self._by_surrogate(tables, expansion)
            # The error of the surrogate does not decrease with the number of samples, so with many samples counted
            # outcomes have narrower intervals.
            answer = min(by_surrogate, answer, key=_half_width)
        half = _half_width(answer)
        return replace(
            answer,
            surrogate_error=error,
            convergence=(*history, Round(tables.samples, half)),
            converged=half <= self.sampling.half_width,
            warnings=self.warnings + _warnings(tables, answer, self._beyond if answer.method == "surrogate" else None),
        )

    def _expansion(self, tables: Tables) -> Expansion | None:
        """Return the fit of the critical angle; None if a fit is not possible.

        Every sample must have exactly one change of outcome, at least one input must be continuous, all discrete values
        must be enumerated, and there must be enough points.
        """
        design = self.design
        if not tables.simple or (design.discrete and not design.enumerated) or not design.continuous:
            return None
        unit = design.unit(tables.count)[:, : tables.count, : len(design.uncertain)]
        values = tables.critical.reshape(-1, design.alternatives)
        return fit_expansion(
            design.continuous_inputs(), design.standard(unit).reshape(-1, len(design.continuous)), values
        )

    def _by_surrogate(self, tables: Tables, expansion: Expansion) -> AngleUncertainty:
        # The probability is the surrogate's at many points plus a correction from the samples: the fraction of samples
        # that are turned away, minus the fraction that fits to the other samples predict. The interval combines the
        # sampling errors of both with the probability of outcomes that no sample shows.
        design, sampling = self.design, self.sampling
        predicted = np.stack([expansion.at(design.standard(each)) for each in self._unit])
        known = ~self._beyond[..., None]
        shift = sampling.normal_quantile * expansion.errors
        unseen_by_fit = tables.critical - expansion.held_out.reshape(tables.critical.shape)
        shares = self._shares(np.where(known, predicted, np.inf))
        correction = self._turned(tables.critical) - self._turned(unseen_by_fit)
        # With one change of outcome in each sample, the probability increases with the angle, but the correction may
        # decrease.
        middle = np.clip(np.maximum.accumulate(shares.mean(axis=0) + correction.mean(axis=0)), 0.0, 1.0)
        # Points of a low-discrepancy sequence scatter less than independent ones, so the interval is conservative.
        error = sampling.normal_quantile * correction.std(axis=0, ddof=1) / math.sqrt(len(correction))
        half = np.hypot(share_half_width(shares, sampling, tables.base_samples), error)
        beyond = self._beyond.mean()
        moments = expansion_moments(expansion, design.choice_weights, sampling)
        weights = np.broadcast_to(design.weights / SURROGATE_POINTS, predicted.shape) * known
        flat, weights = predicted.reshape(SCRAMBLINGS, -1), weights.reshape(SCRAMBLINGS, -1)
        shifts = np.broadcast_to(shift, predicted.shape).reshape(SCRAMBLINGS, -1)
        unseen = share_estimate(np.zeros(SCRAMBLINGS), sampling, tables.base_samples)
        return self._assemble(
            tables,
            curve=(middle, np.clip(middle - half, 0.0, 1.0), np.clip(middle + half + beyond, 0.0, 1.0)),
            moments=(moments.mean, moments.standard_deviation),
            quantiles=quantile_estimates(flat, weights, LEVELS, sampling, shifts),
            after_shots=self._after_shots(self._unit, predicted, weights.reshape(predicted.shape)),
            without=unseen,
            order=expansion.basis.order,
            indices=self._surrogate_indices(moments),
        )

    def _shares(self, values: FloatArray) -> FloatArray:
        """Return the (scramblings, angles) fractions of critical angles up to each angle of the curve.

        Parameters
        ----------
        values
            (scramblings, n, alternatives) critical angles. [rad]
        """
        places = [[np.searchsorted(np.sort(column), self.angles, side="right") for column in part.T] for part in values]
        shares: FloatArray = np.einsum("k,rka->ra", self.design.weights, np.array(places) / values.shape[1])
        return shares

    def _turned(self, values: FloatArray) -> FloatArray:
        """Return, at each point, the weight of the alternatives that are turned away at each angle of the curve."""
        found = values.reshape(-1, self.design.alternatives)
        return np.stack([(found <= angle) @ self.design.weights for angle in self.angles], axis=-1)

    def _direct(self, tables: Tables) -> AngleUncertainty:
        sampling = self.sampling
        shares, unknown = tables.turned_away, tables.unknown
        half = share_half_width(shares, sampling, tables.base_samples)
        probability, doubt = shares.mean(axis=0), unknown.mean()
        angles, weights = tables.critical, tables.weights
        found = ~np.isnan(angles)
        moments: tuple[Estimate | None, Estimate | None] = (None, None)
        quantiles: tuple[tuple[float, Estimate], ...] = ()
        after_shots: tuple[AfterShots, ...] = ()
        if found.any():
            values = np.where(found, angles, 0.0).reshape(SCRAMBLINGS, -1)
            shared = np.where(found, weights, 0.0).reshape(SCRAMBLINGS, -1)
            moments = moment_estimates(values, shared, sampling)
            quantiles = quantile_estimates(values, shared, LEVELS, sampling)
            unit = self.design.unit(tables.count)[:, : tables.count]
            after_shots = self._after_shots(unit, values.reshape(angles.shape), shared.reshape(angles.shape))
        without = np.where(found, 0.0, weights).reshape(SCRAMBLINGS, -1).sum(axis=1)
        return self._assemble(
            tables,
            curve=(
                probability,
                np.clip(probability - half, 0.0, 1.0),
                np.clip(probability + doubt + half, 0.0, 1.0),
            ),
            moments=moments,
            quantiles=quantiles,
            after_shots=after_shots,
            without=share_estimate(without, sampling, tables.base_samples),
            order=None,
            indices=[(None, None)] * len(self.design.uncertain),
        )

    def _assemble(
        self,
        tables: Tables,
        *,
        curve: tuple[FloatArray, FloatArray, FloatArray],
        moments: tuple[Estimate | None, Estimate | None],
        quantiles: tuple[tuple[float, Estimate], ...],
        after_shots: tuple[AfterShots, ...],
        without: Estimate,
        order: int | None,
        indices: Sequence[tuple[Estimate | None, Estimate | None]],
    ) -> AngleUncertainty:
        method: Literal["surrogate", "direct"] = "direct" if order is None else "surrogate"
        return AngleUncertainty(
            oblique_angles=self.angles,
            probability=curve[0],
            lower=curve[1],
            upper=curve[2],
            mean=moments[0],
            standard_deviation=moments[1],
            quantiles=quantiles,
            share_without=without,
            sensitivity=self._sensitivities(tables, indices, after_shots),
            convergence=(),
            converged=False,
            method=method,
            order=order,
            surrogate_error=None,
            samples=tables.samples,
            failed=tables.failed,
            outside=tables.outside,
            seed=self.sampling.seed,
        )

    def _after_shots(self, unit: FloatArray, angles: FloatArray, weights: FloatArray) -> tuple[AfterShots, ...]:
        """Return the expected ranges of the critical angle after further shots into the concrete.

        Parameters
        ----------
        unit
            (scramblings, n, inputs) points in (0, 1).
        angles, weights
            (scramblings, n, alternatives) critical angles at these points, and their weights, 0 without an angle. [rad,
            1]
        """
        if self.shots is None or not self.sensitivity:
            return ()
        found = []
        for each in self.shots[1]:
            shared = weights * each.weights(unit)[..., None]
            if not shared.any():
                return ()
            ends = np.quantile(angles.ravel(), RANGE, weights=shared.ravel(), method="inverted_cdf")
            found.append(AfterShots(each.shots, each.dispersion, *map(float, ends)))
        return tuple(found)

    def _sensitivities(
        self,
        tables: Tables,
        indices: Sequence[tuple[Estimate | None, Estimate | None]],
        after_shots: tuple[AfterShots, ...],
    ) -> tuple[Sensitivity, ...]:
        if not self.sensitivity:
            return ()
        place = None if self.shots is None else self.shots[0]
        return tuple(
            Sensitivity(
                each.field,
                first,
                total,
                tuple(change for number, change in tables.swing if number == i),
                after_shots if i == place else (),
            )
            for i, (each, (first, total)) in enumerate(zip(self.design.uncertain, indices, strict=True))
        )

    def _surrogate_indices(self, moments: Moments) -> list[tuple[Estimate, Estimate]]:
        order = [*self.design.continuous, *self.design.discrete]
        found = {i: (moments.first_order[place], moments.total[place]) for place, i in enumerate(order)}
        return [found[i] for i in range(len(order))]

    def _indices(self, tables: Tables, answer: AngleUncertainty) -> Steps:
        """Add Sobol indices by Saltelli's design to a result.

        The design takes two sets of samples, and mixtures of both. The first set consists of samples that are already
        computed, as many as the budget and `SENSITIVITY_SAMPLES` allow.
        """
        design, sampling = self.design, self.sampling
        inputs, count = len(design.uncertain), tables.count
        left = max(sampling.max_samples - tables.samples, 0)
        while count * SCRAMBLINGS * (inputs + 1) > left or count * SCRAMBLINGS > SENSITIVITY_SAMPLES:
            count //= 2
        size = count * SCRAMBLINGS
        if size < FEWEST_BASE_SAMPLES:
            warning = ModelWarning(
                "no_indices", f"the budget of {sampling.max_samples} samples leaves too few for sensitivity indices"
            )
            return replace(answer, warnings=(*answer.warnings, warning))
        unit = design.unit(tables.count)[:, :count]
        first, second = (unit[..., part : part + inputs].reshape(size, inputs) for part in (0, inputs))
        wanted = design.sampled(second)
        for i in range(inputs):
            mixed = first.copy()
            mixed[:, i] = second[:, i]
            wanted += design.sampled(mixed)
        results = yield Batch(wanted, answer)
        tables.count_problems(results)
        found = np.array([self._in_range(each) for each in results]).reshape(inputs + 1, size)
        places = design.alternative_at(first)
        base = tables.found[:, :count].reshape(size, -1)
        own = np.array([self._in_range(each[place]) for each, place in zip(base, places, strict=True)])
        keep = ~(np.isnan(found).any(axis=0) | np.isnan(own))
        counted = replace(answer, samples=tables.samples, failed=tables.failed, outside=tables.outside)
        warnings = self.warnings + _warnings(tables, counted)
        if not keep.all():
            warning = ModelWarning(
                "no_indices", f"{int((~keep).sum())} of {size} base samples have no outcome: there are no indices"
            )
            return replace(counted, warnings=(*warnings, warning))
        estimates = direct_indices(own, found[0], found[1:], sampling)
        indexed = zip(answer.sensitivity, estimates, strict=True)
        sensitivity = tuple(replace(each, first_order=first, total=total) for each, (first, total) in indexed)
        return replace(counted, sensitivity=sensitivity, warnings=warnings)

    def _in_range(self, found: Crossings) -> float:
        """Return the critical angle, or the bound of the search beyond which it lies; NaN without an outcome. [rad]"""
        if found.problem:
            return math.nan
        if not math.isnan(found.angle):
            return found.angle
        return self.bounds[0] if found.starts_turned_away else self.bounds[1]


def _half_width(answer: AngleUncertainty) -> float:
    """Return half the width of the widest interval of the probability curve. [1]"""
    return float((0.5 * (answer.upper - answer.lower)).max())


def _warnings(
    tables: Tables, answer: AngleUncertainty, beyond: npt.NDArray[np.bool_] | None = None
) -> tuple[ModelWarning, ...]:
    found = []
    if beyond is not None and beyond.any():
        detail = (
            f"{int(beyond.sum())} of the {beyond.size} points at which the surrogate is evaluated are outside what the "
            "model accepts: a distribution reaches too far. They count as not known: the upper end of each interval is "
            "as if all were turned away"
        )
        found.append(ModelWarning("samples_outside", detail))
    if tables.outside:
        detail = (
            f"{tables.outside} of {tables.samples} samples are outside what the model accepts: a distribution reaches "
            "too far. They count as not known: the upper end of each interval is as if all were turned away"
        )
        found.append(ModelWarning("samples_outside", detail))
    if tables.failed:
        detail = f"{tables.failed} of {tables.samples} samples could not be computed; they count as not known"
        found.append(ModelWarning("samples_failed", detail))
    if answer.share_without.value > 0.0 and answer.quantiles:
        share = f"{100.0 * answer.share_without.value:.3g}"
        share = "more than 99.9" if share == "100" else share
        given = "quantiles are of the others, too few for a mean"
        if answer.mean is not None:
            given = "mean, standard deviation and quantiles are of the others"
        detail = f"{share} % of the samples have no critical angle: {given}"
        found.append(ModelWarning("samples_without_angle", detail))
    return tuple(found)
