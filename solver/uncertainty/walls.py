"""Verdict on a wall, and sentences that compare the model's least thickness or limit speed with the formulas.

A wall must prevent perforation, and scabbing, in which concrete breaks off the rear face. The design values come from
empirical formulas with the margins of DOE-STD-3014-2006. The thickness that the model requires is a lower bound on the
design value against perforation.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from solver.checks import require
from solver.formulas import (
    NAMES,
    PERFORATION_MARGIN,
    SCABBING_MARGIN,
    FormulaResult,
    formulas,
)
from solver.perforation import MOST_DIAMETERS, PerforationLimit, PerforationStatus, least_thickness, limit_velocity
from solver.prepared import Outcome, Protrusion
from solver.projectile import Projectile
from solver.resistance import Resistance, usual_unless_given
from solver.strength_scatter import ScatterSource, known_strength
from solver.strike import Impact, Numerics
from solver.target import Crater, ShearPlug, Target
from solver.trajectory import simulate
from solver.uncertainty.strikes import scaled
from solver.units import Amount, fixed, quantity, rounded, with_symbol
from solver.warnings import ModelWarning, own_tests_deeper_than_formulas

Question: TypeAlias = Literal["perforation", "scabbing"]
MARGINS: dict[Question, float] = {"perforation": PERFORATION_MARGIN, "scabbing": SCABBING_MARGIN}
"""Safety factors on the limit thicknesses against perforation and scabbing (DOE-STD-3014-2006). [1]"""
THIS_MODEL = "this_model"
"""Value of `DesignValue.formula` if the model requires a thicker wall than the formulas with their margin."""
# The range of a critical angle has the same probability, so all ranges are comparable.
PROBABILITY = 0.9
"""Probability of the range of a least thickness or a limit speed, due to the scatter of S. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignValue:
    """Required thickness of a wall against perforation or scabbing; all None if no formula is within its range."""

    limit: float | None = None
    """Largest limit thickness by the formulas within their range. [m]"""
    design: float | None = None
    """Design thickness: the limit with its margin or, if that is larger, the thickness that the model requires. [m]"""
    formula: str | None = None
    """Name of the formula that determines the design thickness; ``this_model`` if the model does."""
    by_formula: str | None = None
    """Name of the formula that gives the limit, even if the model determines the design thickness."""
    enough: bool | None = None
    """True if the target wall has at least the design thickness and, for perforation, nothing comes out of its
    rear face in the model; None without a wall or a design value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RearFaceVariants:
    """Limit by the model with and without a plug and a crater; None if there is no limit. [m or m/s]"""

    plain: float | None
    """Limit without a plug and a crater. [m or m/s]"""
    rear_plug: float | None
    """Limit with a plug. [m or m/s]"""
    rear_plug_and_crater: float | None
    """Limit with a plug and a crater. [m or m/s]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PerforationSpread:
    """Variation of a least thickness or a limit speed with S, with a plug, and with a crater."""

    range: tuple[float, float] | None
    """90 % range due to the scatter of S; None if there is no limit with S as given or at an end of its range. [m or
    m/s]"""
    variants: RearFaceVariants
    """Limits with and without a plug and a crater."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WallVerdict:
    """Verdict on a wall: required thicknesses against perforation and scabbing, and results of the model."""

    thickness: float | None
    """Thickness of the target wall; None if only design values are wanted. [m]"""
    oblique_angle: float
    """Oblique angle from the inward normal. [rad]"""
    compressive_strength: float
    """Mean compressive strength, also in the formulas if no characteristic strength is given. [Pa]"""
    perforation: DesignValue
    """Design value against perforation."""
    scabbing: DesignValue
    """Design value against scabbing."""
    normal_impact: tuple[float | None, float | None]
    """Design thicknesses against perforation and scabbing for the same speed along the normal. [m]"""
    variants: RearFaceVariants
    """Least thickness of a wall that is not perforated in the model. [m]"""
    outcome: Outcome | None = None
    """Outcome of the strike on the target wall in the model, with the resistance as given."""
    protrusion: Protrusion | None = None
    """Protrusion of the body from the rear face in the model; None if nothing protrudes, or if the body perforates."""
    characteristic_strength: float | None = None
    """Characteristic compressive strength, in the formulas; None if they use the mean. [Pa]"""
    warnings: tuple[ModelWarning, ...] = ()
    """Warnings about the search for the least thickness with the resistance as given, about own tests that went deeper
    than by every formula, and about the run on the wall."""

    sentence: str = ""
    """Verdict in words."""

    @property
    def enough(self) -> bool | None:
        """True if the wall is enough against perforation and scabbing, False if not against one of them, else None."""
        answers = [self.perforation.enough, self.scabbing.enough]
        return False if False in answers else None if None in answers else True

    def __str__(self) -> str:
        return self.sentence


def wall_sentence(wall: WallVerdict) -> str:
    """Compose the verdict on a wall in words."""
    return " ".join(filter(None, (_judged(wall), _required(wall), _normal(wall), _by_model(wall))))


def _questions(wall: WallVerdict) -> list[tuple[Question, DesignValue]]:
    """Return perforation and scabbing with their known design values, the larger value first."""
    both: list[tuple[Question, DesignValue]] = [("scabbing", wall.scabbing), ("perforation", wall.perforation)]
    known = [each for each in both if each[1].design is not None]
    return sorted(known, key=lambda each: -(each[1].design or 0.0))


def _judged(wall: WallVerdict) -> str:
    if wall.thickness is None:
        return ""
    text = f"Wall of {_length(wall.thickness)} at {math.degrees(wall.oblique_angle):.6g}° from the normal"
    missed = [name for name, value in _questions(wall) if value.enough is False]
    if missed:
        # Without these words, a reader would assume that the wall is enough against the other at any angle.
        oblique = [name for name, value in _questions(wall) if value.enough and _is_thinner_than_normal(wall, name)]
        also = f"; enough against {oblique[0]} at this angle only" if oblique else ""
        return f"{text}: not enough against {' and '.join(missed)}{also}."
    if not wall.enough:
        return f"{text}: not known to be enough."
    # Design practice assumes normal impact, so readers would take "enough" alone as valid for all angles.
    return f"{text}: enough at this angle only." if _is_thinner_than_normal(wall) else f"{text}: enough."


def _is_thinner_than_normal(wall: WallVerdict, *questions: Question) -> bool:
    """Return whether a wall that is struck obliquely is thinner than a design value for normal impact.

    Parameters
    ----------
    *questions
        Questions whose design values count; all, if none is given.
    """
    by_name: dict[Question, float | None] = dict(zip(MARGINS, wall.normal_impact, strict=True))
    largest = max(by_name[name] or 0.0 for name in questions or by_name)
    return wall.thickness is not None and wall.oblique_angle != 0.0 and wall.thickness < largest


def _required(wall: WallVerdict) -> str:
    questions = _questions(wall)
    if not questions:
        return "No design value: no formula is within the range of its tests."
    asked = [f"against {name} {_thickness(value.design or 0.0)} ({_reason(name, value)})" for name, value in questions]
    text = f"Design value {', '.join(asked)}"
    if wall.characteristic_strength is not None:
        text += f", with the characteristic strength of {quantity(wall.characteristic_strength, 'MPa')}"
    else:
        mean = quantity(wall.compressive_strength, "MPa")
        text += f", with the mean strength of {mean}, as no characteristic strength is given"
    if len(questions) == 1:
        other = "perforation" if questions[0][0] == "scabbing" else "scabbing"
        text += f"; none against {other}: no formula is within the range of its tests"
    return f"{text}."


def _normal(wall: WallVerdict) -> str:
    """Compose a sentence with the design values for normal impact, which design practice uses."""
    by_name: dict[Question, float | None] = dict(zip(MARGINS, wall.normal_impact, strict=True))
    known = [(name, value) for name, value in by_name.items() if value is not None]
    if not known or wall.oblique_angle == 0.0:
        return ""
    known.sort(key=lambda each: -each[1])
    values = ", ".join(f"{_thickness(value)} against {name}" for name, value in known)
    text = f"For normal impact, which design practice takes: {values}"
    if wall.enough and _is_thinner_than_normal(wall):
        text += "; this wall is thinner"
    return f"{text}."


def _by_model(wall: WallVerdict) -> str:
    """Compose a sentence with the results of the model, which must not be used for design."""
    found = []
    if wall.outcome is Outcome.PERFORATED:
        found.append("perforated")
    elif wall.protrusion is not None and wall.outcome is Outcome.EMBEDDED:
        found.append(embedded_words(wall.protrusion))
    elif wall.protrusion is not None:
        found.append(f"{_length(wall.protrusion.greatest)} out of the rear face on its way")
    needs = [
        f"{_thickness(value)}{words}"
        for value, words in (
            (wall.variants.plain, ""),
            (wall.variants.rear_plug, " with a plug"),
            (wall.variants.rear_plug_and_crater, " with a plug and a crater"),
        )
        if value is not None
    ]
    if needs:
        found.append(f"not perforated from {', '.join(needs)} on")
    return f"By this model, which is unconservative: {'; '.join(found)}." if found else ""


def embedded_words(protrusion: Protrusion | None) -> str:
    """Describe an embedded body in words, with its protrusion from the rear face of a wall, if any."""
    if protrusion is None or not protrusion.final:
        return "embedded"
    return f"embedded, its nose {_length(protrusion.final)} out of the rear face"


def judge_wall(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
) -> WallVerdict:
    """Judge a wall: whether it is thick enough against perforation and against scabbing.

    Parameters
    ----------
    projectile, impact
        Projectile, and its motion at first contact. [SI, rad]
    target
        Wall. Without a thickness, the verdict has only design values and the least thicknesses by the model. The
        formulas use the characteristic strength if it is given; the model uses the mean.
    resistance, numerics
        As for `simulate`, except that the method is always adaptive.

    Returns
    -------
    WallVerdict
        Verdict whose ``str`` is the sentence that the page, the report, the service and the command line show.

    Raises
    ------
    ParameterError
        If an input is outside its range, or the strike has no velocity along the normal.
    IntegrationError
        If a run could not be integrated.

    Notes
    -----
    The limits are the largest results of the formulas within their range. The design values are 1.2 times the limit
    against perforation and 1.1 times the limit against scabbing (DOE-STD-3014-2006). Against perforation the design
    value is at least the thickness with which no part of the body comes out of the rear face in the model, both with
    the resistance as given and with a plug and a crater. The formulas use the component of the speed along the normal;
    design practice uses the full speed, as `normal_impact` does.

    Examples
    --------
    >>> print(judge_wall(projectile=projectile, target=wall, impact=Impact(velocity=136.0, oblique_angle=0.0)))
    """
    own, infinite = usual_unless_given(resistance), replace(target, thickness=None)
    if numerics is not None:
        # A run with panels takes seconds, and the searches below need about a hundred runs.
        numerics = replace(numerics, method="adaptive")
    characteristic = target.characteristic_strength
    if characteristic is not None:
        require(
            characteristic <= target.compressive_strength,
            "target.characteristic_strength",
            "must be at most the compressive strength, which is the mean, {}, got {}",
            Amount(target.compressive_strength, "MPa"),
            Amount(characteristic, "MPa"),
        )

    def searched(motion: Impact, law: Resistance) -> PerforationLimit:
        return least_thickness(projectile=projectile, target=infinite, impact=motion, resistance=law, numerics=numerics)

    plain, plugged, weakest = rear_face_variants(own)
    found = [searched(impact, law) for law in (plain, plugged, weakest)]
    as_given = next(
        (each for each, law in zip(found, (plain, plugged, weakest), strict=True) if law == own), None
    ) or searched(impact, own)
    along = replace(impact, oblique_angle=0.0)
    at_normal = found[2] if impact.oblique_angle == 0.0 else searched(along, weakest)
    design_target = infinite
    if characteristic is not None:
        design_target = replace(infinite, compressive_strength=characteristic)
    answers = _design_values(
        projectile, design_target, impact, needed=max(map(_needed(projectile), (as_given, found[2])))
    )
    at_0 = _design_values(projectile, design_target, along, needed=_needed(projectile)(at_normal))
    outcome, protrusion, warnings = None, None, as_given.warnings
    warnings += own_tests_deeper_than_formulas(projectile=projectile, target=infinite, resistance=own)
    if target.thickness is not None:
        run = simulate(
            projectile=projectile, target=target, impact=impact, resistance=own, numerics=numerics, sample_interval=None
        )
        outcome = run.outcome
        protrusion = run.protrusion
        warnings = tuple({each.code: each for each in (*warnings, *run.warnings)}.values())
        comes_out = outcome is Outcome.PERFORATED or protrusion is not None
        answers = {
            name: replace(
                value,
                enough=None
                if value.design is None
                else target.thickness >= value.design and not (name == "perforation" and comes_out),
            )
            for name, value in answers.items()
        }
    wall = WallVerdict(
        thickness=target.thickness,
        oblique_angle=impact.oblique_angle,
        compressive_strength=target.compressive_strength,
        perforation=answers["perforation"],
        scabbing=answers["scabbing"],
        normal_impact=(at_0["perforation"].design, at_0["scabbing"].design),
        variants=RearFaceVariants(plain=found[0].value, rear_plug=found[1].value, rear_plug_and_crater=found[2].value),
        outcome=outcome,
        protrusion=protrusion,
        characteristic_strength=characteristic,
        warnings=warnings,
    )
    return replace(wall, sentence=wall_sentence(wall))


def _design_values(
    projectile: Projectile, target: Target, impact: Impact, *, needed: float
) -> dict[Question, DesignValue]:
    """Return the design values of a strike; `needed` is the thickness that the model requires. [m]"""
    rows = formulas(projectile=projectile, target=target, impact=impact)
    found: dict[Question, DesignValue] = {}
    for name, margin in MARGINS.items():
        limits = [
            (limit, row.formula)
            for row in rows
            if row.in_range and (limit := getattr(row, f"{name}_thickness")) is not None
        ]
        if not limits:
            found[name] = DesignValue()
            continue
        limit = max(each for each, _ in limits)
        formula = next(
            formula for each, formula in limits if each == limit
        )  # the first of equal results, such as Kar's and NDRC's
        design, decides = margin * limit, formula
        if name == "perforation" and needed > design:
            design, decides = needed, THIS_MODEL
        found[name] = DesignValue(limit=limit, design=design, formula=decides, by_formula=formula)
    return found


def _needed(projectile: Projectile) -> Callable[[PerforationLimit], float]:
    """Return a function from a search result to the least thickness with which nothing comes out at the rear. [m]"""

    def of(found: PerforationLimit) -> float:
        if found.status is PerforationStatus.ALWAYS_PERFORATED:
            return MOST_DIAMETERS * projectile.diameter  # even the thickest wall tried is perforated
        return max(found.value or 0.0, found.without_protrusion or 0.0)

    return of


def rear_face_variants(resistance: Resistance) -> tuple[Resistance, Resistance, Resistance]:
    """Return a resistance without plug and crater, with a plug, and with both; given parameters of these are kept."""
    plain = replace(resistance, rear_plug=None, crater=None)
    plugged = replace(plain, rear_plug=resistance.rear_plug or ShearPlug())
    return plain, plugged, replace(plugged, crater=resistance.crater or Crater())


def thickness_spread(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    strength_scatter: ScatterSource = "law",
) -> PerforationSpread:
    """Compute the range of a least thickness due to the scatter of S, and its values with a plug and with a crater.

    Arguments and errors are those of `least_thickness`; `strength_scatter` is that of `known_strength`.
    """

    def find(law: Resistance) -> float | None:
        return least_thickness(
            projectile=projectile, target=target, impact=impact, resistance=law, numerics=numerics
        ).value

    return _spread(find, projectile, target, usual_unless_given(resistance), strength_scatter)


def limit_speed_spread(
    *,
    projectile: Projectile,
    target: Target,
    oblique_angle: float,
    angle_of_attack: float = 0.0,
    angular_velocity: float = 0.0,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    strength_scatter: ScatterSource = "law",
) -> PerforationSpread:
    """Compute the range of a limit speed due to the scatter of S, and its values with a plug and with a crater.

    Arguments and errors are those of `limit_velocity`; `strength_scatter` is that of `known_strength`.
    """

    def find(law: Resistance) -> float | None:
        return limit_velocity(
            projectile=projectile,
            target=target,
            oblique_angle=oblique_angle,
            angle_of_attack=angle_of_attack,
            angular_velocity=angular_velocity,
            resistance=law,
            numerics=numerics,
        ).value

    return _spread(find, projectile, target, usual_unless_given(resistance), strength_scatter)


def _spread(
    find: Callable[[Resistance], float | None],
    projectile: Projectile,
    target: Target,
    resistance: Resistance,
    source: ScatterSource,
) -> PerforationSpread:
    scatter, _ = known_strength(projectile=projectile, target=target, resistance=resistance, strength_scatter=source)
    model, factors = resistance.strength_factor, scatter.factors
    ends = [
        find(resistance),
        *(find(replace(resistance, strength_factor=scaled(model, factor))) for factor in factors),
    ]
    known = [each for each in ends if each is not None]
    variants = [find(law) for law in rear_face_variants(resistance)]
    return PerforationSpread(
        # The limit with S as given is included, because limits need not be monotonic in S.
        range=(min(known), max(known)) if len(known) == len(ends) else None,
        variants=RearFaceVariants(plain=variants[0], rear_plug=variants[1], rear_plug_and_crater=variants[2]),
    )


def thickness_sentence(
    found: PerforationLimit, spread: PerforationSpread, rows: Sequence[FormulaResult], resistance: Resistance
) -> str:
    """Compose a sentence on the least thickness that is not perforated, by the formulas and by the model.

    Parameters
    ----------
    rows
        Results of `formulas` for the same strike.
    resistance
        Resistance in use; the sentence names its plug and crater.
    """
    limits = [
        (each.perforation_thickness, each.formula) for each in rows if each.in_range and each.perforation_thickness
    ]
    if limits:
        limit, formula = max(limits)
        first = f"Not perforated from {_thickness(limit or 0.0)} on by {NAMES[formula]}, the largest of the formulas "
        first += "within their range, without a margin."
    else:
        first = "No formula for perforation is within the range of its tests."
    return f"{first} {_model_sentence(found, spread, resistance, _thickness, 'from {} on')}"


def limit_speed_sentence(
    found: PerforationLimit, spread: PerforationSpread, rows: Sequence[FormulaResult], resistance: Resistance
) -> str:
    """Compose a sentence on the least speed that perforates a wall, by the formulas and by the model.

    Parameters
    ----------
    rows
        Results of `limit_speeds` for the same wall.
    """
    limits = [(each.limit_speed, each.formula) for each in rows if each.in_range and each.limit_speed]
    if limits:
        limit, formula = min(limits)
        first = (
            f"Perforated from {_speed(limit or 0.0)} on by {NAMES[formula]}, the lowest of the formulas within their "
        )
        first += "range."
    else:
        first = "No formula for perforation is within the range of its tests."
    return f"{first} {_model_sentence(found, spread, resistance, _speed, 'up to {}')}"


def _model_sentence(
    found: PerforationLimit,
    spread: PerforationSpread,
    resistance: Resistance,
    written: Callable[[float], str],
    where: str,
) -> str:
    """Compose a sentence with the limit by the model, its range and its variants; it calls the model unconservative."""
    own = "".join(
        words
        for words, has in ((" with a plug", resistance.rear_plug), (" with a crater", resistance.crater))
        if has is not None
    ).replace("plug with a", "plug and a")
    if found.value is None:
        value = found.status.value.replace("_", " ")
    elif spread.range is None:
        value = f"{written(found.value)}{own}, no 90 % range"
    else:
        lower, upper = map(written, spread.range)
        value = f"{lower} to {upper}{own} (90 % range over S, {written(found.value)} with S as given)"
    variants = [
        f"{written(each)}{words}"
        for each, words in (
            (spread.variants.plain, " without a plug and a crater" if own else ""),
            (spread.variants.rear_plug, " with a plug"),
            (spread.variants.rear_plug_and_crater, " with a plug and a crater"),
        )
        if each is not None and words not in ("", own)
    ]
    text = f"This model, which is unconservative: {'; '.join([value, *variants])}"
    if found.without_protrusion is not None:
        text += f"; nothing stands out of the rear face {where.format(written(found.without_protrusion))}"
    return f"{text}."


def _reason(name: Question, value: DesignValue) -> str:
    """Name the formula with its margin, and the model if it determines the design value."""
    by_formula = f"{NAMES[value.by_formula or '']} × {MARGINS[name]:g}"
    if value.formula != THIS_MODEL:
        return by_formula
    return f"this model with a plug and a crater; {by_formula} is {_thickness(MARGINS[name] * (value.limit or 0.0))}"


def _thickness(value: float) -> str:
    """Format a thickness [m], rounded up to a whole millimetre or a tenth of an inch to be on the safe side."""
    return with_symbol(rounded(value, "mm", math.ceil), "mm")


def _length(value: float) -> str:
    """Format a length [m] to a tenth of a millimetre or a hundredth of an inch; from 10 m on, to six digits."""
    if value >= 10.0:  # in millimetres it would have five digits or more
        return quantity(value, "m", 6)
    return with_symbol(fixed(value, "mm", 1).rstrip("0").rstrip("."), "mm")


def _speed(value: float) -> str:
    """Format a speed [m/s], rounded down to be on the safe side from 10 m/s on."""
    # Slower speeds are rounded to two digits, because whole numbers would be too coarse.
    return with_symbol(rounded(value, "m/s", math.floor), "m/s") if value >= 10.0 else quantity(value, "m/s", 2)
