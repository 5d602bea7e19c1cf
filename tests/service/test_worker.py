"""A worker gives bitwise the same results as the solver in this process, and does not compile."""

import asyncio
import math
import os
import pickle
import socket
import threading

import orjson
import pytest
from numba.core import event

from service.operations import compute_critical_angle, compute_trajectory
from service.schemas import CriticalAngleRequest, TrajectoryRequest, trajectory_answer
from service.schemas.strike import PAPER, PAPER_AT_45
from service.workers import Call
from service.workers.executor import loads
from service.workers.process_pool import ProcessPool
from service.workers.worker import (
    answer,
    check_requests,
    close_chunk,
    compute_case,
    compute_single,
    receive,
    send,
)
from service.workers.worker_process import Messages, WorkerDiedError
from solver import ENGINE_VERSION, ParameterError, critical_angle, simulate
from tests.service.records import read_records

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(120)]

ANGLE = {"oblique_angle_deg": 45.0}
CASE = TrajectoryRequest.model_validate(PAPER_AT_45)
SEARCH = CriticalAngleRequest.model_validate(PAPER | {"output": {"history": True}})


def canonical(request: TrajectoryRequest | CriticalAngleRequest) -> bytes:
    return orjson.dumps(request.canonical())


async def test_trajectory_of_a_worker_is_identical_to_the_solver(pool: ProcessPool) -> None:
    json, outcome = await pool.submit(compute_single, compute_trajectory, "trajectory", "0" * 64, canonical(CASE))
    expected, history = trajectory_answer(simulate(**CASE.arguments()))
    answer = orjson.loads(json)
    assert history is not None
    assert answer.pop("history") == {name: column.tolist() for name, column in history.items()}
    assert answer == expected | {"key": "0" * 64, "engine_version": ENGINE_VERSION}
    assert outcome == expected["outcome"]


async def test_critical_angle_includes_the_motion_at_that_angle(pool: ProcessPool) -> None:
    json, outcome = await pool.submit(compute_single, compute_critical_angle, "cra", "0" * 64, canonical(SEARCH))
    answer, (arguments, _) = orjson.loads(json), SEARCH.arguments()
    found = critical_angle(**arguments)
    assert found.angle is not None
    assert outcome == "converged"
    assert math.radians(answer["critical_angle_deg"]) == pytest.approx(found.angle, rel=1e-15)
    assert answer["trajectory"]["history"]["time_s"][-1] == answer["trajectory"]["final"]["time_s"]


async def test_file_of_a_chunk_contains_the_cases_of_its_worker(pool: ProcessPool) -> None:
    requests = [
        canonical(TrajectoryRequest.model_validate(PAPER_AT_45 | {"impact": {"velocity_m_s": 200.0 + number, **ANGLE}}))
        for number in range(3)
    ]
    calls: list[Call] = [
        (compute_case, (compute_trajectory, "trajectory", f"{number:064}", request, "chunk"))
        for number, request in enumerate(requests)
    ]
    *results, closed = await pool.run([*calls, (close_chunk, ("chunk",))])
    [(keys, content)] = closed.value
    assert list(keys) == [f"{number:064}" for number in range(3)]
    assert [record.json for record in read_records(content)] == [result.value[0] for result in results]
    assert (await pool.run([(close_chunk, ("another",))]))[0].value == []


async def test_requests_with_contradictory_values_are_named(pool: ProcessPool) -> None:
    short = PAPER | {"projectile": PAPER["projectile"] | {"length_m": 0.1}}
    requests = [canonical(CriticalAngleRequest.model_validate(each)) for each in (PAPER, short)]
    wrong = await pool.submit(check_requests, CriticalAngleRequest, requests)
    assert [(place, error.field) for place, error in wrong.items()] == [(1, "projectile.length")]


async def test_solver_error_from_a_worker_names_its_field(pool: ProcessPool) -> None:
    request = TrajectoryRequest.model_validate(PAPER_AT_45 | {"projectile": PAPER["projectile"] | {"length_m": 0.1}})
    with pytest.raises(ParameterError) as caught:
        await pool.submit(compute_single, compute_trajectory, "trajectory", "0" * 64, canonical(request))
    assert caught.value.field == "projectile.length"
    assert "compute_trajectory" in caught.value.__notes__[0]  # The note names the place in the worker.


def compilations() -> int:
    """Count the functions that numba compiles while this process answers a query."""
    with event.install_recorder("numba:compile") as recorder:
        compute_single(compute_trajectory, "trajectory", "0" * 64, canonical(CASE))
    return len(recorder.buffer)


async def test_first_query_of_a_worker_compiles_nothing(pool: ProcessPool) -> None:
    assert await pool.submit(compilations) == 0


def test_malformed_message_is_answered_without_ending_the_worker() -> None:
    finished = loads(answer(b"not a pickle"))
    assert finished.value is None
    assert isinstance(finished.error, pickle.UnpicklingError)


def test_malformed_reply_is_the_error_of_its_call() -> None:
    assert isinstance(loads(b"not a pickle").error, pickle.UnpicklingError)


async def test_split_messages_arrive_complete_and_in_order() -> None:
    ours, theirs = socket.socketpair()
    sent = [os.urandom(length) for length in (1, 7, 8, 100_000, 3_000_000, 5)]
    messages = Messages()
    transport, _ = await asyncio.get_running_loop().create_connection(lambda: messages, sock=ours)
    sender = threading.Thread(target=lambda: [send(theirs, message) for message in sent])  # type: ignore[func-returns-value]
    sender.start()
    assert [await messages.next() for _ in sent] == sent
    sender.join()
    theirs.sendall(b"half of a length"[:5])
    theirs.close()
    with pytest.raises(WorkerDiedError):
        await messages.next()
    transport.close()


def test_worker_receives_messages_until_the_connection_closes() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        send(ours, b"one")
        send(ours, b"two")
        ours.sendall(b"half of a length"[:5])
        ours.close()
        assert [receive(theirs) for _ in range(3)] == [b"one", b"two", b""]
