"""The methods, panels with fixed steps and Gauss points with adaptive steps, give the same motion for every nose."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numba import njit

from solver import (
    Conical,
    ElasticPlastic,
    Impact,
    IntegrationError,
    Motion,
    Numerics,
    Ogive,
    Outcome,
    Profile,
    Projectile,
    Resistance,
    Target,
    mass_properties,
    simulate,
)
from solver.arrays import FloatArray, IntArray
from solver.cancellation import NO_LIMIT
from solver.loads import MOST_STATES, Scratch, make_scratch
from solver.motion import STEP_WIDTH, Model, Thresholds, accelerate, make_workspace, sample_loads
from solver.prepared import initial_state, prepare
from solver.strike import PAPER_TARGET
from solver.surface import Panels, build_panels
from solver.time_integration import LARGEST_STEP, Accuracy, integrate_adaptive, integrate_fixed, make_linearisation

from .strikes import DECAYS, DIAMETER, NOSES, TAPERING, known, steel

REST = 1e-2
"""Kinetic energy relative to its initial value below which fixed steps are too inaccurate for a comparison. [1]"""

CASES: list[tuple[str, float, float, float, str]] = [
    # nose, oblique angle [°], angle of attack [°], velocity [m/s], decay
    ("ogive", 35.0, -2.0, 300.0, "elastic-plastic"),
    ("slender ogive", 60.0, 0.0, 450.0, "mohr-coulomb"),
    ("ogive as hemisphere", 50.0, 2.0, 250.0, "elastic-plastic with inertia"),
    ("cone", 45.0, 0.0, 238.0, "none"),
    ("slender cone", 20.0, 3.0, 200.0, "elastic-plastic"),
    ("blunt cone", 65.0, 0.0, 350.0, "elastic-plastic"),
    ("hemisphere", 30.0, -4.0, 238.0, "mohr-coulomb with inertia"),
    ("cap", 55.0, 1.0, 400.0, "elastic-plastic"),
    ("flat", 40.0, 0.0, 238.0, "elastic-plastic"),
    ("truncated cone", 70.0, 0.0, 238.0, "elastic-plastic"),
    ("three cones", 48.0, 0.0, 238.0, "mohr-coulomb"),
]


def moving(history: Motion[FloatArray]) -> int:
    """Return the number of samples before the energy falls below `REST`."""
    return int(np.argmax(np.append(history.kinetic_energy, 0.0) < REST * history.kinetic_energy[0]))


@pytest.mark.parametrize(("nose", "oblique", "attack", "velocity", "decay"), CASES)
def test_both_routes_give_the_same_path(nose: str, oblique: float, attack: float, velocity: float, decay: str) -> None:
    """Until `REST`, the tip agrees within a millimetre or a hundredth of the depth, and the axis within half a degree.

    The difference comes from the fixed steps of 5 µs: steps of 1 µs reduce it to a quarter.
    """
    strike: dict[str, Any] = {
        "projectile": steel(NOSES[nose]),
        "target": PAPER_TARGET,
        "impact": Impact(velocity=velocity, oblique_angle=math.radians(oblique), angle_of_attack=math.radians(attack)),
        "resistance": Resistance(free_surface=DECAYS[decay]),
        "sample_interval": 5e-5,
    }
    adaptive = simulate(**strike)
    panels = simulate(**strike, numerics=Numerics(method="panels", time_step=5e-6, termination_time=0.01))
    assert (adaptive.outcome is Outcome.RICOCHET) == (panels.outcome is Outcome.RICOCHET)
    a, b = adaptive.history, panels.history
    assert a is not None
    assert b is not None
    count = min(moving(a), moving(b), a.time.size - 1, b.time.size - 1)
    assert count > 10
    np.testing.assert_allclose(a.time[:count], b.time[:count], rtol=0, atol=1e-12)
    depth = np.abs(a.nose_tip_depth[:count] - b.nose_tip_depth[:count]).max()
    angle = np.degrees(np.abs(a.axis_angle[:count] - b.axis_angle[:count])).max()
    assert depth < max(1e-3, 0.01 * known(adaptive.maximum_depth))
    assert angle < 0.5


SHORT_CONE = Projectile(nose=Conical(length_to_diameter=1.0), diameter=0.08, length=0.08, mass=1.0)
"""A cone so short that the same part of its surface stays loaded while it turns a little."""
TURNING = Impact(velocity=238.0, oblique_angle=0.5, angle_of_attack=0.1, angular_velocity=20.0)


def deep_inside(numerics: Numerics) -> tuple[FloatArray, Model]:
    """Return state and model of the short cone at a depth of 0.3 m, where its motion is smooth."""
    prepared = prepare(
        projectile=SHORT_CONE,
        target=PAPER_TARGET,
        resistance=Resistance(free_surface=ElasticPlastic()),
        numerics=numerics.resolved(),
    )
    model = prepared.model._replace(law=prepared.law_at(TURNING))
    state = initial_state(TURNING, model.body)
    state[0] += 0.3
    return state, model


NO_END = Thresholds(retention=1e-9, rest=1e-9)
"""Energy thresholds so low that they do not end these short motions."""


def slope(sizes: FloatArray, errors: FloatArray) -> float:
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def no_table() -> FloatArray:
    return np.empty((1, STEP_WIDTH))


def control() -> IntArray:
    return np.array([0, NO_LIMIT])


def by_fixed_steps(start: FloatArray, model: Model, time: float, count: int) -> FloatArray:
    state = np.empty(6)
    integrate_fixed(start, model, time, NO_END, time / count, no_table(), state, control(), make_workspace())
    return state


def test_fixed_step_is_of_fourth_order_while_the_motion_is_smooth() -> None:
    start, model = deep_inside(Numerics(method="panels", panels=1000))
    time = 1e-4
    exact = by_fixed_steps(start, model, time, 512)
    counts = np.array([4, 8, 16, 32])
    errors = [np.abs(by_fixed_steps(start, model, time, n) - exact) for n in counts]
    for component in range(6):
        order = slope(1.0 / counts, np.array([error[component] for error in errors]))
        assert order == pytest.approx(4.0, abs=0.25)


def test_adaptive_step_error_falls_with_its_tolerance() -> None:
    """Over four decades the error is below a tenth of the tolerance, with a slope of 0.8 to 1.2 on logarithmic axes."""
    start, model = deep_inside(Numerics(stations=16, points=8))

    def final(tolerance: float) -> FloatArray:
        room = make_workspace(), make_linearisation()
        accuracy = Accuracy(tolerance, LARGEST_STEP)
        state = np.empty(6)
        integrate_adaptive(start, model, 1e-4, NO_END, accuracy, no_table(), state, control(), *room)
        return state

    exact = final(1e-12)
    tolerances = np.array([1e-6, 1e-7, 1e-8, 1e-9, 1e-10])
    errors = [np.abs(final(float(tolerance)) - exact)[0] for tolerance in tolerances]
    assert slope(tolerances, np.array(errors)) == pytest.approx(1.0, abs=0.2)
    assert all(error < 0.1 * tolerance for error, tolerance in zip(errors, tolerances, strict=True))


def test_panels_converge_with_the_square_of_their_size_to_the_gauss_points() -> None:
    """The whole surface is loaded here. Where the face cuts panels, convergence is of first order, with scatter."""
    start, gauss = deep_inside(Numerics(stations=32, points=32))
    gauss = gauss._replace(law=gauss.law._replace(ramp_velocity=1e-9))  # Panels have no ramp.
    expected = sample_loads(start[None], gauss)[0]
    counts = np.array([500, 2_000, 8_000, 32_000])
    errors = []
    for count in counts:
        panels = build_panels(SHORT_CONE, mass_properties(SHORT_CONE), int(count))
        errors.append(np.abs(sample_loads(start[None], gauss._replace(panels=panels))[0] / expected - 1.0))
    moment = np.array(errors)[:, 2]
    assert slope(1.0 / np.sqrt(counts), moment) == pytest.approx(2.0, abs=0.3)
    assert np.all(np.array(errors)[-1] < 1e-4)


@cache
def body_and_panels(name: str) -> tuple[Projectile, Panels]:
    projectile = TAPERING[name] if name in TAPERING else steel(NOSES[name])
    return projectile, build_panels(projectile, mass_properties(projectile), 200_000)


@pytest.mark.parametrize("decay", DECAYS)
@pytest.mark.parametrize("thickness", [None, 0.4])
@pytest.mark.parametrize("body", ["ogive", "cone", "blunt cone", "hemisphere", "truncated cone", *TAPERING])
def test_loads_agree_with_panels_in_any_attitude_and_motion(body: str, thickness: float | None, decay: str) -> None:
    """Loads in any attitude and motion agree within 0.3 % of the largest load, or 0.4 % for tapering bodies.

    This is the accuracy of the panels where the face or the edge of the loaded part cuts them.
    """
    projectile, panels = body_and_panels(body)
    numerics = Numerics(stations=24, points=8).resolved()
    target, resistance = replace(PAPER_TARGET, thickness=thickness), Resistance(free_surface=DECAYS[decay])
    gauss = prepare(projectile=projectile, target=target, resistance=resistance, numerics=numerics).model
    gauss = gauss._replace(law=gauss.law._replace(static_stress=3e8, ramp_velocity=1e-9))
    states = tumbling(60, gauss)
    expected = sample_loads(states, gauss._replace(panels=panels))
    largest = abs(expected).max(axis=0)
    largest[2] = max(largest[2], 0.1 * DIAMETER * largest[0])  # The moment on a sphere is rounding error.
    tolerance = 4e-3 if body in TAPERING else 3e-3
    np.testing.assert_allclose(sample_loads(states, gauss) / largest, expected / largest, atol=tolerance)


def call_accelerate(states: FloatArray, model: Model, scratch: Scratch, out: FloatArray) -> None:
    accelerate(states, model, scratch, out)


accelerations: Any = njit(call_accelerate)
"""Compiled wrapper; Python cannot call `accelerate` itself, which only compiled code calls."""


@pytest.mark.parametrize("stations", [3, 12, 256])
def test_states_evaluated_together_equal_single_evaluations(stations: int) -> None:
    """Some of these numbers of stations give fewer rings than are evaluated at a time, others more."""
    numerics, resistance = Numerics(stations=stations).resolved(), Resistance()
    prepared = prepare(projectile=steel(NOSES["ogive"]), target=PAPER_TARGET, resistance=resistance, numerics=numerics)
    model = prepared.model._replace(law=prepared.model.law._replace(static_stress=3e8))
    states, scratch = tumbling(40 * MOST_STATES, prepared.model), make_scratch()
    together, alone = np.empty(3 * MOST_STATES), np.empty(3)
    for batch in states.reshape(-1, 6 * MOST_STATES):
        accelerations(batch, model, scratch, together)
        for k in range(MOST_STATES):
            accelerations(batch[6 * k : 6 * k + 6], model, scratch, alone)
            np.testing.assert_allclose(together[3 * k : 3 * k + 3], alone, rtol=1e-12, atol=1e-9)


def tumbling(count: int, model: Model) -> FloatArray:
    """Return random states near the face, with any attitude and motion, as an array (count, 6)."""
    random, length = np.random.default_rng(7), model.body.tip
    depths, angles = random.uniform(-1.0, 1.5, count) * length, random.uniform(-0.3, 2.8, count)
    velocities = random.normal(0.0, 200.0, (3, count))
    return np.column_stack((depths, np.zeros(count), angles, velocities[0], velocities[1], velocities[2] / length))


def test_profile_of_cones_approaches_the_ogive_it_is_inscribed_in() -> None:
    """Like area and volume, the depth converges with the inverse square of the number of cones."""
    a, s = 0.04, 0.24
    end = math.asin(math.sqrt(11.0) / 6.0)

    def depth(projectile: Projectile) -> float:
        impact = Impact(velocity=238.0, oblique_angle=math.radians(30.0))
        run = simulate(projectile=projectile, target=PAPER_TARGET, impact=impact, sample_interval=None)
        return known(run.maximum_depth)

    def inscribed(cones: int) -> Profile:
        angles = np.linspace(end, 0.0, cones + 1)
        x, r = a * math.sqrt(11.0) - s * np.sin(angles), a - s + s * np.cos(angles)
        points = [(float(p), float(q)) for p, q in zip(x, r, strict=True)]
        return Profile(points=((0.0, 0.0), *points[1:-1], (points[-1][0], a)))

    body = Projectile(
        nose=NOSES["ogive"], diameter=2 * a, length=0.53, mass=13.0, center_of_gravity=0.294, moment_of_inertia=0.25
    )
    exact = depth(body)
    counts = np.array([4, 8, 16])
    errors = np.array([abs(depth(replace(body, nose=inscribed(int(n)))) - exact) for n in counts])
    assert slope(1.0 / counts, errors) == pytest.approx(2.0, abs=0.5)
    assert errors[-1] < 1e-3


def test_fixed_steps_that_diverge_are_an_error() -> None:
    """A slender rod at 9.6 km/s with steps of a third of a millisecond gains energy without bound."""
    projectile = Projectile(
        nose=Ogive(caliber_radius_head=10.963436937052325),
        diameter=0.035355050208263045,
        length=8.719902476181762,
        mass=7177552.289768635,
        moment_of_inertia=0.99999,
    )
    target = Target(
        compressive_strength=269439156.2515081,
        density=14948.107877298173,
        youngs_modulus=860893636542.5715,
        poissons_ratio=0.12684555671351952,
    )
    numerics = Numerics(
        method="panels",
        panels=150,
        time_step=0.0003334556548268112,
        termination_time=0.8805132536744776,
        retention_energy_fraction=0.10018589490073927,
    )
    impact = Impact(velocity=9583.490635947335, oblique_angle=0.0)
    with pytest.raises(IntegrationError, match="no longer finite"):
        simulate(projectile=projectile, target=target, impact=impact, numerics=numerics)
