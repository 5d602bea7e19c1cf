"""Invalid input is refused with the name of the field."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from inspect import isfunction, signature
from typing import Any

import numpy as np
import pytest

import solver
import solver.calibration
import solver.uncertainty
from service.columns import shown_in
from service.schemas import FlightRequest, TrajectoryRequest
from solver import (
    BoatTail,
    Conical,
    ConstantStrengthFactor,
    Crater,
    Flat,
    Impact,
    MohrCoulomb,
    Numerics,
    ObliquityPolynomial,
    Ogive,
    ParameterError,
    Profile,
    Projectile,
    PublishedTests,
    Resistance,
    RicochetError,
    Search,
    ShearPlug,
    Sphere,
    Spherical,
    StrengthPowerLaw,
    Target,
    closed_form_depth,
    critical_angle,
    simulate,
)
from solver.calibration import DepthTest, MotionHistory, MotionRun
from solver.checks import BOUNDS
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
from solver.uncertainty import Normal, Uncertain

from .strikes import CASE, paper_run

NAN, INF = math.nan, math.inf


def projectile(**changes: Any) -> Projectile:
    return replace(PAPER_PROJECTILE, **changes)


def target(**changes: float) -> Target:
    return replace(PAPER_TARGET, **changes)


def impact(**changes: Any) -> Impact:
    return Impact(**({"velocity": 238.0, "oblique_angle": 0.5} | changes))


def resistance(**changes: Any) -> Resistance:
    return Resistance(**changes)


def profile(*points: tuple[float, float]) -> Profile:
    return Profile(points=points)


def covariance(*rows: tuple[float, ...]) -> ObliquityPolynomial:
    return ObliquityPolynomial(covariance=rows)


def strike(**changes: Any) -> object:
    return simulate(**(CASE | {"impact": impact()} | changes))


def beyond_all_numbers(exponent: float) -> Resistance:
    law = StrengthPowerLaw(reference_strength=1.0, exponent=exponent, obliquity_shape="equation_9")
    return Resistance(strength_factor=law)


S = "resistance.strength_factor"
POINTS = "projectile.nose.points"
TAIL = "projectile.boat_tail"
BOAT_TAIL = BoatTail(length=0.1, base_diameter=0.06)
CRH = "projectile.nose.caliber_radius_head"

VALUES: list[tuple[str, Callable[[Any], object], tuple[Any, ...]]] = [
    ("projectile.diameter", lambda value: projectile(diameter=value), (0.0, -0.08, NAN, INF)),
    ("projectile.length", lambda value: projectile(length=value), (0.0, -0.5, NAN, INF, 0.13)),
    ("projectile.mass", lambda value: projectile(mass=value), (0.0, -13.0, NAN, INF)),
    (
        "projectile.center_of_gravity",
        lambda value: projectile(center_of_gravity=value),
        (0.0, -0.1, 0.53, 0.6, NAN, INF),
    ),
    ("projectile.moment_of_inertia", lambda value: projectile(moment_of_inertia=value), (0.0, -0.1, NAN, INF)),
    (CRH, lambda value: Ogive(caliber_radius_head=value), (0.49, 0.0, -3.0, NAN, INF)),
    (CRH, lambda value: Spherical(caliber_radius_head=value), (0.49, NAN, INF)),
    ("projectile.nose.length_to_diameter", lambda value: Conical(length_to_diameter=value), (0.0, -1.0, NAN, INF)),
    (f"{TAIL}.length", lambda value: BoatTail(length=value, base_diameter=0.06), (0.0, -0.1, NAN, INF)),
    (f"{TAIL}.base_diameter", lambda value: BoatTail(length=0.1, base_diameter=value), (-0.01, NAN, INF)),
    (POINTS, lambda value: Profile(points=value), (None, 0.04, "flat", np.array(0.04))),
    ("target.compressive_strength", lambda value: target(compressive_strength=value), (0.0, -39e6, NAN, INF)),
    ("target.density", lambda value: target(density=value), (0.0, -1.0, NAN, INF)),
    ("target.youngs_modulus", lambda value: target(youngs_modulus=value), (0.0, -1.0, NAN, INF)),
    ("target.thickness", lambda value: target(thickness=value), (0.0, -0.2, NAN, INF)),
    ("target.poissons_ratio", lambda value: target(poissons_ratio=value), (-0.1, 0.51, NAN, INF)),
    ("impact.velocity", lambda value: impact(velocity=value), (0.0, -238.0, NAN, INF)),
    ("impact.oblique_angle", lambda value: impact(oblique_angle=value), (math.pi / 2, -math.pi / 2, 2.0, NAN, INF)),
    ("impact.angle_of_attack", lambda value: impact(angle_of_attack=value), (1.6, -1.6, NAN, INF)),
    ("impact.angular_velocity", lambda value: impact(angular_velocity=value), (NAN, INF, -INF)),
    (f"{S}.value", lambda value: ConstantStrengthFactor(value=value), (0.0, -8.0, NAN, INF)),
    (f"{S}.coefficient", lambda value: StrengthPowerLaw(coefficient=value), (0.0, -8.0, NAN, INF)),
    (f"{S}.exponent", lambda value: StrengthPowerLaw(exponent=value), (NAN, INF)),
    (f"{S}.reference_strength", lambda value: StrengthPowerLaw(reference_strength=value), (0.0, -1e6, NAN, INF)),
    (f"{S}.diameter_exponent", lambda value: StrengthPowerLaw(diameter_exponent=value), (NAN, INF)),
    (f"{S}.reference_diameter", lambda value: StrengthPowerLaw(reference_diameter=value), (0.0, -0.08, NAN, INF)),
    ("resistance.inertia_factor", lambda value: Resistance(inertia_factor=value), (-0.1, NAN, INF)),
    ("resistance.crater.depth_diameters", lambda value: Crater(depth_diameters=value), (0.0, -1.0, 21.0, NAN, INF)),
    ("resistance.rear_plug.cone_angle", lambda value: ShearPlug(cone_angle=value), (0.0, 0.157, math.pi / 2.0, NAN)),
    (
        "numerics.retention_energy_fraction",
        lambda value: Numerics(retention_energy_fraction=value),
        (0.0, 5e-5, 0.6, NAN),
    ),
    ("search.tolerance", lambda value: Search(tolerance=value), (0.0, NAN)),
    ("search.relative_tolerance", lambda value: Search(relative_tolerance=value), (0.0,)),
    ("search.scan_interval", lambda value: Search(scan_interval=value), (0.0,)),
    ("search.lower", lambda value: Search(lower=value, upper=0.7), (1.0, 0.7, -0.02, NAN)),
    ("search.upper", lambda value: Search(upper=value), (math.pi / 2.0,)),
    ("impact.velocity", lambda value: critical_angle(**CASE, velocity=value), (0.0, -238.0, NAN, INF)),
    ("velocity", lambda value: closed_form_depth(**CASE, velocity=value, strength_factor=8.0), (0.0, -1.0, NAN, INF)),
    (
        "strength_factor",
        lambda value: closed_form_depth(**CASE, velocity=238.0, strength_factor=value),
        (0.0, -1.0, NAN, INF),
    ),
    ("numerics.termination_time", lambda value: Numerics(termination_time=value), (0.0, -1.0, NAN)),
    ("numerics.panels", lambda value: Numerics(panels=value), (99, 1_000_001)),
    ("numerics.time_step", lambda value: Numerics(time_step=value), (0.0, -1e-5, NAN)),
    ("numerics.relative_tolerance", lambda value: Numerics(relative_tolerance=value), (0.0, 1e-11, 0.1, NAN)),
    ("numerics.stations", lambda value: Numerics(stations=value), (1, 257)),
    ("numerics.points", lambda value: Numerics(points=value), (1, 257)),
    ("sample_interval", lambda value: paper_run(30.0, sample_interval=value), (0.0, -1e-5, NAN)),
]
CASES: list[tuple[str, Callable[[], object]]] = [
    (POINTS, lambda: profile((0.0, 0.0))),
    (POINTS, lambda: profile(*((i * 1e-4, i * 1e-5) for i in range(1001)))),
    (POINTS, lambda: projectile(nose=profile((0.0, 0.0), (0.1, 0.03)))),
    (f"{POINTS}.0", lambda: profile((0.1, 0.0), (0.2, 0.04))),
    (f"{POINTS}.0", lambda: profile((0.0, -0.01), (0.2, 0.04))),
    (f"{POINTS}.1", lambda: profile((0.0, 0.0), (NAN, 0.04))),
    (f"{POINTS}.1", lambda: profile((0.0, 0.0), (0.1, INF))),
    (f"{POINTS}.1", lambda: profile((0.0, 0.0), (0.0, 0.0), (0.1, 0.04))),
    (f"{POINTS}.2", lambda: profile((0.0, 0.0), (0.1, 0.01), (0.2, 0.04))),
    (f"{POINTS}.2", lambda: profile((0.0, 0.0), (0.1, 0.05), (0.1, 0.04))),  # the last two points would be a base
    (f"{POINTS}.2", lambda: profile((0.0, 0.0), (0.1, 0.04), (0.2, -0.01))),
    (f"{POINTS}.3", lambda: profile((0.0, 0.0), (0.1, 0.04), (0.15, 0.01), (0.2, 0.0))),  # not convex
    (f"{POINTS}.3", lambda: profile((0.0, 0.0), (0.1, 0.04), (0.15, 0.0), (0.2, 0.0))),  # closed before its end
    (f"{POINTS}.2", lambda: profile((0.0, 0.04), (0.1, 0.02), (0.2, 0.04))),
    (POINTS, lambda: projectile(nose=profile((0.0, 0.0), (0.1, 0.05), (0.53, 0.04)))),  # wider than the shank
    (POINTS, lambda: projectile(nose=profile((0.0, 0.0), (0.1, 0.04), (0.2, 0.03)))),  # ends before the base
    ("projectile.length", lambda: projectile(nose=Sphere())),
    ("projectile.length", lambda: projectile(nose=Sphere(), length=0.079)),
    (TAIL, lambda: projectile(nose=Sphere(), length=0.08, boat_tail=BOAT_TAIL)),
    (TAIL, lambda: projectile(nose=profile((0.0, 0.0), (0.1, 0.04), (0.53, 0.03)), boat_tail=BOAT_TAIL)),
    (TAIL, lambda: projectile(boat_tail=0.1)),
    (f"{TAIL}.length", lambda: projectile(boat_tail=BoatTail(length=0.398, base_diameter=0.06))),
    (f"{TAIL}.base_diameter", lambda: projectile(boat_tail=BoatTail(length=0.1, base_diameter=0.081))),
    (f"{POINTS}.2", lambda: profile((0.0, 0.0), (0.1, 0.03), (0.05, 0.04))),
    (f"{POINTS}.1", lambda: profile((0.0, 0.0), (0.1, 0.0))),
    (f"{POINTS}.2", lambda: profile((0.0, 0.0), (0.1, 0.02 * (1.0 - 1e-2)), (0.2, 0.04))),
    (f"{POINTS}.3", lambda: profile((0.0, 0.0), (0.05, 0.02), (0.1, 0.025), (0.15, 0.04), (0.2, 0.045))),
    (f"{POINTS}.2", lambda: profile((0.0, 0.0), (0.1, 0.03), (0.1, 0.03), (0.2, 0.04))),
    (f"{POINTS}.1", lambda: Profile(points=np.array([[0.0, 0.0], [NAN, 0.03], [0.2, 0.04]]))),  # type: ignore[arg-type]
    (f"{POINTS}.1", lambda: profile((0.0, 0.0), (0.1, 0.03, 0.0), (0.2, 0.04))),  # type: ignore[arg-type]
    (f"{POINTS}.1", lambda: profile((0.0, 0.0), 0.1)),  # type: ignore[arg-type]
    (f"{POINTS}.1", lambda: profile((0.0, 0.0), (0.1, "0.03"))),  # type: ignore[arg-type]
    (f"{S}.obliquity_shape", lambda: StrengthPowerLaw(obliquity_shape="cosine")),  # type: ignore[arg-type]
    (f"{S}.obliquity_shape", lambda: PublishedTests(obliquity_shape="cosine")),  # type: ignore[arg-type]
    (f"{S}.covariance", lambda: covariance((1.0, 0.0), (0.0, 1.0))),  # two rows are too few for three coefficients
    (f"{S}.covariance.1", lambda: covariance((1.0, 0.0, 0.0), (0.0, 1.0), (0.0, 0.0, 1.0))),
    (f"{S}.covariance.2.1", lambda: covariance((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, NAN, 1.0))),
    (f"{S}.covariance", lambda: covariance((1.0, 0.1, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),  # not symmetric
    (f"{S}.covariance", lambda: covariance((1.0, 0.0, 0.0), (0.0, -1e-9, 0.0), (0.0, 0.0, 1.0))),
    (f"{S}.covariance", lambda: covariance((1.0, 2e-4, 0.0), (2e-4, 1e-8, 0.0), (0.0, 0.0, 1e-12))),  # not semidefinite
    (f"{S}.coefficients", lambda: ObliquityPolynomial(coefficients=())),
    (f"{S}.coefficients", lambda: ObliquityPolynomial(coefficients=(1.0,) * 11)),
    (f"{S}.coefficients.1", lambda: ObliquityPolynomial(coefficients=(8.0, NAN))),
    ("numerics.method", lambda: Numerics(method="euler")),  # type: ignore[arg-type]
    ("numerics.time_step", lambda: paper_run(30.0, numerics=Numerics(method="panels", time_step=1e-7))),
    ("sample_interval", lambda: paper_run(30.0, sample_interval=1e-10)),
    ("search.lower", lambda: critical_angle(**CASE, velocity=238.0, search=Search(method="secant", lower=1.065))),
    ("search.method", lambda: Search(method="guess")),  # type: ignore[arg-type]
    *[(field, lambda make=make, value=value: make(value)) for field, make, values in VALUES for value in values],
]


@pytest.mark.parametrize(("field", "make"), CASES)
def test_invalid_value_is_refused_with_the_name_of_its_field(field: str, make: Callable[[], object]) -> None:
    with pytest.raises(ParameterError) as caught:
        make()
    assert caught.value.field == field
    assert str(caught.value).startswith(f"{field}: ")
    assert len(caught.value.requirement.split()) > 2
    assert isinstance(caught.value, RicochetError)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        (
            {
                "impact": paper_impact(oblique_angle_degrees=60.0),
                "resistance": Resistance(strength_factor=ObliquityPolynomial(coefficients=(6.0, -0.1))),
            },
            S,
            "must be greater than 0 at the initial oblique angle of 60",
        ),
        ({"resistance": beyond_all_numbers(1e3)}, S, "must be greater than 0"),
        ({"resistance": beyond_all_numbers(-1e3)}, S, "must be greater than 0"),
        (
            {"target": target(youngs_modulus=39e6)},
            "target.youngs_modulus",
            "not yield around the cavity otherwise, got 3.9e",
        ),
    ],
)
def test_law_or_target_without_resistance_is_refused(changes: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(ParameterError, match=words) as caught:
        strike(**changes)
    assert caught.value.field == field


def test_nose_as_long_as_the_projectile_is_accepted() -> None:
    nose = Conical(length_to_diameter=2.0)
    assert projectile(nose=nose, length=0.16).nose_length == 0.16
    assert projectile(nose=Flat(), length=1e-3).nose_length == 0.0


MANY: Any = np.array([200.0, 300.0])


@pytest.mark.parametrize(
    ("field", "make", "words"),
    [
        ("target.compressive_strength", lambda: target(compressive_strength=39.0), "39e6 for 39 MPa"),
        ("target.compressive_strength", lambda: target(compressive_strength=39e3), "3.9e+07 for 39000 kPa"),
        ("target.density", lambda: target(density=2.25), "give kg/m³, 2250 for 2.25 g/cm³"),
        ("target.youngs_modulus", lambda: target(youngs_modulus=30.0), "3e+10 for 30 GPa"),
        ("target.thickness", lambda: target(thickness=1500.0), "give metres, 1.5 for 1500 mm"),
        ("projectile.diameter", lambda: projectile(diameter=80.0, length=530.0), "0.08 for 80 mm"),
        ("projectile.length", lambda: projectile(length=530.0), "must be 0.001 to 20 m, got 530 m"),
        ("projectile.mass", lambda: projectile(mass=1e9), "must be 1e-6 to 1e7 kg, got 1e9 kg"),
        (CRH, lambda: projectile(nose=Ogive(caliber_radius_head=101.0), length=2.0), "0.5 to 100"),
        ("impact.velocity", lambda: impact(velocity=2e4), "must be 0.1 to 10,000 m/s"),
        ("impact.oblique_angle", lambda: impact(oblique_angle=55.0), "give radians, math.radians(55) for 55°"),
        ("impact.angle_of_attack", lambda: impact(angle_of_attack=3.0), "give radians, math.radians(3) for 3°"),
        ("search.lower", lambda: Search(lower=5), "give radians, math.radians(5) for 5°"),
        ("search.upper", lambda: Search(upper=85.0), "give radians, math.radians(85) for 85°"),
        ("impact.velocity", lambda: impact(velocity=MANY), "one number, got ndarray of 2: simulate_many"),
        ("impact.velocity", lambda: impact(velocity=[200.0]), "one number, got list of 1: simulate_many"),
        ("impact.oblique_angle", lambda: impact(oblique_angle="45°"), "must be a number, got '45°'"),
        ("impact.velocity", lambda: impact(velocity=None), "must be a number, got None"),
        ("impact", lambda: strike(impact=[impact(), impact()]), "one Impact, got list: simulate_many"),
        ("target", lambda: strike(target=[PAPER_TARGET]), "one Target, got list: simulate_many"),
        ("projectile", lambda: strike(projectile="ogive"), "one Projectile, got str"),
        ("projectile.nose", lambda: projectile(nose="ogive"), "got 'ogive'; give Ogive(...)"),
        ("projectile.nose", lambda: projectile(nose=Flat), "got Flat; give Flat(...)"),
        ("projectile.nose", lambda: projectile(nose=3.0), "must be Ogive(...), Conical(...), "),
        ("projectile.mass", lambda: projectile(mass="13 kg"), "must be a number, got '13 kg'"),
        ("projectile.diameter", lambda: projectile(diameter=MANY), "one number, got ndarray of 2"),
        ("projectile.center_of_gravity", lambda: projectile(center_of_gravity="0.3"), "must be a number"),
        (CRH, lambda: Ogive(caliber_radius_head=MANY), "one number, got ndarray of 2"),
        ("target.density", lambda: Target(compressive_strength=39e6, density=MANY), "one number, got ndarray of 2"),
        (S, lambda: resistance(strength_factor="published_tests"), "give PublishedTests(...)"),
        (S, lambda: resistance(strength_factor=8.2), "must be ConstantStrengthFactor(...), "),
        ("resistance.free_surface", lambda: resistance(free_surface="none"), "give NoFreeSurface(...)"),
        ("resistance.free_surface", lambda: resistance(free_surface=None), "got NoneType"),
        ("resistance.inertia_factor", lambda: resistance(inertia_factor=None), "must be a number, got None"),
        ("impact.velocity", lambda: critical_angle(**CASE, velocity=MANY), "critical_angle_many"),
    ],
)
def test_arguments_of_the_wrong_kind_are_refused_with_a_hint(
    field: str, make: Callable[[], object], words: str
) -> None:
    with pytest.raises(ParameterError) as caught:
        make()
    assert caught.value.field == field
    assert words in str(caught.value)


def test_numpy_numbers_are_accepted() -> None:
    for value in (np.float64(238.0), np.float32(238.0), np.int64(238), np.array(238.0), 238):
        assert impact(velocity=value).velocity == 238.0


def test_bounds_equal_the_bounds_in_the_contract() -> None:
    """Solver and contract have the same bounds of numbers, included or excluded, and show them in the same units."""
    schema = TrajectoryRequest.model_json_schema()["$defs"] | {"FlightRequest": FlightRequest.model_json_schema()}
    parts = {
        "projectile": "Projectile",
        "target": "Target",
        "impact": "Impact",
        "shot": "OwnShot",
        "flight": "FlightRequest",
    }
    found = 0
    for path, bound in BOUNDS.items():
        part, _, name = path.partition(".")
        for field, described in schema[parts[part]]["properties"].items():
            if field.startswith(f"{name}_") or field == name:
                ends = {each: described[each] for each in described if "imum" in each.lower()}
                low, high = "exclusiveMinimum" if bound.above else "minimum", "maximum"
                assert ends == {low: bound.lower, "exclusiveMaximum" if bound.below else high: bound.upper}, path
                assert (shown_in(f"{part}.{field}") or bound.unit) == bound.unit, path  # fractions have no unit
                found += 1
    assert found == len([path for path in BOUNDS if path.count(".") == 1])


HISTORY = MotionHistory(time=[0.0, 1e-3, 2e-3], rotation=[0.0, 0.01, 0.03])  # type: ignore[arg-type] # a sequence will do
STRIKE = Impact(velocity=238.0, oblique_angle=0.5)
ARGUMENTS: dict[str, Any] = CASE | {
    "target": replace(PAPER_TARGET, thickness=0.2),
    "impact": STRIKE,
    "velocity": 238.0,
    "oblique_angle": 0.5,
    "axes": {"velocity": [238.0]},
    "uncertain": [Uncertain("velocity", Normal(mean=238.0, standard_deviation=2.0))],
    "tests": [DepthTest(velocity=238.0, depth=0.1)],
    "history": HISTORY,
    "runs": [MotionRun(impact=STRIKE, history=HISTORY)],
    "velocities": [238.0],
    "strength_factor": 8.0,
    "times": [0.0, 1e-3],
    "function": critical_angle,
}
"""Values for the required arguments of the functions in `FUNCTIONS_WITH_RESISTANCE`, by name."""
ARGUMENTS_OF = {
    "alternatives": {**CASE, "velocity": 238.0},
    "least_thickness": {"impact": STRIKE, "target": PAPER_TARGET},
}
ARGUMENTS_OF |= {"thickness_spread": {"target": PAPER_TARGET}, "limit_velocity": {"oblique_angle": 0.0}}
BATCH_FUNCTIONS = ("critical_angle_many", "simulate_many", "least_thickness_many", "limit_velocity_many")
"""Functions of many cases. They do not raise the error of a case, but return it in the place of its result."""
FUNCTIONS_WITH_RESISTANCE: dict[str, Callable[..., Any]] = {
    name: function
    for package in (solver, solver.uncertainty, solver.calibration)
    for name, function in vars(package).items()
    if name in package.__all__ and isfunction(function) and "resistance" in signature(function).parameters
}


@pytest.mark.parametrize("name", sorted(FUNCTIONS_WITH_RESISTANCE))
def test_object_that_is_not_a_resistance_is_refused(name: str) -> None:
    """Every public function with an argument `resistance` refuses other classes and says what to pass."""
    given: list[tuple[Any, str]] = [
        (MohrCoulomb(), r"give Resistance\(free_surface=MohrCoulomb\(\.\.\.\)\)"),
        (PublishedTests(), r"give Resistance\(strength_factor=PublishedTests\(\.\.\.\)\)"),
        ("mohr_coulomb", "got str"),
        (3.0, "got float"),
    ]
    needed = [
        each.name
        for each in signature(FUNCTIONS_WITH_RESISTANCE[name]).parameters.values()
        if each.default is each.empty
    ]
    arguments = {each: ARGUMENTS[each] for each in needed if each in ARGUMENTS} | ARGUMENTS_OF.get(
        name.removesuffix("_many"), {}
    )
    for resistance, message in given:
        try:
            found = FUNCTIONS_WITH_RESISTANCE[name](**arguments | {"resistance": resistance})
        except ParameterError as error:
            assert name not in BATCH_FUNCTIONS
            found = [error]
        assert isinstance(found[0], ParameterError)
        assert re.fullmatch(f"resistance: must be a Resistance(: |, ){message}", str(found[0]))


def test_default_spherical_nose_is_a_hemisphere() -> None:
    assert Spherical() == Spherical(caliber_radius_head=0.5)


def test_help_begins_with_a_page_that_fits_a_screen() -> None:
    lines = (solver.__doc__ or "").splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 120
    found = (re.findall(r"^[a-z]\w*(?:, \w+)*(?=  )", line) for line in lines)
    named = {name for names in found for each in names for name in each.split(", ")}
    assert {"critical_angle", "simulate", "formulas", "flight", "warm_up"} <= named
    assert all(hasattr(solver, name) for name in named)
