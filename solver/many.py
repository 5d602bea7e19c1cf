"""Many cases at a time, on several threads, and their answers as one table.

The compiled code releases the interpreter lock. A table has a row for each answer, in SI units and radians, under the
names of the solver.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import fields
from functools import partial
from itertools import repeat
from operator import attrgetter
from typing import Any, TypeAlias, TypeVar

import numpy as np

from solver.arrays import FloatArray
from solver.checks import ParameterError, RicochetError
from solver.display import Columns, dataframe
from solver.perforation import TOLERANCE, PerforationLimit, least_thickness, limit_velocity
from solver.projectile import Projectile
from solver.resistance import Resistance
from solver.search.critical_angle import critical_angle
from solver.search.types import CriticalAngle, Search
from solver.strike import Impact, Numerics
from solver.target import Target
from solver.trajectory import Motion, Trajectory, simulate

AHEAD = 64
"""Strikes for each thread that may be begun before the oldest is fetched: some take thirty times as long as most, and
nobody should wait behind them."""

Value = TypeVar("Value")
Answer = TypeVar("Answer")
OneOrMany: TypeAlias = Value | Sequence[Value] | FloatArray

FINAL = tuple(field.name for field in fields(Motion))
NO_BRACKET = (math.nan, math.nan)


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
    cases = Cases(
        projectile=projectile,
        target=target,
        velocity=velocity,
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
        resistance=resistance,
    )
    return _run(partial(critical_angle, numerics=numerics, search=search), cases, threads)


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
    strikes = Cases(projectile=projectile, target=target, impact=impact, resistance=resistance)
    return _run(partial(simulate, numerics=numerics, sample_interval=sample_interval), strikes, threads)


def least_thickness_many(
    *,
    projectile: OneOrMany[Projectile],
    target: OneOrMany[Target],
    impact: OneOrMany[Impact],
    resistance: OneOrMany[Resistance] | None = None,
    numerics: Numerics | None = None,
    tolerance: float = TOLERANCE,
    threads: int = 1,
) -> Iterator[PerforationLimit | RicochetError]:
    """Least thicknesses that stop many strikes.

    Parameters
    ----------
    projectile, target, impact, resistance
        As for `least_thickness`: one for all strikes, or a sequence with one for each.
    numerics, tolerance
        The same for all.
    threads
        How many strikes run at a time.

    Yields
    ------
    PerforationLimit or RicochetError
        In the order of the strikes; one that failed yields its error and stops nothing.

    Raises
    ------
    ParameterError
        If the sequences differ in length.
    """
    strikes = Cases(projectile=projectile, target=target, impact=impact, resistance=resistance)
    return _run(partial(least_thickness, numerics=numerics, tolerance=tolerance), strikes, threads)


def limit_velocity_many(
    *,
    projectile: OneOrMany[Projectile],
    target: OneOrMany[Target],
    oblique_angle: OneOrMany[float],
    angle_of_attack: OneOrMany[float] = 0.0,
    angular_velocity: OneOrMany[float] = 0.0,
    resistance: OneOrMany[Resistance] | None = None,
    numerics: Numerics | None = None,
    tolerance: float = TOLERANCE,
    threads: int = 1,
) -> Iterator[PerforationLimit | RicochetError]:
    """Least velocities that perforate many walls.

    Parameters
    ----------
    projectile, target, oblique_angle, angle_of_attack, angular_velocity, resistance
        As for `limit_velocity`: one for all walls, or a sequence or array with one for each.
    numerics, tolerance
        The same for all.
    threads
        How many walls run at a time.

    Yields
    ------
    PerforationLimit or RicochetError
        In the order of the walls; one that failed yields its error and stops nothing.

    Raises
    ------
    ParameterError
        If the sequences differ in length.
    """
    walls = Cases(
        projectile=projectile,
        target=target,
        oblique_angle=oblique_angle,
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
        resistance=resistance,
    )
    return _run(partial(limit_velocity, numerics=numerics, tolerance=tolerance), walls, threads)


class Cases:
    """Columns of arguments, some the same for all cases, as one set of arguments for each case."""

    def __init__(self, **columns: Any) -> None:
        many = {name: column for name, column in columns.items() if isinstance(column, Sequence | np.ndarray)}
        first = next(iter(many), None)
        length = 1 if first is None else len(many[first])
        for name, column in many.items():
            if len(column) != length:
                raise ParameterError(name, f"must be one or as many as {first}, {length}, got {len(column)}")
        self.columns = {name: many.get(name, repeat(column, length)) for name, column in columns.items()}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for values in zip(*self.columns.values(), strict=True):
            yield dict(zip(self.columns, map(_plain, values), strict=True))


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _run(function: Callable[..., Answer], cases: Cases, threads: int) -> Iterator[Answer | RicochetError]:
    """Answers in order; on threads, some ahead of the caller."""

    def answer(case: dict[str, Any]) -> Answer | RicochetError:
        try:
            return function(**case)
        except RicochetError as error:
            return error

    if threads == 1:
        yield from map(answer, cases)
        return
    waiting: deque[Future[Answer | RicochetError]] = deque()
    with ThreadPoolExecutor(threads) as pool, ExitStack() as on_leaving:
        on_leaving.callback(lambda: [future.cancel() for future in waiting])
        for case in cases:
            waiting.append(pool.submit(answer, case))
            if len(waiting) > AHEAD * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def columns(answers: Iterable[Trajectory | CriticalAngle | RicochetError]) -> Columns:
    """Return what `simulate_many` or `critical_angle_many` yields as columns, a row for each answer.

    Parameters
    ----------
    answers
        Answers from one of the two functions, not from both.

    Returns
    -------
    dict of str to array
        For trajectories ``outcome``, ``maximum_depth`` [m], ``strength_factor`` and ``final_time`` [s] to
        ``final_kinetic_energy`` [J]; for critical angles ``status``, ``angle``, ``standard_error``, ``bracket_low`` and
        ``bracket_high`` [rad], and ``strength_factor``. Then ``warnings``, their codes with blanks between them, and
        ``error``, empty unless the case failed. NaN and empty text stand where there is nothing.

    Raises
    ------
    ParameterError
        If there are answers of both kinds.
    """
    answers = list(answers)
    kinds = {type(answer) for answer in answers if not isinstance(answer, RicochetError)}
    if len(kinds) > 1:
        raise ParameterError("answers", "must be trajectories or critical angles, not both")
    table: Columns = {}
    for kind in kinds:
        for name, (value, missing) in COLUMNS[kind].items():
            table[name] = np.array(
                [missing if isinstance(answer, RicochetError) else value(answer) for answer in answers]
            )
    table["warnings"] = _texts([getattr(answer, "warnings", ()) for answer in answers])
    table["error"] = np.array([str(answer) if isinstance(answer, RicochetError) else "" for answer in answers], str)
    return table


def to_dataframe(answers: Iterable[Trajectory | CriticalAngle | RicochetError]) -> Any:
    """Return the same as a ``pandas.DataFrame``.

    Raises
    ------
    ModuleNotFoundError
        If pandas is not installed.
    """
    return dataframe(columns(answers))


def _texts(warnings: Sequence[Any]) -> Any:
    return np.array([" ".join(warning.code for warning in found) for found in warnings], str)


def _number(value: float | None) -> float:
    return math.nan if value is None else value


Column = tuple[Callable[[Any], Any], Any]
"""What stands in it, and what stands there if the case failed."""

COLUMNS: Mapping[type, Mapping[str, Column]] = {
    Trajectory: {
        "outcome": (attrgetter("outcome.value"), ""),
        "maximum_depth": (attrgetter("maximum_depth"), math.nan),
        "strength_factor": (attrgetter("strength_factor"), math.nan),
        **{f"final_{name}": (attrgetter(f"final.{name}"), math.nan) for name in FINAL},
    },
    CriticalAngle: {
        "status": (attrgetter("status.value"), ""),
        "angle": (lambda answer: _number(answer.angle), math.nan),
        "standard_error": (lambda answer: _number(answer.standard_error), math.nan),
        "bracket_low": (lambda answer: (answer.bracket or NO_BRACKET)[0], math.nan),
        "bracket_high": (lambda answer: (answer.bracket or NO_BRACKET)[1], math.nan),
        "strength_factor": (lambda answer: _number(answer.strength_factor), math.nan),
    },
}
