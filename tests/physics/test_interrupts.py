"""Signals during a computation: the call raises the exception of the signal handler, and the process continues."""

import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from numba import types

import solver
from solver import Cancellation, CancelledError, Numerics, compilation
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

TIMEOUT_S = 300.0
CALLS = {
    "critical_angle": "critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY)",
    "simulate": "simulate(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=IMPACT, sample_interval=1e-4)",
    "least_thickness": "least_thickness(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=IMPACT)",
}
LOOP = """
import os, random, signal, sys, threading, time
from solver import critical_angle, least_thickness, simulate, warm_up
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

class Ended(Exception):
    pass

def end(number, frame):
    raise Ended

random.seed(1)
warm_up()
IMPACT = paper_impact(oblique_angle_degrees=45.0)
expected = KeyboardInterrupt if sys.argv[1] == "SIGINT" else Ended
if expected is Ended:
    signal.signal(signal.SIGALRM, end)
for _ in range(ROUNDS):
    number = getattr(signal, sys.argv[1])
    timer = threading.Timer(random.uniform(0.0, 0.02), os.kill, (os.getpid(), number))
    try:
        timer.start()
        while True:
            CALL
    except expected:
        timer.join()
print("survived")
"""
ROUNDS = 40
"""Number of signals sent to each loop. A tenth of them used to crash the process, so 40 are enough."""


def survives(script: str, *arguments: str) -> None:
    """Run a script in another process, because a crash would end the tests too, and check that it reaches its end."""
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False, timeout=TIMEOUT_S
    )
    assert (done.returncode, done.stdout.split()) == (0, ["survived"]), done.stderr[-2000:]


@pytest.mark.parametrize("signal_name", ["SIGINT", "SIGALRM"])
@pytest.mark.parametrize("call", CALLS)
def test_exception_of_a_signal_handler_is_raised_by_the_call(call: str, signal_name: str) -> None:
    survives(LOOP.replace("CALL", CALLS[call]).replace("ROUNDS", str(ROUNDS)), signal_name)


IN_CALLBACK = """
import os, signal, sys
from solver import critical_angle
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY

class Ended(Exception):
    pass

def end(number, frame):
    raise Ended

def signal_in_callback(frame, event, argument):
    if event == "call" and "llvmlite" in frame.f_code.co_filename and "object_cache" in frame.f_code.co_name:
        sys.setprofile(None)
        os.kill(os.getpid(), getattr(signal, sys.argv[1]))

signal.signal(signal.SIGALRM, end)
sys.setprofile(signal_in_callback)
try:
    critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY)
except KeyboardInterrupt if sys.argv[1] == "SIGINT" else Ended:
    assert critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY).angle
    print("survived")
"""


@pytest.mark.parametrize("signal_name", ["SIGINT", "SIGALRM"])
def test_exception_of_a_signal_handler_is_raised_while_code_is_loaded(signal_name: str) -> None:
    survives(IN_CALLBACK, signal_name)


WHILE_FREEING = """
import os, signal, sys
from solver import least_thickness, warm_up
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact

freed = 0

def interrupt(frame, event, argument):
    global freed
    names = frame.f_code.co_name, frame.f_back and frame.f_back.f_code.co_name
    if event == "return" and names == ("__call__", "close") and "llvmlite" in frame.f_code.co_filename:
        freed += 1
        os.kill(os.getpid(), signal.SIGINT)

warm_up()
sys.setprofile(interrupt)
try:
    least_thickness(
        projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=paper_impact(oblique_angle_degrees=45.0)
    )
except KeyboardInterrupt:
    sys.setprofile(None)
    if freed:
        print("survived")
"""
"""Script that is interrupted where llvmlite frees memory. It loads the functions that `warm_up` does not call."""


def test_interrupt_while_functions_are_loaded_does_not_free_memory_twice() -> None:
    survives(WHILE_FREEING)


LONG = """
import os, signal, sys, threading, time
from dataclasses import replace
from solver import (
    Impact, Numerics, Search, critical_angle, critical_angle_many, least_thickness, simulate, simulate_many, warm_up,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

PANELS = Numerics(method="panels", panels=90_000, time_step=1e-7, termination_time=0.019)
STRIKE = dict(projectile=PAPER_PROJECTILE, target=PAPER_TARGET)
IMPACT = paper_impact(oblique_angle_degrees=45.0)
warm_up()
timer = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
timer.start()
begin = time.monotonic()
try:
    CALL
except KeyboardInterrupt:
    assert time.monotonic() - begin < TIMEOUT
    print("survived")
"""
LONG_CALLS = {
    "simulate": "simulate(**STRIKE, impact=IMPACT, numerics=PANELS)",
    "critical_angle": "critical_angle(**STRIKE, velocity=PAPER_VELOCITY, numerics=PANELS)",
    "secant": "critical_angle(**STRIKE, velocity=PAPER_VELOCITY, numerics=PANELS, search=Search(method='secant'))",
    "least_thickness": "least_thickness(**STRIKE, impact=IMPACT, numerics=PANELS)",
    "many": "list(critical_angle_many(**STRIKE, velocity=4 * [PAPER_VELOCITY], numerics=PANELS, threads=2))",
    "simulate_many": "list(simulate_many(**STRIKE, impact=4 * [IMPACT], numerics=PANELS))",
    "adaptive": "list(simulate_many(**STRIKE, impact=1000 * [IMPACT], numerics=Numerics(relative_tolerance=1e-10)))",
}
"""Calls that would take many minutes."""


@pytest.mark.parametrize("call", LONG_CALLS)
def test_long_computation_ends_soon_after_an_interrupt(call: str) -> None:
    """The whole process ends, which shows that no thread continues to compute."""
    survives(LONG.replace("CALL", LONG_CALLS[call]).replace("TIMEOUT", "60.0"))


LONG_NUMERICS = Numerics(method="panels", panels=90_000, time_step=1e-7, termination_time=0.019)


def long_trajectory() -> Any:
    return solver.simulate(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=paper_impact(oblique_angle_degrees=45.0),
        numerics=LONG_NUMERICS,
    )


def test_computation_in_any_thread_can_be_cancelled_from_another() -> None:
    cancellation, begun = Cancellation(), threading.Event()

    def computation() -> Any:
        begun.set()
        return long_trajectory()

    with ThreadPoolExecutor(1) as thread:
        future = thread.submit(cancellation.run, computation)
        assert begun.wait(TIMEOUT_S)
        time.sleep(0.2)
        assert not future.done()
        cancellation.cancel()
        assert isinstance(future.exception(TIMEOUT_S), CancelledError)


def test_computation_in_the_main_thread_can_be_cancelled_from_another() -> None:
    cancellation = Cancellation()
    timer = threading.Timer(0.2, cancellation.cancel)
    timer.start()
    with pytest.raises(CancelledError):
        cancellation.run(long_trajectory)


def test_cancelled_computation_does_not_start() -> None:
    cancellation = Cancellation()
    cancellation.cancel()
    with pytest.raises(CancelledError):
        cancellation.run(long_trajectory)


def test_threads_of_a_computation_are_cancelled_with_it() -> None:
    cancellation = Cancellation()
    timer = threading.Timer(0.2, cancellation.cancel)
    timer.start()
    with pytest.raises(CancelledError):
        cancellation.run(
            lambda: list(
                solver.critical_angle_many(
                    projectile=PAPER_PROJECTILE,
                    target=PAPER_TARGET,
                    velocity=4 * [PAPER_VELOCITY],
                    numerics=LONG_NUMERICS,
                    threads=2,
                )
            )
        )


def test_computation_repeated_in_another_thread_gives_the_same_result() -> None:
    """A search of a few seconds that begins in the main thread is repeated in another one; elsewhere it runs once."""
    arguments: dict[str, Any] = {
        "projectile": PAPER_PROJECTILE,
        "target": PAPER_TARGET,
        "velocity": PAPER_VELOCITY,
        "numerics": Numerics(method="panels", panels=1000),
    }
    with ThreadPoolExecutor(1) as thread:
        assert solver.critical_angle(**arguments) == thread.submit(solver.critical_angle, **arguments).result()


def test_compiled_entry_points_return_only_numbers_and_plain_tuples() -> None:
    """To return other objects, numba runs Python code, where an exception from a signal handler causes a crash."""
    solver.warm_up()
    entry_points = [function.dispatcher for function in compilation.FUNCTIONS if function.is_entry_point]
    assert entry_points
    for dispatcher in entry_points:
        for signature in dispatcher.nopython_signatures:
            assert is_plain(signature.return_type), (dispatcher, signature)


def is_plain(returned: types.Type) -> bool:
    if isinstance(returned, types.BaseNamedTuple):
        return False
    if isinstance(returned, types.Tuple | types.UniTuple):
        return all(is_plain(item) for item in returned.types)
    return isinstance(returned, types.Float | types.Integer | types.Boolean | types.NoneType)
