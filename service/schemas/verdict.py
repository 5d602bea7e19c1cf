"""Models of the verdict on a strike, and the usual scatter of its inputs."""

import math
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import Annotated, Any

from pydantic import MISSING, Field

import solver
from service.schemas.answers import (
    WARNING,
    EngineVersion,
    Key,
    ModelWarning,
    OwnTestsAnswer,
    Protrusion,
)
from service.schemas.fields import in_solver_units, walk
from service.schemas.flight import LANDING, FlightResult
from service.schemas.problems import pointer_of_parameter
from service.schemas.quantities import Flag, Num, Part, degrees, with_examples
from service.schemas.requests import CriticalAngleBase, ReportRequest
from service.schemas.resistance import FreeSurfaceModel
from service.schemas.uncertain_inputs import SCATTER, UncertainInput
from service.schemas.wall import WallDesign, design_in, protrusion_in, wall_in, warning_in
from solver import (
    ENGINE_VERSION,
    Outcome,
    PublishedTests,
    Resistance,
    SearchStatus,
)
from solver.strength_scatter import scatter_of_strength
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
from solver.uncertainty import AfterShots, Discrete, Uncertain, Verdict, usual_scatter
from solver.uncertainty.results import RANGE
from solver.uncertainty.strikes import THEORY
from solver.uncertainty.usual import THEORIES, THEORY_LAWS
from solver.uncertainty.verdict import (
    Ended,
    Found,
    Question,
    Spread,
    Steps,
    conclude,
    next_shot_advice,
    probability_text,
)
from solver.uncertainty.verdict import verdict_steps as solver_verdict_steps
from solver.units import written_in

CENTRES = {"normal": "mean", "lognormal": "median", "log_student_t": "median"}
"""Parameter of each type of distribution that is set to the value in the case."""
THEORY_MODELS = tuple(law.name for law in THEORY_LAWS)


def contract_input(uncertain: Uncertain) -> dict[str, Any]:
    """Convert an uncertain input of the solver to an input of `/cra/uncertainty`."""
    distribution = uncertain.distribution
    found: dict[str, Any] = {"type": distribution.name}
    field = pointer_of_parameter(uncertain.field)[1:].replace("/", ".")
    if isinstance(distribution, Discrete):
        found |= {"values": list(distribution.values), "weights": list(distribution.probabilities)}
    else:
        given = {each.name: getattr(distribution, each.name) for each in fields(distribution)}
        convert = degrees if field.endswith("_deg") else float
        found |= {name: convert(value) for name, value in given.items() if value is not None}
    return {"field": field, "distribution": found}


def usual_inputs(request: CriticalAngleBase, *, theories: bool | None = None) -> list[dict[str, Any]]:
    """Return the usual scatter around the values of a case, as inputs of `/cra/uncertainty`.

    Parameters
    ----------
    theories
        As for `solver.uncertainty.usual_scatter`.

    Raises
    ------
    ParameterError
        If no strength factor gives the depth of a shot.
    """
    impact: dict[str, Any] = request.impact.arguments()
    del impact["angular_velocity"]
    case = {name: value for name, value in request.shared_arguments().items() if name != "numerics"}
    usual = usual_scatter(**case, **impact, theories=theories, strength_scatter=request.strength_scatter.value)
    return [contract_input(each) for each in usual]


def _without_centre(distribution: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in distribution.items() if name != CENTRES.get(distribution["type"])}


@cache
def usual_scatter_of_page() -> dict[str, dict[str, Any]]:
    """Return the usual distributions of inputs for an untested concrete, relative to the values of the case.

    The page uses them as defaults.
    """
    inputs = usual_scatter(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        velocity=PAPER_VELOCITY,
        resistance=Resistance(strength_factor=PublishedTests()),
    )
    return {each["field"]: _without_centre(each["distribution"]) for each in map(contract_input, inputs)}


THEORY_ANGLE = {"free_surface": "elastic_plastic", "weight": 0.8, "critical_angle_deg": 48.6}
VERDICT = {
    "sentence": "At 55° from the normal the projectile is turned away (probability above 97 %). Critical angle 48.6° "
    "from the normal, 90 % range 46° to 51°.",
    "range_text": "46° to 51°",
    "status": "converged",
    "critical_angle_deg": 48.63,
    "range": {"lower_deg": 45.9, "upper_deg": 51.2},
    "share_without_angle": 0.0,
    "theories": [THEORY_ANGLE],
    "oblique_angle_deg": 55.0,
    "outcome": "ricochet",
    "flight": LANDING,
    "ricochet_probability": 0.998,
    "ricochet_probability_interval": {"lower": 0.978, "upper": 1.0},
    "probability_text": "above 97 %",
    "strength_factor": 6.1,
    "strength_factor_dispersion": 0.0964,
    "usual_scatter": SCATTER,
    "warnings": [WARNING],
    "keys": {"cra": "0" * 64},
    "engine_version": ENGINE_VERSION,
}


class LikelyAngles(Part):
    """90 % range of the critical angle."""

    model_config = with_examples(VERDICT["range"])

    lower_deg: Num
    upper_deg: Num


class ProbabilityInterval(Part):
    """95 % confidence interval of a probability that is estimated from samples."""

    model_config = with_examples(VERDICT["ricochet_probability_interval"])

    lower: Annotated[Num, Field(ge=0.0, le=1.0)]
    upper: Annotated[Num, Field(ge=0.0, le=1.0)]


class TheoryAngle(Part):
    """Critical angle according to one theory of the decay, with the other inputs at their medians."""

    model_config = with_examples(THEORY_ANGLE)

    free_surface: FreeSurfaceModel
    weight: Annotated[Num, Field(ge=0.0, le=1.0)]
    """Weight of the theory in the 90 % range. [1]"""
    critical_angle_deg: Num | MISSING = MISSING


class VerdictKeys(Part):
    """Keys of the answers on which the verdict is based, for `GET /results/{key}`."""

    model_config = with_examples(VERDICT["keys"])

    cra: Key
    uncertainty: Key | MISSING = MISSING
    theories: Key | MISSING = MISSING
    trajectory: Key | MISSING = MISSING
    wall: Key | MISSING = MISSING


class VerdictAnswer(Part):
    """Verdict on a strike, which the page, the report and the command line show first."""

    model_config = with_examples(VERDICT)

    sentence: str
    """Verdict in words."""
    range_text: str
    """Text of the 90 % range, as in `sentence`; empty if there is no range."""
    status: SearchStatus
    critical_angle_deg: Num | MISSING = MISSING
    """Critical angle with the inputs as given; absent if there is none. [°]"""
    range: LikelyAngles | MISSING = MISSING
    """90 % range of the critical angle, given the usual scatter, over the samples that have an angle. It includes
    `critical_angle_deg`. If the request has its own law, the range follows from that law."""
    held_angle_deg: Num | MISSING = MISSING
    """Critical angle with a strength factor that is constant from 55° on. Present if the strength factor of the request
    is constant from 60° on, the critical angle is beyond 55° and the method is `adaptive`. `range` includes both
    angles. [°]"""
    share_without_angle: Annotated[Num, Field(ge=0.0, le=1.0)]
    """Share of samples without a critical angle in the range searched. [1]"""
    theories: list[TheoryAngle]
    own_law: Flag | MISSING = MISSING
    """Present and true if the request has a decay law other than `elastic_plastic`, or its own value or coefficients of
    S. The probability and the range then follow from this law instead of the theories."""
    theory_range: LikelyAngles | MISSING = MISSING
    """90 % range that follows from the theories, in addition to `range`, which follows from the law of the request."""
    oblique_angle_deg: Num | MISSING = MISSING
    """Oblique angle of the request, if it has one. [°]"""
    outcome: Outcome | MISSING = MISSING
    """Outcome of the strike at the requested oblique angle, with the inputs as given."""
    protrusion: Protrusion | MISSING = MISSING
    """Protrusion from the rear face, if the wall is not perforated and any part comes out."""
    flight: FlightResult | MISSING = MISSING
    """Flight of the body after a ricochet at the requested oblique angle."""
    ricochet_probability: Annotated[Num, Field(ge=0.0, le=1.0)] | MISSING = MISSING
    """Probability of ricochet at the requested oblique angle, given the usual scatter of the inputs. [1]"""
    ricochet_probability_interval: ProbabilityInterval | MISSING = MISSING
    probability_text: str | MISSING = MISSING
    """Text of the probability, as in `sentence`."""
    wall: WallDesign | MISSING = MISSING
    """Design of the wall, if the target has a thickness. Without an oblique angle it is for normal impact."""
    strength_factor: Num | MISSING = MISSING
    """Strength factor at the critical angle, if there is such an angle. [1]"""
    strength_factor_dispersion: Num
    """Standard deviation of ln S at the given compressive strength, from the user's own tests or from the law of the
    published tests. [1]"""
    own_tests: OwnTestsAnswer | MISSING = MISSING
    """Effect of the user's own tests on S, if there are any and there is a critical angle. With `paper_table_1` as
    `strength_scatter`, the four shots in Table 1 of the paper count as the user's tests."""
    usual_scatter: list[UncertainInput]
    """Usual scatter of the inputs, in the form of `/cra/uncertainty`."""
    warnings: list[ModelWarning]
    """Warnings of the strike at the oblique angle, then of the search, then about own tests that went deeper than the
    formulas for a wall. If there is a 90 % range, each warning of the search with a known effect has an
    `angle_shift_deg`, and is a standing note if this shift is at most a quarter of the range."""
    keys: VerdictKeys
    engine_version: EngineVersion


def verdict_steps(request: ReportRequest) -> Steps:
    """Return the steps of the verdict on a strike.

    With the method `panels`, whose runs take seconds, they omit the 90 % range.
    """
    case = request.resolved()
    return solver_verdict_steps(
        **case.shared_arguments(),
        search=case.search.to_solver(),
        oblique_angle=request.oblique_angle,
        ranged=not request.by_panels,
    )


def verdict_in(request: ReportRequest, answers: Mapping[str, Any]) -> Verdict:
    """Return the verdict that follows from the answers of the service.

    Parameters
    ----------
    answers
        Answers, keyed by the names of the questions that `verdict_steps` yields; an object with a `problem` for a
        question that failed. Only `cra` is required.
    """
    return conclude(
        verdict_steps(request),
        lambda asked: {name: found_in(request, each, answers.get(name, {})) for name, each in asked.items()},
    )


def found_in(request: ReportRequest, question: Question, answer: Mapping[str, Any]) -> Found:
    """Convert an answer of the service to the result of a question; None if it is missing or has a `problem`."""
    if not answer or "problem" in answer:
        return None
    if question.kind == "search":
        return _search_in(answer)
    if question.kind == "study":
        return _spread_in(answer, request.oblique_angle)
    if question.kind == "wall":
        return wall_in(request, answer, request.oblique_angle or 0.0)
    return Ended(
        Outcome(answer["outcome"]),
        protrusion_in(answer),
        tuple(map(warning_in, answer["warnings"])),
        _flight_in(request, answer),
    )


def _flight_in(request: ReportRequest, judged: Mapping[str, Any]) -> solver.Flight | None:
    """Return the flight after a ricochet from an answer of `/trajectory`; None for other outcomes."""
    if judged["outcome"] != Outcome.RICOCHET:
        return None
    conditions = solver.FlightConditions() if request.flight is MISSING else request.flight.to_solver()
    elevation = solver.launch_elevation(
        direction=math.radians(judged["exit"]["direction_deg"]),
        face_tilt=conditions.face_tilt,
        incidence_plane=conditions.incidence_plane,
    )
    return solver.Flight(**in_solver_units(judged["exit"]["flight"]), elevation=elevation)


def _search_in(answer: Mapping[str, Any]) -> solver.CriticalAngle:
    return solver.CriticalAngle(
        SearchStatus(answer["status"]),
        angle_in(answer),
        bracket=None,
        iterations=(),
        other_crossings=tuple(map(math.radians, answer["other_crossings_deg"])),
        warnings=tuple(map(warning_in, answer["warnings"])),
        standard_error=_radians(answer.get("critical_angle_standard_error_deg")),
    )


def _spread_in(study: Mapping[str, Any], oblique_angle: float | None) -> Spread:
    critical, curve = study["critical_angle"], study["probability"]
    by_theory = next((each["swing"] for each in study.get("sensitivity", ()) if each["field"] == THEORY), ())
    angles = map(math.radians, curve["oblique_angle_deg"])
    return Spread.of(
        {each["level"]: math.radians(each["value"]) for each in critical["quantiles"]},
        critical["share_without_angle"]["value"],
        [angle_in(each) for each in by_theory],
        zip(angles, curve["ricochet_probability"], curve["lower"], curve["upper"], strict=True),
        oblique_angle,
    )


def next_shot_advice_in(study: Mapping[str, Any]) -> str:
    """Return the advice on the value of further shots from an answer of `/cra/uncertainty`; empty if it has none."""
    for each in study.get("sensitivity", ()):
        if found := each.get("after_shots"):
            levels = {each["level"]: math.radians(each["value"]) for each in study["critical_angle"]["quantiles"]}
            return next_shot_advice(
                (levels[RANGE[0]], levels[RANGE[1]]),
                [
                    AfterShots(
                        after["shots"],
                        after["strength_factor_dispersion"],
                        *(math.radians(after[end]) for end in ("lower_deg", "upper_deg")),
                    )
                    for after in found
                ],
            )
    return ""


def verdict_answer(request: ReportRequest, answers: Mapping[str, Any]) -> dict[str, Any]:
    """Return the verdict as JSON data; for the arguments see `verdict_in`."""
    found = verdict_in(request, answers)
    arguments = request.shared_arguments()
    scatter = scatter_of_strength(
        **{name: arguments[name] for name in ("projectile", "target", "resistance")},
        strength_scatter=request.strength_scatter.value,
    )
    with written_in(request.units):
        sentence = found.sentence
    answer: dict[str, Any] = {"sentence": sentence, "range_text": found.range_text, "status": found.status.value}
    if found.angle is not None:
        answer["critical_angle_deg"] = answers["cra"]["critical_angle_deg"]
    if found.spread is not None:
        answer["range"] = _likely_angles(found.spread)
    answer["share_without_angle"] = found.share_without
    if found.held_angle is not None:
        answer["held_angle_deg"] = degrees(found.held_angle)
    if found.own_law:
        answer["own_law"] = True
    if found.theory_spread is not None:
        answer["theory_range"] = _likely_angles(found.theory_spread)
    theories = zip(THEORY_MODELS, THEORIES, found.theories, strict=True) if found.theories else ()
    answer["theories"] = [
        {"free_surface": name, "weight": weight} | ({} if angle is None else {"critical_angle_deg": degrees(angle)})
        for name, weight, angle in theories
    ]
    if found.oblique_angle is not None:
        answer["oblique_angle_deg"] = request.impact.oblique_angle_deg
    if found.outcome is not None:
        answer["outcome"] = found.outcome.value
    if found.protrusion is not None:
        answer["protrusion"] = walk(Protrusion, found.protrusion)
    if found.flight is not None:
        answer["flight"] = answers["judged"]["exit"]["flight"]
    if found.probability is not None:
        answer["ricochet_probability"] = found.probability.value
        interval = {"lower": found.probability.lower, "upper": found.probability.upper}
        answer |= {"ricochet_probability_interval": interval, "probability_text": probability_text(found.probability)}
    if found.wall is not None:
        answer["wall"] = design_in(answers["wall"])
    answer |= {name: answers["cra"][name] for name in ("strength_factor", "own_tests") if name in answers["cra"]}
    names = {
        "cra": "cra",
        "uncertainty": "uncertainty",
        "theories": "theories",
        "judged": "trajectory",
        "wall": "wall",
    }
    return answer | {
        "strength_factor_dispersion": scatter.dispersion,
        "usual_scatter": usual_inputs(request),
        "warnings": [walk(ModelWarning, each) for each in found.warnings],
        "keys": {to: answers[own]["key"] for own, to in names.items() if "key" in answers.get(own, {})},
        "engine_version": ENGINE_VERSION,
    }


def _likely_angles(spread: tuple[float, float]) -> dict[str, float]:
    return dict(zip(("lower_deg", "upper_deg"), map(degrees, spread), strict=True))


def angle_in(found: Mapping[str, Any]) -> float | None:
    """Return the critical angle in the answer to a search; None if there is none. [rad]"""
    return _radians(found.get("critical_angle_deg"))


def _radians(angle: float | None) -> float | None:
    return None if angle is None else math.radians(angle)
