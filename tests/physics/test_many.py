"""Many strikes in one call: answers equal those of single calls, in order, and a failure stops no other case."""

import math
import threading
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest

from solver import (
    ConstantStrengthFactor,
    CriticalAngle,
    Impact,
    MohrCoulomb,
    Numerics,
    ParameterError,
    Resistance,
    Search,
    columns,
    critical_angle,
    critical_angle_many,
    least_thickness,
    least_thickness_many,
    limit_velocity,
    limit_velocity_many,
    simulate,
    simulate_many,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY

from .strikes import CASE

NEAR = Search(lower=math.radians(35.0), upper=math.radians(60.0))


@pytest.mark.parametrize("threads", [1, 2])
def test_many_critical_angles_equal_single_ones(threads: int) -> None:
    velocities = np.linspace(150.0, 300.0, 40)
    resistances = [Resistance(), Resistance(free_surface=MohrCoulomb())] * 20
    many = critical_angle_many(**CASE, velocity=velocities, resistance=resistances, search=NEAR, threads=threads)
    for velocity, resistance, answer in zip(velocities, resistances, many, strict=True):
        assert answer == critical_angle(**CASE, velocity=float(velocity), resistance=resistance, search=NEAR)


@pytest.mark.parametrize("threads", [1, 2])
def test_many_trajectories_equal_single_ones(threads: int) -> None:
    """There are more trajectories than the function computes in advance."""
    impacts = [Impact(velocity=238.0, oblique_angle=math.radians(0.5 * number)) for number in range(150)]
    numerics = Numerics(relative_tolerance=1e-2, stations=3)
    many = simulate_many(**CASE, impact=impacts, numerics=numerics, threads=threads)
    for impact, trajectory in zip(impacts, many, strict=True):
        alone = simulate(**CASE, impact=impact, numerics=numerics, sample_interval=None)
        assert trajectory == alone


@pytest.mark.parametrize("threads", [1, 2])
def test_many_walls_equal_single_ones_despite_a_failure(threads: int) -> None:
    numerics, tolerance = Numerics(relative_tolerance=1e-3), 1e-3
    angles = np.radians([0.0, 20.0, 40.0])
    impacts = [Impact(velocity=238.0, oblique_angle=float(angle)) for angle in angles]
    thick = [PAPER_TARGET, replace(PAPER_TARGET, thickness=0.2), PAPER_TARGET]
    options: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "numerics": numerics, "tolerance": tolerance}
    thicknesses = list(least_thickness_many(target=thick, impact=impacts, threads=threads, **options))
    walls = [replace(PAPER_TARGET, thickness=0.2), PAPER_TARGET, replace(PAPER_TARGET, thickness=0.1)]
    velocities = list(limit_velocity_many(target=walls, oblique_angle=angles, threads=threads, **options))
    assert isinstance(thicknesses[1], ParameterError)
    assert isinstance(velocities[1], ParameterError)
    for i in (0, 2):
        assert thicknesses[i] == least_thickness(target=thick[i], impact=impacts[i], **options)
        assert velocities[i] == limit_velocity(target=walls[i], oblique_angle=float(angles[i]), **options)


@pytest.mark.parametrize("threads", [1, 2])
def test_failed_case_yields_its_error_in_its_place(threads: int) -> None:
    answers = list(critical_angle_many(**CASE, velocity=[238.0, -1.0, 238.0], search=NEAR, threads=threads))
    assert [type(answer) for answer in answers] == [CriticalAngle, ParameterError, CriticalAngle]
    assert "velocity" in str(answers[1])
    assert answers[0] == answers[2]


def test_arguments_of_different_length_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"angle_of_attack.*velocity, 2, got 3"):
        list(critical_angle_many(**CASE, velocity=[200.0, 210.0], angle_of_attack=[0.0, 0.01, 0.02]))


def test_scalar_arguments_are_one_case() -> None:
    (answer,) = critical_angle_many(**CASE, velocity=PAPER_VELOCITY)
    assert answer == critical_angle(**CASE, velocity=PAPER_VELOCITY)


def test_answers_are_returned_while_later_cases_still_run() -> None:
    """The first of 100,000 answers are returned before the others are computed, and closing abandons the rest."""
    answers = critical_angle_many(
        **CASE,
        velocity=np.full(100_000, PAPER_VELOCITY),
        resistance=Resistance(strength_factor=ConstantStrengthFactor(value=8.0)),
        search=NEAR,
        threads=2,
    )
    first = list(islice(answers, 3))
    answers.close()  # type: ignore[attr-defined] # a sequence that computes
    assert first[0] == first[1] == first[2]


def test_answers_are_a_lazy_sequence_that_computes_each_once() -> None:
    velocities = [200.0, 238.0, -1.0]
    answers = critical_angle_many(**CASE, velocity=velocities, search=NEAR)
    assert len(answers) == 3
    assert isinstance(answers[-1], ParameterError)
    assert answers[1] is answers[1]
    assert answers[:2] == list(answers)[:2]
    assert all(first is second for first, second in zip(answers, answers, strict=True))
    for _ in range(2):
        assert columns(answers)["velocity"].tolist() == velocities
    with pytest.raises(IndexError):
        answers[3]


def test_answers_continue_after_an_interrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = critical_angle_many(**CASE, velocity=[200.0, 238.0, 250.0], search=NEAR)
    first = answers[0]
    with monkeypatch.context() as changed:
        changed.setattr("solver.many.attempt", interrupted)
        with pytest.raises(KeyboardInterrupt):
            answers[2]
    assert [isinstance(answer, CriticalAngle) for answer in answers] == [True, True, True]
    assert answers[0] is first


def interrupted(*_: Any) -> None:
    raise KeyboardInterrupt


def test_compiled_search_releases_the_interpreter_lock() -> None:
    """A counting thread continues while another computes searches, which hold the lock for a tenth of the time."""
    counted, running = 0, True

    def search() -> None:
        nonlocal running
        for _ in range(20):
            critical_angle(**CASE, velocity=PAPER_VELOCITY)
        running = False

    thread = threading.Thread(target=search)
    thread.start()
    waited = threading.Event()
    while running:
        waited.wait(0.001)
        counted += 1
    thread.join()
    assert counted >= 20
