"""Signals during a computation: whatever a handler raises comes out of the call, and the process lives on."""

import subprocess
import sys

import pytest
from numba import types

import solver
from solver import compilation

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
"""Signals to each loop. A tenth of them used to end the process."""


def survives(script: str, *arguments: str) -> None:
    """Run a script to its end, in another process: a crash would end that of the tests."""
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False, timeout=TIMEOUT_S
    )
    assert done.stdout.split() == ["survived"], (done.returncode, done.stderr[-2000:])


@pytest.mark.parametrize("signal_name", ["SIGINT", "SIGALRM"])
@pytest.mark.parametrize("call", CALLS)
def test_exception_of_a_signal_handler_comes_out_of_the_call(call: str, signal_name: str) -> None:
    survives(LOOP.replace("CALL", CALLS[call]).replace("ROUNDS", str(ROUNDS)), signal_name)


def test_compiled_code_hands_only_numbers_and_plain_tuples_of_them_to_python() -> None:
    """To make anything else, numba runs Python code, and goes on as if no signal handler could raise in there."""
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
