"""What a worker computes is what the solver computes here, to the last bit, and it is ready to do so at once."""

import pickle
import time
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest

from service.executor import PoolExecutor
from service.worker import answer, run_cra, run_trajectory
from solver import Impact, Numerics, ParameterError, Search, critical_angle, simulate
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(120)]

SHOT: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET}
SEARCH: dict[str, Any] = {**SHOT, "velocity": PAPER_VELOCITY, "angle_of_attack": 0.01, "search": Search(lower=0.7)}


async def test_trajectory_is_the_solvers_own(pool: PoolExecutor) -> None:
    arguments = {**SHOT, "impact": Impact(velocity=PAPER_VELOCITY, oblique_angle=0.9)}
    found, expected = await pool.submit(run_trajectory, arguments), simulate(**arguments)
    assert found.final == expected.final
    assert found.history is not None
    assert expected.history is not None
    assert np.array_equal(astuple(found.history), astuple(expected.history))


async def test_critical_angle_is_the_solvers_own_and_comes_with_the_motion_at_it(pool: PoolExecutor) -> None:
    case = await pool.submit(run_cra, SEARCH, 1e-5)
    assert case.found == critical_angle(**SEARCH)
    assert case.found.angle is not None
    assert case.trajectory is not None
    impact = Impact(velocity=PAPER_VELOCITY, oblique_angle=case.found.angle, angle_of_attack=0.01)
    assert case.trajectory.final == simulate(**SHOT, impact=impact).final


async def test_critical_angle_without_history_or_without_an_angle_has_no_motion(pool: PoolExecutor) -> None:
    assert (await pool.submit(run_cra, SEARCH, None)).trajectory is None
    case = await pool.submit(run_cra, {**SEARCH, "search": Search(lower=0.1, upper=0.2)}, 1e-5)
    assert case.found.angle is None
    assert case.trajectory is None


async def test_error_of_the_solver_arrives_with_its_field(pool: PoolExecutor) -> None:
    impact = Impact(velocity=PAPER_VELOCITY, oblique_angle=0.9)
    numerics = Numerics(time_step=1e-3, termination_time=1e-9)
    with pytest.raises(ParameterError) as caught:
        await pool.submit(run_trajectory, {**SHOT, "impact": impact, "numerics": numerics, "sample_interval": -1.0})
    assert caught.value.field
    assert "run_trajectory" in caught.value.__notes__[0]  # where in the worker it happened


async def test_first_query_of_a_worker_does_not_wait_for_the_compiler(pool: PoolExecutor) -> None:
    started = time.monotonic()
    await pool.submit(run_trajectory, {**SHOT, "impact": Impact(velocity=PAPER_VELOCITY, oblique_angle=0.9)})
    assert time.monotonic() - started < 0.3


def test_message_that_cannot_be_understood_is_an_answer_not_the_end_of_the_worker() -> None:
    succeeded, error = pickle.loads(answer(b"not a pickle"))  # noqa: S301
    assert not succeeded
    assert isinstance(error, pickle.UnpicklingError)
