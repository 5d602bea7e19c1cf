"""The verdict on a strike in one sentence: outcome, probability, and critical angle with its range."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.checks import RicochetError
from solver.prepared import Outcome
from solver.projectile import Projectile
from solver.resistance import EQUATION_9, Resistance
from solver.search.critical_angle import critical_angle
from solver.search.types import USUAL_SEARCH, Search, SearchStatus
from solver.strike import USUAL, Impact, Numerics
from solver.target import Target
from solver.trajectory import simulate
from solver.uncertainty.results import RANGE, AfterShots
from solver.uncertainty.sampling import Sampling
from solver.uncertainty.strikes import critical_angle_uncertainty
from solver.uncertainty.usual import THEORIES, usual_scatter
from solver.uncertainty.weighed_warnings import probes, weighed, with_probe
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
    """90 % range of the critical angle with the usual scatter; None if no sample has an angle. [rad]"""
    share_without: float
    """Share of the samples without a critical angle. [1]"""
    theories: tuple[float | None, ...]
    """Critical angle by elastic-plastic and by Mohr-Coulomb decay, other inputs at their medians. [rad]"""
    standard_error: float | None = None
    """Of the critical angle, from the covariance of the strength factor; None without one. [rad]"""
    other_crossings: tuple[float, ...] = ()
    """Other angles at which the outcome changes. [rad]"""
    oblique_angle: float | None = None
    """Angle to judge, if any. [rad]"""
    outcome: Outcome | None = None
    """Of the strike at that angle, with the inputs as given; None without an angle or an outcome."""
    probability: float | None = None
    """Of ricochet at that angle, with the usual scatter; None without one. [1]"""
    warnings: tuple[ModelWarning, ...] = ()
    """Of the search; with a range, standing where they move the angle by less than a quarter of it."""

    @property
    def range_text(self) -> str:
        """The range in words, with the decimals that its width deserves; empty without one."""
        return "" if self.spread is None else _range_text(self.spread)

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return " ".join(filter(None, (self._judged(), "; ".join([self._angle(), *self._more()]) + ".")))

    def __str__(self) -> str:
        return self.sentence

    @property
    def _decimals(self) -> int:
        return 2 if self.spread is None else _decimals_of(self.spread)

    def _judged(self) -> str:
        if self.oblique_angle is None or self.outcome is None:
            return ""
        text = f"At {math.degrees(self.oblique_angle):.6g}° from the normal: {ENDINGS[self.outcome]}"
        if self.probability is None:
            return f"{text}."
        of = "" if self.outcome is Outcome.RICOCHET else " of ricochet"
        return f"{text} (probability{of} {_share(self.probability)})."

    def _angle(self) -> str:
        lower, upper = (f"{math.degrees(each):.6g}°" for each in self.searched)
        if self.angle is not None:
            error = "" if self.standard_error is None else f" ± {_degrees(self.standard_error, 2)}"
            text = f"Critical angle {self._fine(self.angle)}{error} from the normal"
        elif self.status is SearchStatus.NO_RICOCHET:
            text = f"No critical angle: nothing from {lower} to {upper} is turned away"
        elif self.status is SearchStatus.ALWAYS_RICOCHET:
            text = f"Critical angle below {lower}: everything from there to {upper} is turned away"
        else:
            text = "Critical angle not known: the search did not converge"
        if self.spread is not None:
            text += f", 90 % range {self.range_text}"
        if self.share_without >= 0.005:
            text += f", {100.0 * self.share_without:.0f} % of the samples without one from {lower} to {upper}"
        return text

    def _more(self) -> list[str]:
        weighed = zip(THEORY_NAMES, THEORIES, self.theories, strict=True) if self.theories else ()
        theories = [
            f"{name} decay (weight {weight:g}) {self._fine(angle)}"
            for name, weight, angle in weighed
            if angle is not None
        ]
        found = [", ".join(theories)] if theories else []
        if self.other_crossings:
            found.append(f"the outcome also changes at {', '.join(map(self._fine, self.other_crossings))}")
        return found

    def _fine(self, angle: float) -> str:
        return _degrees(angle, min(self._decimals + 1, 2))


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


def _share(value: float) -> str:
    if value < 0.005:
        return "below 0.01"
    return "above 0.99" if value > 0.995 else f"{value:.2f}"


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
    threads: int = 1,
) -> Verdict:
    """Judge a strike: its outcome, the probability of ricochet, and the critical angle with its range.

    Parameters
    ----------
    projectile, target, velocity, angle_of_attack, angular_velocity, resistance, numerics, search
        As for `critical_angle`. [SI, rad]
    oblique_angle
        Angle to judge, if any. [rad]
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
    study = critical_angle_uncertainty(
        **case,
        **motion,
        search=search,
        uncertain=usual_scatter(
            projectile=projectile,
            target=target,
            velocity=velocity,
            angle_of_attack=angle_of_attack,
            resistance=resistance,
        ),
        oblique_angles=np.radians(np.linspace(start, stop, count)),
        sampling=Sampling(max_samples=SAMPLES, half_width=HALF_WIDTH),
        threads=threads,
    )
    found = critical_angle(**case, **motion, search=search)
    levels = {level: estimate.value for level, estimate in study.quantiles}
    spread = (levels[RANGE[0]], levels[RANGE[1]]) if levels else None
    judged: dict[str, Any] = {}
    if oblique_angle is not None:
        impact = Impact(oblique_angle=oblique_angle, **motion)
        judged["outcome"] = simulate(**case, impact=impact, sample_interval=None).outcome
        place = int(np.abs(study.oblique_angles - oblique_angle).argmin())
        if abs(study.oblique_angles[place] - oblique_angle) < SAME_ANGLE:
            judged["probability"] = float(study.probability[place])
    return Verdict(
        status=found.status,
        angle=found.angle,
        searched=search.bounds,
        spread=spread,
        share_without=study.share_without.value,
        theories=tuple(change.angle for change in study.sensitivity[-1].swing),
        standard_error=found.standard_error,
        other_crossings=found.other_crossings,
        oblique_angle=oblique_angle,
        warnings=weighed(
            found.warnings,
            angle=found.angle,
            spread=spread,
            moved=_moved(found.warnings, case, motion, search),
        ),
        **judged,
    )


def _moved(
    warnings: Sequence[ModelWarning], case: Mapping[str, Any], motion: Mapping[str, Any], search: Search
) -> dict[str, list[float | None]]:
    """Return the critical angles by the probes of the warnings, None where there is none."""
    laws: dict[str, Any] = {"resistance": case["resistance"] or EQUATION_9, "numerics": case["numerics"] or USUAL}
    bodies = {name: case[name] for name in ("projectile", "target")}

    def angle(code: str, value: float) -> float | None:
        changed = with_probe(code, value, **laws)
        try:
            return critical_angle(**bodies, **changed, **motion, search=search).angle
        except RicochetError:  # must not cost the verdict itself
            return None

    found = probes([each.code for each in warnings], **bodies, **laws)
    return {code: [angle(code, value) for value in values] for code, values in found.items()}
