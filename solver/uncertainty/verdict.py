"""Verdict on a strike in words: outcome, probability of ricochet, and critical angle with its range."""

import math
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, TypeAlias

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
from solver.uncertainty.results import RANGE, AfterShots
from solver.uncertainty.sampling import Estimate, Sampling
from solver.uncertainty.strikes import THEORY, critical_angle_uncertainty
from solver.uncertainty.usual import has_own_law, usual_scatter
from solver.uncertainty.walls import WallVerdict, embedded_words, judge_wall
from solver.uncertainty.weighed_warnings import (
    HELD,
    HELD_EARLIER,
    probes,
    range_held_earlier,
    weighed,
    with_probe,
)
from solver.warnings import DEEPER_THAN_FORMULAS, ModelWarning

# With two theories a study takes 270 searches if the surrogate fits, and 526 otherwise. Another round would exceed this
# budget.
SAMPLES, HALF_WIDTH = 1024, 0.05
"""Budget of samples, and half width of the intervals of probabilities at which sampling ends. [1, 1]"""
# Between two such angles, the probability for the paper's strike rises by 0.07 at most, and linear interpolation is off
# by 0.005 at most, far less than the half width of the intervals. The requested oblique angle is one of these angles if
# the search covers it.
STEP_DEG = 0.5
"""Interval between angles at which the probability is computed. [°]"""
# Conversion of the requested oblique angle between degrees and radians causes rounding errors.
SAME_ANGLE = 1e-9
"""Largest difference of angles that count as equal. [rad]"""
# A unit in the last digit shown should be a third of the width or less.
WHOLE_DEGREES, TENTHS = math.radians(3.0), math.radians(0.3)
"""Least widths of a range that is shown in whole degrees, and in tenths. [rad]"""
ENDINGS: Mapping[str, str] = {
    Outcome.RICOCHET: "ricochet",
    Outcome.EMBEDDED: "embedded",
    Outcome.IN_MOTION: "still in motion",
    Outcome.PERFORATED: "perforated",
}
"""Outcomes in words."""
COUNTED: Mapping[int, str] = {1: "one", 3: "three"}
"""Numbers of shots in words."""
# With a larger share, the 90 % range has less than 81 % of all samples.
MOST_WITHOUT = 0.1
"""Largest share of samples without a critical angle at which the range is called that of all samples. [1]"""
# Shrinking the range by less than a tenth does not justify a test; the value is arbitrary.
HARDLY_NARROWER = 0.9
"""Ratio of the expected width of the range to its present width, above which no more shots are advised. [1]"""
# The sentence should agree with the probability that it states: "is turned away" is wrong in at most one of ten cases.
LIKELY, UNLIKELY = 0.9, 0.1
"""Probability of ricochet above which a body "is turned away", and below which it "is not turned away". [1]"""
# A smaller probability would appear as 0 %.
ROUNDED_AWAY = 0.005
"""Distance of a probability from 0 or 1, below which a bound is shown instead. [1]"""
RANGE_FAILED = "the 90 % range could not be computed"
"""Part of the sentence of a verdict whose study failed or took too long."""
NO_RANGE_BY_PANELS = "no 90 % range by panels"
"""Part of the sentence of a verdict by `panels`, for which the study would take minutes and is omitted."""


class Question(NamedTuple):
    """Computation that a verdict needs."""

    kind: Literal["search", "study", "run", "wall"]
    """Kind of computation: a search for the critical angle, a study of it with the usual scatter, a run at the angle to
    judge, or a verdict on the wall."""
    theories: bool = False
    """True to include the theory of the decay among the inputs of a study, even if another law was chosen."""
    probe: tuple[str, float] | None = None
    """Code of a warning, and the value that the search for its effect changes, as for `with_probe`."""
    optional: bool = False
    """True if `verdict` goes on without the answer when its computation fails; otherwise it raises the error."""


class Spread(NamedTuple):
    """Part of the result of a study that enters a verdict."""

    range: tuple[float, float] | None
    """90 % range of the critical angle; None if no sample has one. [rad]"""
    share_without: float
    """Share of the samples without a critical angle. [1]"""
    theories: tuple[float | None, ...]
    """Critical angle with each theory of the decay; empty if the theory is not an input of the study. [rad]"""
    probability: Estimate | None
    """Probability of ricochet at the requested oblique angle; None if the curve does not include that angle. [1]"""

    @classmethod
    def of(
        cls,
        quantiles: Mapping[float, float],
        share_without: float,
        theories: Sequence[float | None],
        curve: Iterable[tuple[float, float, float, float]],
        oblique_angle: float | None,
    ) -> "Spread":
        """Extract the parts from the quantiles and the probability curve of a study.

        Parameters
        ----------
        quantiles
            Quantiles of the critical angle, by probability. [rad]
        curve
            Rows of angle [rad], probability, and both ends of its interval.
        oblique_angle
            Requested oblique angle, if any. [rad]
        """
        near = [
            Estimate(*estimate)
            for angle, *estimate in curve
            if oblique_angle is not None and abs(angle - oblique_angle) < SAME_ANGLE
        ]
        spread = (quantiles[RANGE[0]], quantiles[RANGE[1]]) if quantiles else None
        return cls(spread, share_without, tuple(theories), near[0] if near else None)


class Ended(NamedTuple):
    """Part of the result of the run at the requested oblique angle that enters a verdict."""

    outcome: Outcome | None = None
    protrusion: Protrusion | None = None
    warnings: tuple[ModelWarning, ...] = ()
    flight: Flight | None = None
    """Flight of the body after it has left the target, if it ricochets."""


Found: TypeAlias = CriticalAngle | Spread | Ended | WallVerdict | None
"""Answer to a question, of the type that belongs to its kind; None if it failed."""
Steps: TypeAlias = Generator[Mapping[str, Question], Mapping[str, Found], "Verdict"]
"""Generator that yields questions by name, receives their answers, and returns the verdict."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Assessment of a strike: outcome, probability of ricochet, and critical angle with its range."""

    status: SearchStatus
    """Status of the search with the inputs as given."""
    angle: float | None
    """Critical angle with the inputs as given; None if there is none. [rad]"""
    searched: tuple[float, float]
    """Lower and upper end of the range of the search. [rad]"""
    spread: tuple[float, float] | None
    """90 % range of the critical angle with the usual scatter, extended to include `angle` and `held_angle`; None if no
    sample has an angle, or if no range was computed. [rad]"""
    reason_without_range: str = ""
    """Part of the sentence that gives the reason why no range was computed; empty if it was."""
    share_without: float
    """Share of the samples without a critical angle. [1]"""
    theories: tuple[float | None, ...]
    """Critical angles with elastic-plastic and with Mohr-Coulomb decay, all other inputs at their medians; empty if the
    range over both theories was not computed. [rad]"""
    own_law: bool = False
    """True if the user chose a decay law or S; the range over both theories is then given separately."""
    theory_spread: tuple[float, float] | None = None
    """90 % range over both theories, if `own_law` is true. [rad]"""
    theory_range_failed: bool = False
    """True if the range over both theories was requested, but could not be computed."""
    held_angle: float | None = None
    """Critical angle with S held from 55° on, if S is held from 60° on, `angle` is above 55° and a range was requested.
    [rad]"""
    standard_error: float | None = None
    """Standard error of the critical angle, from the covariance of the strength factor; None without one. [rad]"""
    other_crossings: tuple[float, ...] = ()
    """Other angles at which ricochet begins or ends. [rad]"""
    oblique_angle: float | None = None
    """Requested oblique angle, if any. [rad]"""
    outcome: Outcome | None = None
    """Outcome of the strike at the requested oblique angle, with the inputs as given; None without such an angle, or
    without an outcome."""
    protrusion: Protrusion | None = None
    """Protrusion of the body from the rear face of a wall at the requested oblique angle; None if nothing protrudes, or
    if the body perforates."""
    flight: Flight | None = None
    """Flight of the body after a ricochet at the requested oblique angle; None without a ricochet."""
    probability: Estimate | None = None
    """Probability of ricochet at the requested oblique angle, given the usual scatter, and its sampling interval; None
    if it was not computed. [1]"""
    wall: WallVerdict | None = None
    """Verdict on the wall, if the target has a thickness; without a requested oblique angle it is for normal impact."""
    wall_failed: bool = False
    """True if the target has a thickness, but the strikes on its wall could not be computed."""
    warnings: tuple[ModelWarning, ...] = ()
    """Warnings about the strike at the requested oblique angle, about the search, and about own tests that went deeper
    than the formulas for a wall. If there is a range, warnings whose effect on the critical angle is at most a quarter
    of its width are standing notes."""

    @property
    def range_text(self) -> str:
        """`spread` as text, with more decimals if it is narrow; empty without a range."""
        return "" if self.spread is None else _range_text(self.spread)

    @property
    def range_name(self) -> str:
        """Name of `spread` in texts; it stands only for some samples if many others have no critical angle."""
        return "90 % range of the others" if self._is_of_others else "90 % range"

    @property
    def sentence(self) -> str:
        """Verdict in words."""
        angle = "; ".join([self._angle(), *self._more()]) + "."
        flight = "" if self.flight is None else str(self.flight)
        strike = [self._judged(), flight, angle, self._over_theories()]
        wall, design = self._wall()
        parts = [*strike, wall, design] if self._is_perforated_without_formulas else [wall, *strike, design]
        return " ".join(filter(None, parts))

    def __str__(self) -> str:
        return self.sentence

    @property
    def _decimals(self) -> int:
        # Without a range, a critical angle must not appear more precise than with the usual range of some degrees.
        return 0 if self.spread is None else _decimals_of(self.spread)

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
            text += " with the law chosen"
        share = f"{100.0 * self.share_without:.0f} % of the samples without one from {lower} to {upper}"
        if self.spread is not None and self._is_of_others:
            return f"{text}, {share}, {self.range_name} {self.range_text}"
        if self.spread is not None:
            text += f", {self.range_name} {self.range_text}"
        elif self.reason_without_range:
            text += f", {self.reason_without_range}"
        return f"{text}, {share}" if self.share_without >= 0.005 else text  # a smaller share would appear as 0 %

    def _more(self) -> list[str]:
        found = []
        if self.held_angle is not None:
            found.append(f"{self._fine(self.held_angle)} with S held from {math.degrees(HELD_EARLIER):g}°")
        if self.other_crossings:
            found.append(f"the outcome also changes at {', '.join(map(self._fine, self.other_crossings))}")
        return found

    def _over_theories(self) -> str:
        """Return a sentence on the range over both theories, if it is given separately."""
        if self.theory_spread is None:
            return "The range over the theories could not be computed." if self.theory_range_failed else ""
        return f"Over the theories: 90 % range {_range_text(self.theory_spread)}."

    @property
    def _is_of_others(self) -> bool:
        return self.share_without > MOST_WITHOUT

    @property
    def _is_perforated_without_formulas(self) -> bool:
        # The formulas then leave it open whether the wall is enough, but perforation in the model, which is
        # unconservative, shows that it is not.
        return self.outcome is Outcome.PERFORATED and self.wall is not None and self.wall.enough is None

    def _wall(self) -> tuple[str, str]:
        """Return the sentence on whether the wall is enough, and the sentences with its design values."""
        if self.wall is None:
            return "The wall is not judged: the strikes on it could not be computed." if self.wall_failed else "", ""
        answer, _, design = self.wall.sentence.partition(". ")
        return f"{answer}.", design

    def _fine(self, angle: float) -> str:
        return _degrees(angle, min(self._decimals + 1, 2))


def probability_text(probability: Estimate) -> str:
    """Format a probability in percent."""
    # Near 0 and 1 the bound of the sampling interval is shown, because no outcome is certain. The margins prevent
    # rounding from moving a bound that is a whole percentage to the next one.
    if probability.value > 1.0 - ROUNDED_AWAY:
        return f"above {min(math.floor(100.0 * probability.lower + 1e-9), 99)} %"
    if probability.value < ROUNDED_AWAY:
        return f"below {max(math.ceil(100.0 * probability.upper - 1e-9), 1)} %"
    return f"{100.0 * probability.value:.0f} %"


def next_shot_advice(now: tuple[float, float], after: Sequence[AfterShots]) -> str:
    """Compose a sentence on how much further shots into the same concrete would narrow the critical angle's range.

    Parameters
    ----------
    now
        90 % range of the critical angle. [rad]
    after
        Expected ranges, see `Sensitivity.after_shots`.
    """
    spread = _range_text(now)
    if after[-1].upper - after[-1].lower > HARDLY_NARROWER * (now[1] - now[0]):
        return (
            f"The 90 % range of the critical angle is {spread}; more shots into this concrete would hardly narrow it."
        )
    expected = [f"{_range_text((each.lower, each.upper))} after {COUNTED[each.shots]}" for each in after]
    return (
        f"The 90 % range of the critical angle is {spread}; with shots of your own into this concrete it is expected "
        f"to be {' and '.join(expected)}."
    )


def _decimals_of(spread: tuple[float, float]) -> int:
    """Return the number of decimals with which a range is shown in degrees, which depends on its width."""
    width = spread[1] - spread[0]
    return 0 if width >= WHOLE_DEGREES else 1 if width >= TENTHS else 2


def _range_text(spread: tuple[float, float]) -> str:
    return " to ".join(_degrees(each, _decimals_of(spread)) for each in spread)


def _degrees(angle: float, decimals: int) -> str:
    return f"{math.degrees(angle):.{decimals}f}°"


def probability_angles(oblique_angle: float | None, lower: float, upper: float) -> tuple[float, float, int]:
    """Return the first and last angle of the probability curve [°], and the number of angles.

    The curve includes the requested oblique angle if it is in the range of the search, and the range is wide enough.

    Parameters
    ----------
    oblique_angle
        Requested oblique angle, if any. [°]
    lower, upper
        Range of the search. [°]
    """
    inside = oblique_angle is not None and lower <= oblique_angle <= upper
    shift = math.fmod(oblique_angle - lower, STEP_DEG) if inside and oblique_angle is not None else 0.0
    # The margin prevents rounding from dropping the last angle of a range that is a whole number of steps.
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
        Requested oblique angle, if any. [rad]
    flight
        Tilt and height of the face, for the flight of a body that is turned away at the requested oblique angle; a
        face level with the ground unless given.
    threads
        Number of searches computed in parallel.

    Returns
    -------
    Verdict
        Verdict whose ``str`` is the sentence that the page, the report, the service and the command line show.

    Raises
    ------
    ParameterError
        If an input is outside its range.
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
    laws: dict[str, Any] = {"resistance": usual_unless_given(resistance), "numerics": numerics or USUAL}

    def spread(*, theories: bool) -> Spread:
        uncertain = usual_scatter(
            projectile=projectile,
            target=target,
            velocity=velocity,
            angle_of_attack=angle_of_attack,
            resistance=resistance,
            theories=theories,
            strength_scatter=strength_scatter,
        )
        study = critical_angle_uncertainty(
            **case,
            **motion,
            search=search,
            uncertain=uncertain,
            oblique_angles=np.radians(np.linspace(start, stop, count)),
            sampling=Sampling(max_samples=SAMPLES, half_width=HALF_WIDTH),
            threads=threads,
        )
        by_theory = next((each.swing for each in study.sensitivity if each.field == THEORY), ())
        return Spread.of(
            {level: estimate.value for level, estimate in study.quantiles},
            study.share_without.value,
            [each.angle for each in by_theory],
            np.column_stack((study.oblique_angles, study.probability, study.lower, study.upper)).tolist(),
            oblique_angle,
        )

    def found(question: Question) -> Found:
        if question.kind == "study":
            return spread(theories=question.theories)
        if question.kind == "search":
            changed = with_probe(*question.probe, **laws) if question.probe else {}
            return critical_angle(**case | changed, **motion, search=search, strength_scatter=strength_scatter)
        impact = Impact(oblique_angle=oblique_angle or 0.0, **motion)
        if question.kind == "wall":
            return judge_wall(**case, impact=impact)
        run = simulate(**case, impact=impact, sample_interval=None)
        landing = None
        if run.outcome is Outcome.RICOCHET and run.exit is not None:
            landing = flight_after(run.exit, projectile=projectile, conditions=flight)
        return Ended(run.outcome, run.protrusion, run.warnings, landing)

    def answer(question: Question) -> Found:
        try:
            return found(question)
        except RicochetError:
            if question.optional:
                return None
            raise

    steps = verdict_steps(projectile=projectile, target=target, **laws, search=search, oblique_angle=oblique_angle)
    return conclude(steps, lambda asked: {name: answer(question) for name, question in asked.items()})


def verdict_steps(
    *,
    projectile: Projectile,
    target: Target,
    resistance: Resistance,
    numerics: Numerics,
    search: Search,
    oblique_angle: float | None,
    ranged: bool = True,
) -> Steps:
    """Yield the questions of a verdict by name, receive their answers, and return the verdict.

    The generator itself computes no strike. The caller answers the questions in this process, in worker processes or on
    a cluster; questions that are yielded together may be answered in parallel.

    Parameters
    ----------
    projectile, target, resistance, numerics, search, oblique_angle
        As for `verdict`, with defaults filled in.
    ranged
        Whether to compute the 90 % range, which takes hundreds of searches.
    """
    own_law = has_own_law(resistance)
    asked = {"cra": Question("search")}
    if ranged:
        asked["uncertainty"] = Question("study", theories=not own_law)
    if ranged and own_law:
        asked["theories"] = Question("study", theories=True)
    if oblique_angle is not None:
        asked["judged"] = Question("run")
    if target.thickness is not None:
        asked["wall"] = Question("wall", optional=True)
    found: Mapping[str, Any] = yield asked
    searched: CriticalAngle = found["cra"]
    values = probes(
        [each.code for each in searched.warnings],
        angle=searched.angle,
        projectile=projectile,
        target=target,
        resistance=resistance,
        numerics=numerics,
    )
    weighing = {
        f"{code} {index}": Question("search", probe=(code, value), optional=True)
        for code, tried in values.items()
        for index, value in enumerate(tried)
    }
    again: Mapping[str, Any] = (yield weighing) if ranged and weighing else {}
    moved: dict[str, list[float | None]] = {code: [] for code in values}
    for name in weighing:
        answer = again.get(name)
        moved[name.split()[0]].append(None if answer is None else answer.angle)
    nothing = Spread(None, 0.0, (), None)
    reason = "" if found.get("uncertainty") else RANGE_FAILED if ranged else NO_RANGE_BY_PANELS
    judging: Spread = found.get("uncertainty") or nothing
    over_theories: Spread = (found.get("theories") or nothing) if own_law else judging
    ended: Ended = found.get("judged") or Ended()
    held = next(iter(moved.get(HELD, ())), None)
    spread = range_held_earlier(range_with(judging.range, searched.angle), searched.angle, held)
    wall: WallVerdict | None = found.get("wall")
    return Verdict(
        status=searched.status,
        angle=searched.angle,
        searched=search.bounds,
        spread=spread,
        reason_without_range=reason,
        share_without=judging.share_without,
        theories=over_theories.theories,
        own_law=own_law,
        held_angle=held,
        theory_spread=over_theories.range if own_law else None,
        theory_range_failed="theories" in asked and not found.get("theories"),
        standard_error=searched.standard_error,
        other_crossings=searched.other_crossings,
        oblique_angle=oblique_angle,
        outcome=ended.outcome,
        protrusion=ended.protrusion,
        flight=ended.flight,
        probability=judging.probability,
        wall=wall,
        wall_failed="wall" in asked and wall is None,
        warnings=(
            *with_those_of_strike(
                ended.warnings, weighed(searched.warnings, angle=searched.angle, spread=spread, moved=moved)
            ),
            # The other warnings about the wall concern the search for a least thickness, which the verdict omits.
            *(each for each in (wall.warnings if wall else ()) if each.code == DEEPER_THAN_FORMULAS),
        ),
    )


def conclude(steps: Steps, answer: Callable[[Mapping[str, Question]], Mapping[str, Found]]) -> "Verdict":
    """Run `verdict_steps` with a function that answers the questions; return the verdict."""
    asked = next(steps)
    try:
        while True:
            asked = steps.send(answer(asked))
    except StopIteration as end:
        found: Verdict = end.value
        return found


def range_with(spread: tuple[float, float] | None, angle: float | None) -> tuple[float, float] | None:
    """Return a range extended to include the angle with the inputs as given."""
    # The angle with the inputs as given may be an extreme, for example as a function of the angle of attack; then all
    # samples lie on one side of it. The inputs as given are as likely as any sample, so a range without their angle
    # would be wrong.
    if spread is None or angle is None:
        return spread
    return min(spread[0], angle), max(spread[1], angle)


def with_those_of_strike(strike: Sequence[ModelWarning], search: Sequence[ModelWarning]) -> tuple[ModelWarning, ...]:
    """Return the warnings about a strike, followed by the warnings about the search.

    If both have a warning with the same code, both are kept, because the strike is at the requested oblique angle and
    the search at other angles. A warning about the strike is left out if the text of a warning about the search begins
    with its text. A warning that is kept is a standing note if the warning about the search with the same code is one.
    """
    by_code = {each.code: each for each in search}
    kept = [
        replace(each, standing=by_code[each.code].standing) if each.code in by_code else each
        for each in strike
        if not any(other.detail.startswith(each.detail) for other in search)
    ]
    return (*kept, *search)
