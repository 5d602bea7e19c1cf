"""The verdict on a strike in one sentence: outcome, probability, and critical angle with its range."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver.checks import RicochetError
from solver.flight import Flight, FlightConditions, flight_after
from solver.prepared import Outcome, Protrusion
from solver.projectile import Projectile
from solver.resistance import Resistance, usual_unless_given
from solver.search.critical_angle import critical_angle
from solver.search.types import USUAL_SEARCH, CriticalAngle, Search, SearchStatus
from solver.strength_scatter import ScatterSource
from solver.strike import USUAL, Impact, Numerics
from solver.target import Target
from solver.trajectory import simulate
from solver.uncertainty.results import RANGE, AfterShots, AngleUncertainty
from solver.uncertainty.sampling import Estimate, Sampling
from solver.uncertainty.strikes import critical_angle_uncertainty
from solver.uncertainty.usual import THEORIES, has_own_law, usual_scatter
from solver.uncertainty.walls import WallVerdict, embedded_words, judge_wall
from solver.uncertainty.weighed_warnings import (
    HELD,
    HELD_EARLIER,
    probes,
    range_held_earlier,
    weighed,
    with_probe,
)
from solver.warnings import ModelWarning

SAMPLES, HALF_WIDTH = 1024, 0.05
"""Samples at most, and half width of the interval of each probability at which they end: half of those that may be
needed to give each theory a surrogate are enough for most strikes. [1, 1]"""
STEP_DEG = 0.5
"""Distance of the angles at which the probability is computed. [°]"""
SAME_ANGLE = 1e-9
"""[rad]"""
WHOLE_DEGREES, TENTHS = math.radians(3.0), math.radians(0.3)
"""Width of a range from which it is written in whole degrees, and in tenths. [rad]"""
ENDINGS: Mapping[str, str] = {
    Outcome.RICOCHET: "ricochet",
    Outcome.EMBEDDED: "embedded",
    Outcome.IN_MOTION: "still in motion",
    Outcome.PERFORATED: "perforated",
}
COUNTED: Mapping[int, str] = {1: "one", 3: "three"}
HARDLY = 0.9
"""Width of an expected range over that of the present one, from which shots are not worth their advice. [1]"""
LIKELY, UNLIKELY = 0.9, 0.1
"""Probabilities of ricochet above which a body is turned away, and below which it is not. [1]"""
ROUNDED_AWAY = 0.005
"""Probability that would be written as 0 %. [1]"""
THEORY_NAMES = ("elastic-plastic", "Mohr-Coulomb")


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What is said of a strike first, wherever it is said."""

    status: SearchStatus
    """Of the search with the inputs as given."""
    angle: float | None
    """Critical angle with the inputs as given; None without one. [rad]"""
    searched: tuple[float, float]
    """Ends of the search. [rad]"""
    spread: tuple[float, float] | None
    """90 % range of the critical angle with the usual scatter; None if no sample has an angle. The angle with the
    inputs as given belongs to it. [rad]"""
    share_without: float
    """Share of the samples without a critical angle. [1]"""
    theories: tuple[float | None, ...]
    """Critical angle by elastic-plastic and by Mohr-Coulomb decay, other inputs at their medians. [rad]"""
    own_law: bool = False
    """Whether the verdict is on a law of one's own, and that over the theories is beside it."""
    theory_spread: tuple[float, float] | None = None
    """90 % range over the theories where the verdict is on a law of one's own. [rad]"""
    held_angle: float | None = None
    """Critical angle with S held from 55° on, where it is held from 60° on and the angle is above 55°. [rad]"""
    standard_error: float | None = None
    """Of the critical angle, from the covariance of the strength factor; None without one. [rad]"""
    other_crossings: tuple[float, ...] = ()
    """Other angles at which the outcome changes. [rad]"""
    oblique_angle: float | None = None
    """Angle to judge, if any. [rad]"""
    outcome: Outcome | None = None
    """Of the strike at that angle, with the inputs as given; None without an angle or an outcome."""
    protrusion: Protrusion | None = None
    """How far the body then comes out of the rear face of a wall, without going through; None if it does not."""
    flight: Flight | None = None
    """From where the body leaves, if it is turned away."""
    probability: Estimate | None = None
    """Of ricochet at that angle, with the usual scatter and the interval of its sampling; None without one. [1]"""
    wall: WallVerdict | None = None
    """The verdict on the wall, if the target has a thickness; by normal impact without an angle to judge."""
    wall_failed: bool = False
    """Whether the target has a thickness and its wall could not be judged."""
    warnings: tuple[ModelWarning, ...] = ()
    """Of the strike at the angle to judge and of the search; with a range, standing where they move the angle by less
    than a quarter of it."""

    @property
    def range_text(self) -> str:
        """The range in words, with the decimals that its width deserves; empty without one."""
        return "" if self.spread is None else _range_text(self.spread)

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        angle = "; ".join([self._angle(), *self._more()]) + "."
        flight = "" if self.flight is None else str(self.flight)
        return " ".join(filter(None, (self._judged(), flight, angle, self._over_theories(), self._wall())))

    def __str__(self) -> str:
        return self.sentence

    @property
    def _decimals(self) -> int:
        return 2 if self.spread is None else _decimals_of(self.spread)

    def _judged(self) -> str:
        if self.oblique_angle is None or self.outcome is None:
            return ""
        text = f"At {math.degrees(self.oblique_angle):.6g}° from the normal"
        ending = embedded_words(self.protrusion) if self.outcome is Outcome.EMBEDDED else ENDINGS[self.outcome]
        if self.probability is None:
            return f"{text}, with the inputs as given: {ending}."
        share, nominal = probability_text(self.probability), f"with the inputs as given: {ending}."
        if self.probability.value > LIKELY:
            return f"{text} the projectile is turned away (probability {share})."
        if self.probability.value < UNLIKELY:
            return f"{text} the projectile is not turned away (probability of ricochet {share}); {nominal}"
        return f"{text} the projectile may be turned away (probability {share}); {nominal}"

    def _angle(self) -> str:
        lower, upper = (f"{math.degrees(each):.6g}°" for each in self.searched)
        if self.angle is not None:
            error = "" if self.standard_error is None else f" ± {_degrees(self.standard_error, 2)}"
            text = f"Critical angle {self._fine(self.angle)}{error} from the normal"
        elif self.status is SearchStatus.NO_RICOCHET:
            text = f"No critical angle: nothing from {lower} to {upper} is turned away"
        elif self.status is SearchStatus.ALWAYS_RICOCHET:
            rest = "" if self.other_crossings else f", and so is everything from there to {upper}"
            text = f"Critical angle below {lower}: a strike at {lower} is turned away{rest}"
        else:
            text = "Critical angle not known: the search did not converge"
        if self.own_law:
            text += " by the law chosen"
        if self.spread is not None:
            text += f", 90 % range {self.range_text}"
        if self.share_without >= 0.005:
            text += f", {100.0 * self.share_without:.0f} % of the samples without one from {lower} to {upper}"
        return text

    def _more(self) -> list[str]:
        found = [self._by_theory()] if self.theories and not self.own_law else []
        if self.held_angle is not None:
            found.append(f"{self._fine(self.held_angle)} with S held from {math.degrees(HELD_EARLIER):g}°")
        if self.other_crossings:
            found.append(f"the outcome also changes at {', '.join(map(self._fine, self.other_crossings))}")
        return list(filter(None, found))

    def _by_theory(self) -> str:
        weighed = zip(THEORY_NAMES, THEORIES, self.theories, strict=True)
        return ", ".join(
            f"{name} decay (weight {weight:g}) {self._fine(angle)}"
            for name, weight, angle in weighed
            if angle is not None
        )

    def _over_theories(self) -> str:
        """Return the range over the theories beside that of a law of one's own."""
        if not self.own_law or self.theory_spread is None:
            return ""
        return (
            "; ".join(
                filter(None, (f"Over the theories: 90 % range {_range_text(self.theory_spread)}", self._by_theory()))
            )
            + "."
        )

    def _wall(self) -> str:
        if self.wall is not None:
            return self.wall.sentence
        return "The wall is not judged: the strikes on it could not be computed." if self.wall_failed else ""

    def _fine(self, angle: float) -> str:
        return _degrees(angle, min(self._decimals + 1, 2))


def probability_text(probability: Estimate) -> str:
    """Return a probability in percent; near 0 and 1 the bound that its sampling interval has, as none is certain."""
    if probability.value > 1.0 - ROUNDED_AWAY:
        return f"above {min(math.floor(100.0 * probability.lower + 1e-9), 99)} %"
    if probability.value < ROUNDED_AWAY:
        return f"below {max(math.ceil(100.0 * probability.upper - 1e-9), 1)} %"
    return f"{100.0 * probability.value:.0f} %"


def next_shot_advice(now: tuple[float, float], after: Sequence[AfterShots]) -> str:
    """Return what shots of one's own are worth, in one sentence.

    Parameters
    ----------
    now
        90 % range of the critical angle. [rad]
    after
        As in the sensitivity to the factor on S.
    """
    spread = _range_text(now)
    if after[-1].upper - after[-1].lower > HARDLY * (now[1] - now[0]):
        return (
            f"The 90 % range of the critical angle is {spread}; more shots into this concrete would hardly narrow it."
        )
    expected = [f"{_range_text((each.lower, each.upper))} after {COUNTED[each.shots]}" for each in after]
    return (
        f"The 90 % range of the critical angle is {spread}; with shots of your own into this concrete it is expected "
        f"to be {' and '.join(expected)}."
    )


def _decimals_of(spread: tuple[float, float]) -> int:
    """Return the decimals that the width of a range deserves."""
    width = spread[1] - spread[0]
    return 0 if width >= WHOLE_DEGREES else 1 if width >= TENTHS else 2


def _range_text(spread: tuple[float, float]) -> str:
    return " to ".join(_degrees(each, _decimals_of(spread)) for each in spread)


def _degrees(angle: float, decimals: int) -> str:
    return f"{math.degrees(angle):.{decimals}f}°"


def probability_angles(oblique_angle: float | None, lower: float, upper: float) -> tuple[float, float, int]:
    """Return first, last and number of the angles at which the probability is computed, one of them that to judge.

    Parameters
    ----------
    oblique_angle
        To judge, if any. [°]
    lower, upper
        Range of the search: beyond it nothing is known. [°]
    """
    inside = oblique_angle is not None and lower <= oblique_angle <= upper
    shift = math.fmod(oblique_angle - lower, STEP_DEG) if inside and oblique_angle is not None else 0.0
    steps = math.floor((upper - lower - shift) / STEP_DEG + 1e-9)
    if steps < 1:
        return lower, upper, 2
    return lower + shift, lower + shift + steps * STEP_DEG, steps + 1


def verdict(
    *,
    projectile: Projectile,
    target: Target,
    velocity: float,
    oblique_angle: float | None = None,
    angle_of_attack: float = 0.0,
    angular_velocity: float = 0.0,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    search: Search | None = None,
    strength_scatter: ScatterSource = "law",
    flight: FlightConditions | None = None,
    threads: int = 1,
) -> Verdict:
    """Judge a strike: its outcome, the probability of ricochet, and the critical angle with its range.

    Parameters
    ----------
    projectile, target, velocity, angle_of_attack, angular_velocity, resistance, numerics, search, strength_scatter
        As for `critical_angle`. [SI, rad]
    oblique_angle
        Angle to judge, if any. [rad]
    flight
        How the face stands, for where a body lands that is turned away at that angle; level with the ground unless
        given.
    threads
        How many searches run at a time.

    Returns
    -------
    Verdict
        ``str`` of it is the sentence that the report, the service and the command line print.

    Raises
    ------
    ParameterError
        If an input is outside what the model accepts.
    IntegrationError
        If the strike could not be integrated.

    Examples
    --------
    >>> print(verdict(projectile=projectile, target=target, velocity=238.0, oblique_angle=math.radians(55.0)))
    """
    search = search or USUAL_SEARCH
    case: dict[str, Any] = {
        "projectile": projectile,
        "target": target,
        "resistance": resistance,
        "numerics": numerics,
    }
    motion: dict[str, Any] = {
        "velocity": velocity,
        "angle_of_attack": angle_of_attack,
        "angular_velocity": angular_velocity,
    }
    lower, upper = search.bounds
    ends = math.degrees(lower), math.degrees(upper)
    start, stop, count = probability_angles(None if oblique_angle is None else math.degrees(oblique_angle), *ends)

    def study(*, theories: bool) -> AngleUncertainty:
        return critical_angle_uncertainty(
            **case,
            **motion,
            search=search,
            uncertain=usual_scatter(
                projectile=projectile,
                target=target,
                velocity=velocity,
                angle_of_attack=angle_of_attack,
                resistance=resistance,
                theories=theories,
                strength_scatter=strength_scatter,
            ),
            oblique_angles=np.radians(np.linspace(start, stop, count)),
            sampling=Sampling(max_samples=SAMPLES, half_width=HALF_WIDTH),
            threads=threads,
        )

    own_law = has_own_law(resistance)
    judging = study(theories=not own_law)
    over_theories = study(theories=True) if own_law else judging
    found = critical_angle(**case, **motion, search=search, strength_scatter=strength_scatter)
    moved = _moved(found, case, motion, search)
    held = next(iter(moved.get(HELD, ())), None)
    spread = range_held_earlier(range_with(_range_of(judging), found.angle), found.angle, held)
    judged: dict[str, Any] = {}
    of_strike: tuple[ModelWarning, ...] = ()
    if oblique_angle is not None:
        impact = Impact(oblique_angle=oblique_angle, **motion)
        run = simulate(**case, impact=impact, sample_interval=None)
        judged |= {"outcome": run.outcome, "protrusion": run.protrusion}
        of_strike = run.warnings
        if run.outcome is Outcome.RICOCHET and run.exit is not None:
            judged["flight"] = flight_after(run.exit, projectile=projectile, conditions=flight)
        place = int(np.abs(judging.oblique_angles - oblique_angle).argmin())
        if abs(judging.oblique_angles[place] - oblique_angle) < SAME_ANGLE:
            judged["probability"] = Estimate(
                *(float(each[place]) for each in (judging.probability, judging.lower, judging.upper))
            )
    if target.thickness is not None:
        impact = Impact(oblique_angle=oblique_angle or 0.0, **motion)
        try:
            judged["wall"] = judge_wall(**case, impact=impact)
        except RicochetError:  # must not cost the rest of the verdict
            judged["wall_failed"] = True
    return Verdict(
        status=found.status,
        angle=found.angle,
        searched=search.bounds,
        spread=spread,
        share_without=judging.share_without.value,
        theories=tuple(change.angle for change in over_theories.sensitivity[-1].swing),
        own_law=own_law,
        held_angle=held,
        theory_spread=_range_of(over_theories) if own_law else None,
        standard_error=found.standard_error,
        other_crossings=found.other_crossings,
        oblique_angle=oblique_angle,
        warnings=with_those_of_strike(
            of_strike,
            weighed(
                found.warnings,
                angle=found.angle,
                spread=spread,
                moved=moved,
            ),
        ),
        **judged,
    )


def _range_of(study: AngleUncertainty) -> tuple[float, float] | None:
    levels = {level: estimate.value for level, estimate in study.quantiles}
    return (levels[RANGE[0]], levels[RANGE[1]]) if levels else None


def range_with(spread: tuple[float, float] | None, angle: float | None) -> tuple[float, float] | None:
    """Return a range that the angle with the inputs as given belongs to.

    The inputs as given are as likely as any sample. Where the angle is at its least or most with them, as it can be
    over the angle of attack, all samples lie to one side of it.
    """
    if spread is None or angle is None:
        return spread
    return min(spread[0], angle), max(spread[1], angle)


def with_those_of_strike(strike: Sequence[ModelWarning], search: Sequence[ModelWarning]) -> tuple[ModelWarning, ...]:
    """Return the warnings of a strike, then those of the search.

    A warning of the search does not take the place of one of the strike that has its code: the strike is at the angle
    to judge, the search speaks of others. What the search says in the same words and more is not repeated, and what it
    found to move the angle by little stands in both.
    """
    by_code = {each.code: each for each in search}
    kept = [
        replace(each, standing=by_code[each.code].standing) if each.code in by_code else each
        for each in strike
        if not any(other.detail.startswith(each.detail) for other in search)
    ]
    return (*kept, *search)


def _moved(
    searched: CriticalAngle, case: Mapping[str, Any], motion: Mapping[str, Any], search: Search
) -> dict[str, list[float | None]]:
    """Return the critical angles by the probes of a search, None where there is none."""
    laws: dict[str, Any] = {"resistance": usual_unless_given(case["resistance"]), "numerics": case["numerics"] or USUAL}
    bodies = {name: case[name] for name in ("projectile", "target")}

    def angle(code: str, value: float) -> float | None:
        changed = with_probe(code, value, **laws)
        try:
            return critical_angle(**bodies, **changed, **motion, search=search).angle
        except RicochetError:  # must not cost the verdict itself
            return None

    found = probes([each.code for each in searched.warnings], angle=searched.angle, **bodies, **laws)
    return {code: [angle(code, value) for value in values] for code, values in found.items()}
