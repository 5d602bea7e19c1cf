"""The usual scatter of a strike and the words of a verdict."""

import math
import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats

from service.schemas import ReportRequest
from solver import (
    ConstantStrengthFactor,
    ElasticPlastic,
    Flat,
    Flight,
    Impact,
    ModelWarning,
    MohrCoulomb,
    NoFreeSurface,
    Numerics,
    ObliquityPolynomial,
    Outcome,
    OwnTests,
    ParameterError,
    Projectile,
    Protrusion,
    PublishedTests,
    Resistance,
    SearchStatus,
    StrengthPowerLaw,
    Target,
    critical_angle,
)
from solver.resistance import predict_shot, strength_factor
from solver.strength_scatter import TABLE_1, scatter_of_strength
from solver.strike import PAPER_PROJECTILE, PAPER_VELOCITY
from solver.uncertainty import Discrete, Estimate, Verdict, usual_scatter, verdict
from solver.uncertainty.verdict import NO_RANGE_BY_PANELS, RANGE_FAILED, with_those_of_strike
from solver.uncertainty.walls import judge_wall
from solver.uncertainty.weighed_warnings import range_held_earlier
from tests.odd_strikes import KINDS, odd_strikes
from tests.physics.strikes import CASE, known

OTHER: dict[str, Any] = CASE | {"target": Target(compressive_strength=40e6, density=2250.0)}
LAW = predict_shot(np.zeros(0))


@pytest.mark.parametrize(
    ("case", "model", "source", "tests"),
    [
        (OTHER, PublishedTests(), "law", LAW),
        (OTHER, ObliquityPolynomial(), "law", LAW),
        (OTHER, StrengthPowerLaw(), "law", LAW),
        (CASE, ObliquityPolynomial(coefficients=(8.5,)), "law", LAW),
        (CASE, ObliquityPolynomial(), "law", LAW),
        (CASE, ObliquityPolynomial(), "paper_table_1", TABLE_1.posterior(**CASE)),
        (OTHER, PublishedTests(), "paper_table_1", TABLE_1.posterior(**CASE)),
        (OTHER, TABLE_1, "law", TABLE_1.posterior(**OTHER)),
        (OTHER, OwnTests(shots=TABLE_1.shots[:1]), "law", OwnTests(shots=TABLE_1.shots[:1]).posterior(**OTHER)),
    ],
)
def test_strength_factor_scatters_like_its_tests_without_counting_strength_twice(
    case: dict[str, Any], model: Any, source: Any, tests: Any
) -> None:
    resistance = Resistance(strength_factor=model)
    found = scatter_of_strength(**case, resistance=resistance, strength_scatter=source)
    assert (found.dispersion, found.degrees_of_freedom) == (tests.dispersion, tests.degrees_of_freedom)
    stronger = replace(case["target"], compressive_strength=case["target"].compressive_strength * math.exp(0.12))
    here, there = (
        each.compressive_strength * resistance.strength_polynomial(target=each, projectile=PAPER_PROJECTILE)[0]
        for each in (case["target"], stronger)
    )
    by_strength = math.log(there / here) * found.strength / 0.12
    # The logarithm of S f'c is a Student's t variable plus a normal one, and must scatter as the tests do.
    random = np.random.default_rng(1)
    product = found.residual * random.standard_t(found.degrees_of_freedom, 1_000_000)
    product += by_strength * random.standard_normal(1_000_000)
    half = stats.t(tests.degrees_of_freedom, scale=tests.scale).ppf(0.95)
    assert np.quantile(np.abs(product), 0.9) == pytest.approx(half, rel=0.01)


@pytest.mark.parametrize("source", ["law", "paper_table_1"])
def test_similar_cases_have_similar_scatter(source: Any) -> None:
    """The scatter is nearly the same at 39.1 MPa and at 39 MPa, the strength in the paper's tests."""
    nearby = CASE | {"target": Target(compressive_strength=39.1e6, density=2250.0)}
    here, there = (
        scatter_of_strength(**case, resistance=Resistance(), strength_scatter=source) for case in (CASE, nearby)
    )
    assert here.dispersion == there.dispersion
    assert here.residual == pytest.approx(there.residual, rel=1e-3)


def test_scatter_of_the_paper_tests_is_used_only_on_request() -> None:
    plain, preset = (
        critical_angle(**CASE, velocity=PAPER_VELOCITY, strength_scatter=source) for source in ("law", "paper_table_1")
    )
    assert plain.angle == preset.angle
    assert known(preset.strength_factor_dispersion) < 0.3 * known(plain.strength_factor_dispersion)
    assert (plain.own_tests, known(preset.own_tests).median) == (None, TABLE_1.posterior(**CASE).median)
    standing = {each.code: each.standing for each in preset.warnings}
    assert standing["scatter_of_table_1"] is True
    assert "scatter_of_table_1" not in {each.code for each in plain.warnings}
    other = critical_angle(
        **OTHER | {"target": Target(compressive_strength=60e6, density=2250.0)},
        velocity=PAPER_VELOCITY,
        strength_scatter="paper_table_1",
    )
    (warning,) = [each for each in other.warnings if each.code == "scatter_of_table_1"]
    assert warning.standing is False
    assert "nothing shows that it is known so well" in warning.detail


@pytest.mark.parametrize(("model", "source"), [(TABLE_1, "paper_table_1"), (ObliquityPolynomial(), "table_1")])
def test_unknown_source_of_scatter_is_refused(model: Any, source: Any) -> None:
    with pytest.raises(ParameterError, match="strength_scatter: must be"):
        critical_angle(
            **CASE, velocity=PAPER_VELOCITY, resistance=Resistance(strength_factor=model), strength_scatter=source
        )


def test_each_theory_has_its_own_obliquity_shape() -> None:
    found = verdict_of(PAPER_VELOCITY)
    elastic, mohr = (math.degrees(known(angle)) for angle in found.theories)
    assert elastic == pytest.approx(48.63, abs=0.02)
    assert 46.6 <= mohr <= 48.4  # With eq. 9 it is 43.57°.


@pytest.mark.parametrize(
    ("resistance", "own"),
    [
        (Resistance(), False),
        (Resistance(free_surface=ElasticPlastic(inertia=True)), False),
        (Resistance(strength_factor=PublishedTests()), False),
        (Resistance(strength_factor=TABLE_1), False),
        (Resistance(strength_factor=StrengthPowerLaw()), False),
        (Resistance(free_surface=NoFreeSurface()), True),
        (Resistance(free_surface=MohrCoulomb()), True),
        (Resistance(strength_factor=ObliquityPolynomial(coefficients=(8.5,))), True),
        (Resistance(strength_factor=ConstantStrengthFactor(value=8.5)), True),
        (Resistance(strength_factor=StrengthPowerLaw(coefficient=72.0, exponent=-0.5)), True),
    ],
)
def test_usual_scatter_has_both_theories_unless_the_law_was_chosen(resistance: Resistance, own: bool) -> None:
    def laws(**given: Any) -> list[Any]:
        *_, last = usual_scatter(**CASE, velocity=PAPER_VELOCITY, resistance=resistance, **given)
        return list(last.distribution.values) if isinstance(last.distribution, Discrete) else []

    theories = ["elastic_plastic", "mohr_coulomb"]
    assert laws() == ([] if own else theories)
    assert laws(theories=True) == theories
    assert laws(theories=False) == []


def test_verdict_without_decay_is_consistent() -> None:
    """At 52° the verdict was once "embedded (probability of ricochet above 0.99)", with the angle outside its range."""
    found = verdict_of(
        PAPER_VELOCITY, oblique_angle=math.radians(52.0), resistance=Resistance(free_surface=NoFreeSurface())
    )
    assert found.outcome is Outcome.EMBEDDED
    assert found.probability is not None
    assert found.probability.value < 0.1
    assert found.spread is not None
    assert found.spread[0] < known(found.angle) < found.spread[1]
    assert found.theory_spread is not None
    assert found.theory_spread[1] < known(found.angle)
    assert "is not turned away" in str(found)
    assert "with the law chosen, 90 % range" in str(found)
    assert "Over the theories: 90 % range" in str(found)


def contradictions(found: Verdict) -> list[str]:
    """Return a line for each contradiction within a verdict."""
    wrong = []
    if found.angle is not None and found.spread is not None and not found.spread[0] <= found.angle <= found.spread[1]:
        wrong.append("the angle is not in its range")
    if found.outcome is not None and found.probability is not None:
        ricochet = found.probability.value
        if (ricochet if found.outcome is Outcome.RICOCHET else 1.0 - ricochet) < 0.1:
            wrong.append(f"{found.outcome} has a probability of ricochet of {ricochet}")
    shown = set(re.findall(r"Critical angle ([\d.]+°)", str(found)))
    if len(shown) > 1:
        wrong.append(f"critical angles {shown}")
    return wrong


def verdict_on(body: dict[str, Any]) -> Verdict:
    request = ReportRequest.model_validate(body)
    angle = body["impact"].get("oblique_angle_deg")
    arguments, _ = request.arguments()
    return verdict(**arguments, oblique_angle=None if angle is None else math.radians(angle), threads=2)


@pytest.mark.timeout(900)
@pytest.mark.parametrize("body", odd_strikes(len(KINDS), seed=1), ids=KINDS)
def test_verdict_does_not_contradict_itself(body: dict[str, Any]) -> None:
    assert contradictions(verdict_on(body)) == []


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_verdicts_on_odd_strikes_do_not_contradict_themselves() -> None:
    found = [(contradictions(verdict_on(body)), body) for body in odd_strikes(300, seed=2)]
    assert [each for each in found if each[0]] == []


@cache
def verdict_of(velocity: float, **changes: Any) -> Verdict:
    return verdict(**CASE, velocity=velocity, threads=2, **changes)


@pytest.mark.parametrize(
    ("velocity", "scatter", "special"),
    [
        (238.0, "law", set()),
        (60.0, "law", {"retention_decides"}),
        (500.0, "law", set()),
        (500.0, "paper_table_1", {"strength_fit_extrapolated"}),
    ],
)
def test_warning_with_little_effect_on_the_angle_is_a_standing_note(
    velocity: float, scatter: str, special: set[str]
) -> None:
    """At 500 m/s the extrapolation of S beyond 45° shifts the angle by 3.2°.

    That is much compared with the range from the scatter of 4 tests, but little compared with the range from all
    published tests.
    """
    strike = CASE | {"velocity": velocity}
    found = verdict_of(velocity, strength_scatter=scatter)
    assert found.angle is not None
    assert found.spread is not None
    assert {each.code for each in found.warnings if not each.standing} == special
    # Negative angles have a minus sign, not a hyphen.
    assert not re.search(r"-\d[\d.]*°", " ".join(each.detail for each in found.warnings))
    shifts = {each.code: each.angle_shift for each in found.warnings if each.angle_shift is not None}
    for code, shift in shifts.items():
        assert (abs(shift) > 0.25 * (found.spread[1] - found.spread[0])) is (code in special)
    if "retention_decides" in shifts:
        angles = [
            critical_angle(**strike, numerics=Numerics(retention_energy_fraction=each)).angle for each in (1e-3, 0.1)
        ]
        assert shifts["retention_decides"] == max((each - found.angle for each in angles if each), key=abs)
    if "strength_fit_extrapolated" in shifts:
        held = strength_factor(**CASE, resistance=Resistance(), oblique_angle=ObliquityPolynomial.fitted_to)
        constant = Resistance(strength_factor=ConstantStrengthFactor(value=held))
        angle = critical_angle(**strike, resistance=constant).angle
        assert shifts["strength_fit_extrapolated"] == known(angle) - found.angle


@pytest.mark.parametrize(("velocity", "angle", "held"), [(400.0, 61.82, 60.38), (700.0, 71.44, 70.55)])
def test_verdict_above_55_degrees_includes_the_angle_with_s_held_from_55(
    velocity: float, angle: float, held: float
) -> None:
    found = verdict_of(velocity)
    assert math.degrees(known(found.angle)) == pytest.approx(angle, abs=0.02)
    assert math.degrees(known(found.held_angle)) == pytest.approx(held, abs=0.02)
    assert found.spread is not None
    assert found.spread[0] <= known(found.held_angle)
    assert f"{math.degrees(known(found.held_angle)):.1f}° with S held from 55°" in str(found)
    assert verdict_of(238.0).held_angle is None


@pytest.mark.parametrize(
    ("spread", "angle", "held", "expected"),
    [
        ((50.0, 60.0), 56.0, 55.7, (50.0, 60.0)),
        ((58.0, 70.0), 64.0, 62.0, (56.0, 70.0)),
        ((55.5, 70.0), 64.0, 62.0, (55.0, 70.0)),
        ((63.0, 70.0), 64.0, 62.0, (61.0, 70.0)),
        ((58.0, 70.0), 64.0, None, (58.0, 70.0)),
    ],
)
def test_range_is_extended_to_the_angle_with_s_held_earlier(
    spread: tuple[float, float], angle: float, held: float | None, expected: tuple[float, float]
) -> None:
    found = range_held_earlier(
        (math.radians(spread[0]), math.radians(spread[1])),
        math.radians(angle),
        None if held is None else math.radians(held),
    )
    assert found is not None
    assert [math.degrees(each) for each in found] == pytest.approx(expected)


def test_verdict_has_the_warnings_of_search_and_strike() -> None:
    strike = [
        ModelWarning("fit", "at 55° beyond"),
        ModelWarning("mass", "not given"),
        ModelWarning("tumbling", "turns"),
    ]
    search = [
        ModelWarning("fit", "at 48° beyond", standing=True),
        ModelWarning("mass", "not given; moves", standing=True),
    ]
    found = with_those_of_strike(strike, search)
    assert [each.detail for each in found] == ["at 55° beyond", "turns", "at 48° beyond", "not given; moves"]
    assert [each.standing for each in found] == [True, False, True, True]


def test_shots_into_the_concrete_narrow_the_range() -> None:
    def width(**changes: Any) -> float:
        found = verdict_of(PAPER_VELOCITY, **changes)
        assert found.spread is not None
        assert found.spread[0] < known(found.angle) < found.spread[1]
        return math.degrees(found.spread[1] - found.spread[0])

    preset = width(strength_scatter="paper_table_1")
    plain = width()
    published, one, four = (
        width(resistance=Resistance(strength_factor=model))
        for model in (PublishedTests(), OwnTests(shots=TABLE_1.shots[:1]), TABLE_1)
    )
    assert published > 1.2 * one > 1.2 * four
    assert preset == pytest.approx(four, rel=0.15)
    assert plain == pytest.approx(published, rel=0.15)


SEEN = Verdict(
    status=SearchStatus.CONVERGED,
    angle=math.radians(48.634),
    searched=(math.radians(5.0), math.radians(85.0)),
    spread=(math.radians(42.2), math.radians(60.1)),
    share_without=0.0,
    theories=(),
)
FIRST = "Critical angle 48.6° from the normal, 90 % range 42° to 60°"
MANY_WITHOUT = (
    "Critical angle 48.6° from the normal, 25 % of the samples without one from 5° to 85°, 90 % range of the others "
    "42° to 60°"
)
LAST = "the outcome also changes at 70.0°"
SAID = "At 50° from the normal the projectile"
NOMINAL = "with the inputs as given: embedded"
STANDS_OUT = "with the inputs as given: embedded, its nose 139 mm out of the rear face"
BY_LAW = "Critical angle 48.6° from the normal with the law chosen, 90 % range 42° to 60°"
OVER_THEORIES = "Over the theories: 90 % range 43° to 51°"
AT_50: dict[str, Any] = {"oblique_angle": math.radians(50.0), "outcome": Outcome.EMBEDDED}


LANDING = "Lands about 410 m away if it tumbles as computed, up to 520 m at any elevation, at most 1050 m without drag."
LANDED = Flight(
    range=405.8,
    flight_time=5.92,
    impact_speed=57.3,
    apex=43.3,
    farthest_range=514.3,
    farthest_elevation=0.69,
    range_without_drag=1042.3,
    elevation=0.335,
    drag_coefficient=1.0,
    projected_area=0.032,
)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, f"{FIRST}."),
        (
            AT_50 | {"outcome": Outcome.RICOCHET, "flight": LANDED},
            f"At 50° from the normal, with the inputs as given: ricochet. {LANDING} {FIRST}.",
        ),
        (
            {"spread": (math.radians(48.0), math.radians(50.01))},
            "Critical angle 48.63° from the normal, 90 % range 48.0° to 50.0°.",
        ),
        ({"spread": None}, "Critical angle 48.6° from the normal."),
        (
            {"spread": None, "reason_without_range": RANGE_FAILED},
            "Critical angle 48.6° from the normal, the 90 % range could not be computed.",
        ),
        (
            {"spread": None, "reason_without_range": NO_RANGE_BY_PANELS, "own_law": True},
            "Critical angle 48.6° from the normal with the law chosen, no 90 % range by panels.",
        ),
        (
            {"own_law": True, "theory_range_failed": True},
            f"{BY_LAW}. The range over the theories could not be computed.",
        ),
        (
            AT_50 | {"probability": Estimate(0.2, 0.17, 0.23)},
            f"{SAID} may be turned away (probability 20 %); {NOMINAL}. {FIRST}.",
        ),
        (
            AT_50 | {"probability": Estimate(0.098, 0.07, 0.12)},
            f"{SAID} is not turned away (probability of ricochet 10 %); {NOMINAL}. {FIRST}.",
        ),
        (
            AT_50 | {"probability": Estimate(0.0, 0.0, 0.03), "protrusion": Protrusion(final=0.139, greatest=0.139)},
            f"{SAID} is not turned away (probability of ricochet below 3 %); {STANDS_OUT}. {FIRST}.",
        ),
        (
            AT_50 | {"outcome": Outcome.RICOCHET, "probability": Estimate(1.0, 0.97, 1.0)},
            f"At 50° from the normal the projectile is turned away (probability above 97 %). {FIRST}.",
        ),
        (
            AT_50 | {"outcome": Outcome.RICOCHET, "probability": Estimate(0.999, 0.9999, 1.0)},
            f"At 50° from the normal the projectile is turned away (probability above 99 %). {FIRST}.",
        ),
        (AT_50, f"At 50° from the normal, with the inputs as given: embedded. {FIRST}."),
        (
            {
                "own_law": True,
                "theories": (math.radians(48.634), math.radians(43.6)),
                "theory_spread": (math.radians(42.9), math.radians(51.0)),
            },
            f"{BY_LAW}. {OVER_THEORIES}.",
        ),
        (
            {"share_without": 0.25, "theories": (math.radians(48.634), None), "other_crossings": (math.radians(70.0),)},
            f"{MANY_WITHOUT}; {LAST}.",
        ),
        ({"share_without": 0.05}, f"{FIRST}, 5 % of the samples without one from 5° to 85°."),
        (
            {"status": SearchStatus.NO_RICOCHET, "angle": None, "spread": None},
            "No critical angle: nothing from 5° to 85° is turned away.",
        ),
    ],
)
def test_decimals_of_a_verdict_follow_its_range(changes: dict[str, Any], sentence: str) -> None:
    assert str(replace(SEEN, **changes)) == sentence


@pytest.mark.parametrize(("share", "name"), [(0.1, "90 % range"), (0.11, "90 % range of the others")])
def test_range_has_the_same_name_in_the_sentence(share: float, name: str) -> None:
    found = replace(SEEN, share_without=share)
    assert found.range_name == name
    assert f"{name} {found.range_text}" in found.sentence


@pytest.mark.parametrize(
    ("thickness", "answer"),
    [(0.3, "not enough against scabbing and perforation"), (0.6, "enough at this angle only"), (1.0, "enough")],
)
def test_sentence_on_a_wall_comes_before_the_strike(thickness: float, answer: str) -> None:
    target = replace(CASE["target"], thickness=thickness)
    impact = Impact(velocity=PAPER_VELOCITY, oblique_angle=math.radians(45.0))
    wall = judge_wall(projectile=PAPER_PROJECTILE, target=target, impact=impact)
    first = f"Wall of {1e3 * thickness:g} mm at 45° from the normal: {answer}. "
    strike = f"At 45° from the normal, with the inputs as given: embedded. {FIRST}. "
    design = wall.sentence.removeprefix(first)
    assert design.startswith("Design value against scabbing")
    judged = replace(SEEN, wall=wall, oblique_angle=math.radians(45.0), outcome=Outcome.EMBEDDED)
    assert str(judged) == f"{first}{strike}{design}"
    assert str(replace(SEEN, wall=wall)) == f"{first}{FIRST}. {design}"


@pytest.mark.parametrize("thickness", [0.3, 3.0])
def test_wall_without_formulas_comes_first_unless_the_model_perforates_it(thickness: float) -> None:
    rod = Projectile(nose=Flat(), diameter=0.02, length=0.4, mass=0.98)
    target = Target(compressive_strength=39e6, density=2300.0, thickness=thickness)
    impact = Impact(velocity=1500.0, oblique_angle=0.0)
    wall = judge_wall(projectile=rod, target=target, impact=impact)
    judged = str(replace(SEEN, wall=wall, oblique_angle=0.0, outcome=wall.outcome))
    known_first = "At 0° from the normal, with the inputs as given: perforated."
    first = known_first if wall.outcome is Outcome.PERFORATED else f"Wall of {1e3 * thickness:g} mm"
    assert wall.outcome is (Outcome.PERFORATED if thickness < 1.0 else Outcome.EMBEDDED)
    assert wall.enough is None
    assert judged.startswith(first)
    assert "from the normal: not known to be enough." in judged


def test_wall_that_could_not_be_computed_comes_first() -> None:
    failed = str(replace(SEEN, wall_failed=True))
    assert failed == f"The wall is not judged: the strikes on it could not be computed. {FIRST}."
