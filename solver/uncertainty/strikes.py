"""Strikes with uncertain inputs, and studies of their uncertainty on threads of this process."""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from solver.arrays import FloatArray
from solver.cancellation import ComputingThreads
from solver.checks import ParameterError, RicochetError, require, require_positive
from solver.flight import FlightConditions, flight_after
from solver.free_surface import ElasticPlastic, MohrCoulomb, decay_laws
from solver.prepared import Outcome, check_case
from solver.projectile import Projectile
from solver.resistance import (
    ConstantStrengthFactor,
    ObliquityPolynomial,
    OwnTests,
    PublishedTests,
    Resistance,
    StrengthFactor,
    held_from,
    shaped_as_finite_elements,
    usual_unless_given,
)
from solver.search.critical_angle import critical_angle
from solver.search.types import USUAL_SEARCH, Search
from solver.strike import Impact, Numerics, full_name, is_part, put, strike_parts
from solver.target import Target
from solver.trajectory import simulate
from solver.uncertainty.critical_angles import AngleStudy
from solver.uncertainty.distributions import Discrete
from solver.uncertainty.next_shot import RESIDUAL, next_shots
from solver.uncertainty.results import AngleUncertainty, Batch, Crossings, TrajectoryUncertainty
from solver.uncertainty.sampling import Point, Sampling, Uncertain, check_inputs, check_values, require_inputs
from solver.uncertainty.trajectories import Ending, TrajectoryStudy
from solver.warnings import body_warnings

Result = TypeVar("Result")
Answer = TypeVar("Answer", AngleUncertainty, TrajectoryUncertainty)

# At this interval, linear interpolation of the probability is off by at most 0.005 for the paper's strike.
USUAL_ANGLES = np.radians(np.linspace(5.0, 85.0, 161))
"""Default angles for the probability of ricochet: every 0.5° over the default range of a search. [rad]"""


THEORY = "resistance.theory"
"""Field name of the theory of the decay. Its values are names of decay laws; each selects a decay law and the S(θ) that
belongs to it."""
# Each S(θ) is meant for one decay law: eq. 9 gives the paper's angle with elastic-plastic decay, and for Mohr-Coulomb
# decay S(θ) was fitted to motions computed with finite elements.
PAIRED: Mapping[str, Callable[[StrengthFactor], StrengthFactor]] = {
    ElasticPlastic.name: lambda model: model,
    MohrCoulomb.name: shaped_as_finite_elements,
}
"""Functions that replace the S(θ) of a law of S by the S(θ) of a theory, by name of the theory."""


def by_theory(resistance: Resistance, theory: str) -> Resistance:
    """Replace the decay law and the S(θ) of a resistance by those of a theory; the inertia of the decay law is kept.

    Raises
    ------
    ParameterError
        If the theory is unknown.
    """
    require(theory in PAIRED, THEORY, f"must be one of {', '.join(map(repr, PAIRED))}, got {theory!r}")
    inertia = getattr(resistance.free_surface, "inertia", False)
    laws = {law.name: law for law in decay_laws(inertia=inertia)}
    return replace(resistance, free_surface=laws[theory], strength_factor=PAIRED[theory](resistance.strength_factor))


def scaled(model: StrengthFactor, factor: float) -> StrengthFactor:
    """Multiply all values of a law of the strength factor by a factor.

    Raises
    ------
    ParameterError
        If the factor is not above zero.
    """
    require_positive(RESIDUAL, factor)
    if isinstance(model, ConstantStrengthFactor):
        return replace(model, value=factor * model.value)
    if isinstance(model, ObliquityPolynomial):
        coefficients = tuple(factor * each for each in model.coefficients)
        return ObliquityPolynomial(coefficients=coefficients, held_from=held_from(model))
    if isinstance(model, OwnTests):
        return replace(model, residual=factor * model.residual)
    if isinstance(model, PublishedTests):
        model = replace(model.law, obliquity_shape=model.obliquity_shape)
    return replace(model, coefficient=factor * model.coefficient)


class SampledStrike:
    """Strike with uncertain inputs, from which samples are made.

    Parameters
    ----------
    parts
        Parts of the strike by name: ``projectile``, ``target``, ``impact``, ``resistance``, ``numerics``.
    uncertain
        Uncertain inputs with their distributions.

    Raises
    ------
    ParameterError
        If a field is not an input of the strike, or a distribution has stated values that the model does not accept.
    """

    def __init__(self, parts: Mapping[str, Any], uncertain: Sequence[Uncertain]) -> None:
        check_inputs(uncertain)
        resistance = parts["resistance"].without_shots(target=parts["target"], projectile=parts["projectile"])
        self._parts = {**parts, "resistance": resistance}
        self._paths = [each.field.split(".") for each in uncertain]
        for index, each in enumerate(uncertain):
            self._check(index, each)
        for index, each in enumerate(uncertain):
            check_values(index, each, partial(self.check, index))

    def check(self, index: int, value: Any) -> None:
        """Check a value of one input, with the others as in the strike.

        Raises
        ------
        ParameterError
            If the model does not accept the value.
        """
        parts = self._with([(self._paths[index], value)])
        check_case(parts["projectile"], parts["target"])

    def accepts(self, index: int, value: Any) -> bool:
        """Return whether the model accepts a value of one input, with the others as in the strike."""
        try:
            self.check(index, value)
        except ParameterError:
            return False
        return True

    def sample(self, values: Sequence[Any]) -> dict[str, Any]:
        """Return the parts of the strike with the given values of the uncertain inputs.

        Raises
        ------
        ParameterError
            If a value is outside its range.
        """
        return self._with(zip(self._paths, values, strict=True))

    def _with(self, values: Iterable[tuple[Sequence[str], Any]]) -> dict[str, Any]:
        parts, residual = dict(self._parts), None
        # The theory is applied first, because it replaces laws whose fields other inputs may change. For the same
        # reason, shorter names are applied before longer ones, and the factor on S last.
        for (name, *path), value in sorted(values, key=lambda each: (".".join(each[0]) != THEORY, len(each[0]))):
            field = ".".join((name, *path))
            if field == RESIDUAL:
                residual = value
            elif field == THEORY:
                parts[name] = by_theory(parts[name], value)
            else:
                parts[name] = put(parts[name], path, value)
        if residual is not None:
            resistance = parts["resistance"]
            parts["resistance"] = replace(resistance, strength_factor=scaled(resistance.strength_factor, residual))
        return parts

    def _check(self, index: int, uncertain: Uncertain) -> None:
        field = f"uncertain.{index}.field"
        if uncertain.field == RESIDUAL:
            return
        if uncertain.field == THEORY:
            values = getattr(uncertain.distribution, "values", ())
            names = f"must be discrete, of {' and '.join(map(repr, PAIRED))}"
            require(bool(values) and set(values) <= set(PAIRED), f"uncertain.{index}.distribution", names)
            return
        part: Any = self._parts
        for name in self._paths[index]:
            holder = part if isinstance(part, Mapping) else None
            known = (
                list(holder) if holder is not None else [each.name for each in fields(part)] if is_part(part) else []
            )
            require(name in known, field, f"{uncertain.field!r} is unknown; expected {', '.join(known) or 'none'}")
            part = holder[name] if holder is not None else getattr(part, name)
        discrete = isinstance(uncertain.distribution, Discrete)
        number = part is None or (isinstance(part, float | int) and not isinstance(part, bool))
        require(number or (discrete and len(self._paths[index]) > 1), field, f"{uncertain.field!r} is no number")


def critical_angle_uncertainty(
    *,
    projectile: Projectile,
    target: Target,
    velocity: float,
    uncertain: Sequence[Uncertain],
    angle_of_attack: float = 0.0,
    angular_velocity: float = 0.0,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    search: Search | None = None,
    oblique_angles: FloatArray | None = None,
    sampling: Sampling | None = None,
    sensitivity: bool = True,
    threads: int = 1,
) -> AngleUncertainty:
    """Compute the probability of ricochet as a function of the angle, and sensitivities of the critical angle.

    Parameters
    ----------
    projectile, target, velocity, angle_of_attack, angular_velocity, resistance, numerics, search
        As for `critical_angle`. [SI, rad]
    uncertain
        Inputs that scatter independently, each with its distribution.
    oblique_angles
        Increasing angles at which the probability is computed; every 0.5° from 5° to 85° unless given. [rad]
    sampling
        Accuracy, budget and seed.
    sensitivity
        Also compute Sobol indices and the swing of each input.
    threads
        Number of searches computed in parallel.

    Returns
    -------
    AngleUncertainty

    Raises
    ------
    ParameterError
        If a distribution or a field is not valid, or the budget of samples is less than these inputs need.

    Notes
    -----
    A polynomial chaos expansion replaces the search if every sample has one change of outcome, the error at held-out
    points is at most 0.1°, and its intervals are narrower; otherwise, outcomes at randomised Sobol points are counted.
    A sample that is outside the ranges of the model, or fails, counts as unknown and widens the intervals. So do
    outcomes that no search has shown: if n searches all have one change of outcome, up to about 3/n of all strikes may
    still have several, at 95 % confidence.

    Examples
    --------
    >>> answer = critical_angle_uncertainty(
    ...     projectile=projectile, target=target, velocity=238.0,
    ...     uncertain=[
    ...         Uncertain("impact.velocity", Normal(mean=238.0, coefficient_of_variation=0.01)),
    ...         Uncertain("target.compressive_strength", Lognormal(median=39e6, dispersion=0.12)),
    ...         Uncertain("resistance.free_surface", Discrete(values=[ElasticPlastic(), MohrCoulomb()])),
    ...     ],
    ... )
    >>> answer.probability, answer.mean, answer.sensitivity
    """
    impact = Impact(
        velocity=velocity, oblique_angle=0.0, angle_of_attack=angle_of_attack, angular_velocity=angular_velocity
    )
    parts = strike_parts(impact, projectile, target, resistance, numerics)
    uncertain = _named_in_full(uncertain, parts)
    for index, each in enumerate(uncertain):
        require(each.field != "impact.oblique_angle", f"uncertain.{index}.field", "is what a search varies")
    strike = SampledStrike(parts, uncertain)
    search = search or USUAL_SEARCH
    study = AngleStudy(
        uncertain,
        USUAL_ANGLES if oblique_angles is None else oblique_angles,
        sampling or Sampling(),
        sensitivity=sensitivity,
        bounds=search.bounds,
        accepts=strike.accepts,
        warnings=body_warnings(projectile),
        shots=next_shots(uncertain, projectile=projectile, target=target, resistance=usual_unless_given(resistance)),
    )

    def find(parts: dict[str, Any]) -> Crossings:
        motion = parts.pop("impact")
        names = ("velocity", "angle_of_attack", "angular_velocity")
        return Crossings.of(critical_angle(**parts, **{name: getattr(motion, name) for name in names}, search=search))

    def evaluate(point: Point) -> Crossings:
        try:
            return find(strike.sample(point))
        except RicochetError as error:
            return Crossings.of(error)

    return compute_study(study.steps(), evaluate, threads)


def trajectory_uncertainty(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    uncertain: Sequence[Uncertain],
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    flight: FlightConditions | None = None,
    sampling: Sampling | None = None,
    threads: int = 1,
) -> TrajectoryUncertainty:
    """Compute the probability of each outcome of a strike, and quantiles of depth and of the exit.

    Parameters
    ----------
    projectile, target, impact, resistance, numerics
        As for `simulate`. [SI, rad]
    flight
        Tilt and height of the face, and drag. If given, the result has quantiles of the flight distance; each flight
        takes about 25 ms.
    uncertain, sampling, threads
        As for `critical_angle_uncertainty`; ``impact.oblique_angle`` may scatter too.

    Returns
    -------
    TrajectoryUncertainty

    Raises
    ------
    ParameterError
        If a distribution or a field is not valid.
    """
    parts = strike_parts(impact, projectile, target, resistance, numerics)
    uncertain = _named_in_full(uncertain, parts)
    strike = SampledStrike(parts, uncertain)

    def evaluate(point: Point) -> Ending:
        try:
            sample = strike.sample(point)
            found = simulate(**sample, sample_interval=None)
        except RicochetError as error:
            return Ending.of(error)
        if flight is None or found.exit is None:
            return Ending.of(found)
        rear = found.outcome is Outcome.PERFORATED
        return Ending.of(found, flight_after(found.exit, projectile=sample["projectile"], conditions=flight, rear=rear))

    study = TrajectoryStudy(uncertain, sampling or Sampling(), warnings=body_warnings(projectile))
    return compute_study(study.steps(), evaluate, threads)


def _named_in_full(uncertain: Sequence[Uncertain], parts: Mapping[str, Any]) -> list[Uncertain]:
    """Return the inputs with full dotted names, even where only the last part was given."""
    require_inputs(uncertain)
    return [
        each
        if each.field.partition(".")[0] in parts
        else replace(each, field=full_name(parts, each.field, f"uncertain.{index}.field", RESIDUAL))
        for index, each in enumerate(uncertain)
    ]


def compute_study(
    steps: Generator[Batch[Answer], Sequence[Result], Answer],
    evaluate: Callable[[Point], Result],
    threads: int = 1,
    report: Callable[[int, float | None], None] = lambda *_: None,
) -> Answer:
    """Compute a study on threads of this process; return its result.

    Parameters
    ----------
    steps
        Generator that yields the batches of the study, such as `AngleStudy.steps()`.
    evaluate
        Function that returns the result at a point.
    threads
        Number of samples computed in parallel.
    report
        Function called with the number of samples done and the half width reached, which is None during the first
        batch.
    """
    with ComputingThreads(threads) as pool:
        batch, done = next(steps), 0
        while True:
            half_width = None if batch.so_far is None else batch.so_far.convergence[-1].half_width
            report(done, half_width)
            found = []
            for each in pool.map(evaluate, batch.points):
                found.append(each)
                done += 1
                report(done, half_width)
            try:
                batch = steps.send(found)
            except StopIteration as end:
                answer: Answer = end.value
                return answer
