"""What a worker computes is what the solver computes here, to the last bit, and it is ready to do so at once."""

import os
import pickle
import socket
import threading
import time
from collections import deque
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest

from service.pool.executor import PoolExecutor
from service.pool.worker import Channel, answer, run_cra, run_trajectory, unpacked
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
    finished = unpacked(answer(b"not a pickle"))
    assert finished.value is None
    assert isinstance(finished.error, pickle.UnpicklingError)


def test_reply_that_cannot_be_understood_is_the_error_of_its_call() -> None:
    assert isinstance(unpacked(b"not a pickle").error, pickle.UnpicklingError)


def test_messages_arrive_whole_and_in_order_however_they_are_cut() -> None:
    ours, theirs = socket.socketpair()
    sent = [os.urandom(length) for length in (0, 1, 7, 8, 100_000, 3_000_000, 0, 5)]
    channel, other = Channel(ours), Channel(theirs)
    sender = threading.Thread(target=lambda: deque(map(other.send, sent)))
    sender.start()
    assert [channel.receive() for _ in sent] == sent
    sender.join()
    assert not channel.waiting()
    assert channel.receive(0.01) is None
    other.close()
    channel.close()


def test_what_was_said_before_the_other_end_went_is_still_heard() -> None:
    ours, theirs = socket.socketpair()
    channel, other = Channel(ours), Channel(theirs)
    channel.send(b"never read")
    other.send(b"one")
    other.send(b"two")
    theirs.sendall(b"half of a length"[:5])
    other.close()
    assert channel.waiting()
    assert [channel.receive(), channel.receive()] == [b"one", b"two"]
    with pytest.raises((EOFError, ConnectionResetError)):
        channel.receive()
    channel.close()


def test_message_nobody_takes_is_given_up_in_time() -> None:
    ours, theirs = socket.socketpair()
    channel, started = Channel(ours), time.monotonic()
    with pytest.raises(TimeoutError):
        channel.send(bytes(10_000_000), 0.1)
    assert time.monotonic() - started < 1.0
    channel.close()
    theirs.close()
