"""Many strikes at a time, on several threads: the compiled code releases the interpreter lock."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from itertools import islice, repeat
from typing import Any, TypeAlias, TypeVar

import numpy as np

from solver.arrays import FloatArray
from solver.errors import ParameterError, RicochetError
from solver.impact import Impact
from solver.numerics import Numerics
from solver.projectile import Projectile
from solver.resistance import Resistance
from solver.ricochet import critical_angle
from solver.search import CriticalAngle, Search
from solver.target import Target
from solver.trajectory import Trajectory, simulate

CHUNK = 16
"""Strikes that a thread takes at a time."""
AHEAD = 4
"""Chunks for each thread that may wait to be fetched."""

Value = TypeVar("Value")
Answer = TypeVar("Answer")
OneOrMany: TypeAlias = Value | Sequence[Value] | FloatArray


def critical_angle_many(
    *,
    projectile: OneOrMany[Projectile],
    target: OneOrMany[Target],
    velocity: OneOrMany[float],
    angle_of_attack: OneOrMany[float] = 0.0,
    angular_velocity: OneOrMany[float] = 0.0,
    resistance: OneOrMany[Resistance] | None = None,
    numerics: Numerics | None = None,
    search: Search | None = None,
    threads: int = 1,
) -> Iterator[CriticalAngle | RicochetError]:
    """Critical angles of many cases.

    Parameters
    ----------
    projectile, target, velocity, angle_of_attack, angular_velocity, resistance
        As for `critical_angle`: one for all cases, or a sequence or array with one for each.
    numerics, search
        The same for all.
    threads
        How many cases run at a time.

    Yields
    ------
    CriticalAngle or RicochetError
        In the order of the cases, while later ones still run; a case that failed yields its error and stops nothing.

    Raises
    ------
    ParameterError
        If the sequences differ in length.
    """
    cases = _cases(
        projectile=projectile,
        target=target,
        velocity=velocity,
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
        resistance=Resistance() if resistance is None else resistance,
    )
    return _run(lambda case: critical_angle(**case, numerics=numerics, search=search), cases, threads)


def simulate_many(
    *,
    projectile: OneOrMany[Projectile],
    target: OneOrMany[Target],
    impact: OneOrMany[Impact],
    resistance: OneOrMany[Resistance] | None = None,
    numerics: Numerics | None = None,
    sample_interval: float | None = None,
    threads: int = 1,
) -> Iterator[Trajectory | RicochetError]:
    """Trajectories of many strikes.

    Parameters
    ----------
    projectile, target, impact, resistance
        As for `simulate`: one for all strikes, or a sequence with one for each.
    numerics, sample_interval
        The same for all; no histories unless an interval is given. [s]
    threads
        How many strikes run at a time.

    Yields
    ------
    Trajectory or RicochetError
        In the order of the strikes; one that failed yields its error and stops nothing.

    Raises
    ------
    ParameterError
        If the sequences differ in length.
    """
    strikes = _cases(
        projectile=projectile,
        target=target,
        impact=impact,
        resistance=Resistance() if resistance is None else resistance,
    )
    return _run(lambda strike: simulate(**strike, numerics=numerics, sample_interval=sample_interval), strikes, threads)


def _cases(**columns: Any) -> Iterator[dict[str, Any]]:
    """One set of arguments for each case."""
    many = {name: column for name, column in columns.items() if isinstance(column, Sequence | np.ndarray)}
    lengths = {name: len(column) for name, column in many.items()}
    for name, length in lengths.items():
        first = next(iter(lengths))
        if length != lengths[first]:
            raise ParameterError(name, f"must be one or as many as {first}, {lengths[first]}, got {length}")
    count = next(iter(lengths.values()), 1)
    spread = [many[name] if name in many else repeat(column, count) for name, column in columns.items()]
    return (dict(zip(columns, map(_plain, values), strict=True)) for values in zip(*spread, strict=True))


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _run(
    function: Callable[[dict[str, Any]], Answer], cases: Iterable[dict[str, Any]], threads: int
) -> Iterator[Answer | RicochetError]:
    """Answers in order; on threads, a few chunks ahead of whoever fetches them."""

    def answer(case: dict[str, Any]) -> Answer | RicochetError:
        try:
            return function(case)
        except RicochetError as error:
            return error

    if threads == 1:
        yield from map(answer, cases)
        return
    waiting: deque[Future[list[Answer | RicochetError]]] = deque()
    remaining = iter(cases)
    with ThreadPoolExecutor(threads) as pool, ExitStack() as on_leaving:
        on_leaving.callback(lambda: [future.cancel() for future in waiting])
        while chunk := list(islice(remaining, CHUNK)):
            waiting.append(pool.submit(lambda part: [answer(case) for case in part], chunk))
            if len(waiting) > AHEAD * threads:
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()
