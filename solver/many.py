"""Computation of many cases, on several threads if requested, and their answers as one table.

Threads run in parallel, since the compiled code releases the interpreter lock. A table has a row for each answer, in SI
units and radians, and its column names are the solver's field names.
"""

import math
from collections import deque
from collections.abc import Callable, Container, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from itertools import islice, repeat
from typing import Any, Protocol, TypeAlias, TypeVar, overload

import numpy as np
import numpy.typing as npt

from solver.cancellation import ComputingThreads
from solver.checks import ParameterError, RicochetError, plain
from solver.display import Columns, DataFrame, Row, dataframe
from solver.perforation import TOLERANCE, PerforationLimit, least_thickness, limit_velocity
from solver.projectile import Projectile
from solver.resistance import Resistance
from solver.search.critical_angle import critical_angle
from solver.search.types import CriticalAngle, Search
from solver.strength_scatter import ScatterSource
from solver.strike import Impact, Numerics, is_part, label, named_values, short_names
from solver.target import Target
from solver.trajectory import Trajectory, simulate

# Some strikes take thirty times as long as most, and other threads should not wait for them. With 64 cases ahead, two
# threads were 1.91 to 1.95 times as fast as one; with 8 cases, 1.77 times.
AHEAD = 64
"""Largest number of cases per thread that are computed ahead of the answer that the caller waits for."""

Value = TypeVar("Value")
Answer = TypeVar("Answer")


class ArrayLike(Protocol):
    """Object that converts to an array, such as a pandas Series or an xarray DataArray."""

    def __array__(self) -> npt.NDArray[Any]:
        """Return the values as an array."""


OneOrMany: TypeAlias = Value | Sequence[Value] | ArrayLike
"""One value for all cases, or a value for each."""

ANSWERS = (Trajectory, CriticalAngle, PerforationLimit)
"""Classes of answers, whose fields describe the columns of tables."""
INPUTS = (Impact, Target, Projectile, Resistance, Numerics)
"""Classes of inputs, whose fields describe the columns of inputs in tables."""


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
    strength_scatter: ScatterSource = "law",
    threads: int = 1,
) -> Sequence[CriticalAngle | RicochetError]:
    """Find the critical angles of many cases.

    Parameters
    ----------
    projectile, target, velocity, angle_of_attack, angular_velocity, resistance
        As for `critical_angle`: one for all cases, or a sequence, array, Series or DataArray with one for each.
    numerics, search, strength_scatter
        As for `critical_angle`, the same for all cases.
    threads
        Number of cases computed in parallel.

    Returns
    -------
    sequence of CriticalAngle or RicochetError
        Answers in the order of the cases. An answer is computed when it is first accessed and then kept. Several
        threads also compute the next cases in advance. A case that failed has its error in place of an answer.

    Raises
    ------
    ParameterError
        If the sequences differ in length.
    """
    return Answers(
        partial(critical_angle, numerics=numerics, search=search, strength_scatter=strength_scatter),
        threads,
        projectile=projectile,
        target=target,
        velocity=velocity,
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
        resistance=resistance,
    )


def simulate_many(
    *,
    projectile: OneOrMany[Projectile],
    target: OneOrMany[Target],
    impact: OneOrMany[Impact],
    resistance: OneOrMany[Resistance] | None = None,
    numerics: Numerics | None = None,
    sample_interval: float | None = None,
    strength_scatter: ScatterSource = "law",
    threads: int = 1,
) -> Sequence[Trajectory | RicochetError]:
    """Compute the trajectories of many strikes.

    Parameters
    ----------
    projectile, target, impact, resistance
        As for `simulate`: one for all strikes, or a sequence with one for each.
    numerics, sample_interval, strength_scatter
        As for `simulate`, the same for all strikes; there are no histories unless an interval [s] is given.
    threads
        Number of strikes computed in parallel.

    Returns
    -------
    sequence of Trajectory or RicochetError
        Answers in the order of the strikes, as for `critical_angle_many`.

    Raises
    ------
    ParameterError
        If the sequences differ in length.
    """
    run = partial(simulate, numerics=numerics, sample_interval=sample_interval, strength_scatter=strength_scatter)
    return Answers(run, threads, projectile=projectile, target=target, impact=impact, resistance=resistance)


def least_thickness_many(
    *,
    projectile: OneOrMany[Projectile],
    target: OneOrMany[Target],
    impact: OneOrMany[Impact] | None = None,
    velocity: OneOrMany[float] | None = None,
    oblique_angle: OneOrMany[float] | None = None,
    angle_of_attack: OneOrMany[float] = 0.0,
    angular_velocity: OneOrMany[float] = 0.0,
    resistance: OneOrMany[Resistance] | None = None,
    numerics: Numerics | None = None,
    tolerance: float = TOLERANCE,
    threads: int = 1,
) -> Sequence[PerforationLimit | RicochetError]:
    """Find, for each of many strikes, the least thickness of a wall that it does not perforate.

    Parameters
    ----------
    projectile, target, impact, velocity, oblique_angle, angle_of_attack, angular_velocity, resistance
        As for `least_thickness`: one for all strikes, or a sequence, array, Series or DataArray with one for each.
    numerics, tolerance
        As for `least_thickness`, the same for all strikes.
    threads
        Number of strikes computed in parallel.

    Returns
    -------
    sequence of PerforationLimit or RicochetError
        Answers in the order of the strikes, as for `critical_angle_many`.

    Raises
    ------
    ParameterError
        If the sequences differ in length.
    """
    return Answers(
        partial(least_thickness, numerics=numerics, tolerance=tolerance),
        threads,
        projectile=projectile,
        target=target,
        impact=impact,
        velocity=velocity,
        oblique_angle=oblique_angle,
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
        resistance=resistance,
    )


def limit_velocity_many(
    *,
    projectile: OneOrMany[Projectile],
    target: OneOrMany[Target],
    impact: OneOrMany[Impact] | None = None,
    oblique_angle: OneOrMany[float] | None = None,
    angle_of_attack: OneOrMany[float] = 0.0,
    angular_velocity: OneOrMany[float] = 0.0,
    resistance: OneOrMany[Resistance] | None = None,
    numerics: Numerics | None = None,
    tolerance: float = TOLERANCE,
    threads: int = 1,
) -> Sequence[PerforationLimit | RicochetError]:
    """Find, for each of many walls, the least velocity that perforates it.

    Parameters
    ----------
    projectile, target, impact, oblique_angle, angle_of_attack, angular_velocity, resistance
        As for `limit_velocity`: one for all walls, or a sequence, array, Series or DataArray with one for each.
    numerics, tolerance
        As for `limit_velocity`, the same for all walls.
    threads
        Number of walls computed in parallel.

    Returns
    -------
    sequence of PerforationLimit or RicochetError
        Answers in the order of the walls, as for `critical_angle_many`.

    Raises
    ------
    ParameterError
        If the sequences differ in length.
    """
    return Answers(
        partial(limit_velocity, numerics=numerics, tolerance=tolerance),
        threads,
        projectile=projectile,
        target=target,
        impact=impact,
        oblique_angle=oblique_angle,
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
        resistance=resistance,
    )


class Answers(Sequence[Answer | RicochetError]):
    """Lazy sequence of answers to cases, which are computed in order at the first access and then kept.

    Parameters
    ----------
    function
        Function that computes the answer to one case.
    threads
        Number of cases computed in parallel.
    **columns
        Arguments of the function: one value for all cases, or a sequence with one value for each.
    """

    def __init__(self, function: Callable[..., Answer], threads: int, **columns: Any) -> None:
        self._columns = {name: plain(column) for name, column in columns.items()}
        self._many = {
            name: column
            for name, column in self._columns.items()
            if isinstance(column, Sequence) and not isinstance(column, str)
        }
        first = next(iter(self._many), None)
        self._length = 1 if first is None else len(self._many[first])
        for name, column in self._many.items():
            if len(column) != self._length:
                raise ParameterError(name, f"must be one or as many as {first}, {self._length}, got {len(column)}")
        self._function, self._threads = function, threads
        self._kept: list[Answer | RicochetError] = []
        self._pending = self._begin()

    def _begin(self) -> Generator[Answer | RicochetError, None, None]:
        """Yield the answers that have not been kept yet."""
        return _run(self._function, islice(self._cases(), len(self._kept), None), self._threads)

    def _cases(self) -> Iterator[dict[str, Any]]:
        columns = [self._many.get(name, repeat(column, self._length)) for name, column in self._columns.items()]
        for values in zip(*columns, strict=True):
            yield dict(zip(self._columns, map(plain, values), strict=True))

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, index: int) -> Answer | RicochetError: ...

    @overload
    def __getitem__(self, index: slice) -> list[Answer | RicochetError]: ...

    def __getitem__(self, index: int | slice) -> Answer | RicochetError | list[Answer | RicochetError]:
        if isinstance(index, slice):
            return [self[place] for place in range(self._length)[index]]
        place = range(self._length)[index]
        while len(self._kept) <= place:
            try:
                self._kept.append(next(self._pending))
            except BaseException:  # such as Ctrl-C, which ends the generator; the next access starts a new one
                self._pending = self._begin()
                raise
        return self._kept[place]

    def __repr__(self) -> str:
        return f"<{self._length} answers, {len(self._kept)} of them computed>"

    def close(self) -> None:
        """Cancel the cases that were started but whose answers have not been accessed."""
        self._pending.close()
        self._pending = self._begin()

    def inputs(self, taken: Container[str]) -> Columns:
        """Return columns of the inputs given as sequences, and of their fields, with names that are not in `taken`."""
        rows = [dict(named_values({name: case[name] for name in self._many})) for case in self._cases()]
        # The fields of an object become columns. The object itself does so only if it has a name. Inputs that are None
        # in every case are left out.
        names = {
            name: None
            for row in rows
            for name, value in row.items()
            if value is not None and (not is_part(value) or hasattr(value, "name"))
        }
        short = short_names(list(names), taken)
        return {found: _column([row.get(name) for row in rows]) for found, name in zip(short, names, strict=True)}


def _column(values: Sequence[Any]) -> npt.NDArray[Any]:
    """Convert values to an array: of numbers, with NaN for None, or else of strings, empty for None."""
    if all(value is None or isinstance(value, float | int) for value in values):
        return np.array([math.nan if value is None else value for value in values])
    return np.array(["" if value is None else str(label(value)) for value in values])


def attempt(function: Callable[..., Answer], case: Mapping[str, Any]) -> Answer | RicochetError:
    """Call a function with a case; return the answer or the `RicochetError` raised."""
    try:
        return function(**case)
    except RicochetError as error:
        return error


def _run(
    function: Callable[..., Answer], cases: Iterable[dict[str, Any]], threads: int
) -> Generator[Answer | RicochetError, None, None]:
    """Yield the answers to cases in order; several threads compute up to `AHEAD` cases per thread in advance."""
    if threads == 1:
        yield from (attempt(function, case) for case in cases)
        return
    waiting: deque[Future[Answer | RicochetError]] = deque()
    with ComputingThreads(threads) as pool:
        for case in cases:
            waiting.append(pool.submit(attempt, function, case))
            if len(waiting) > AHEAD * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


class Tabular(Protocol):
    """Interface of answers that have a table of their own."""

    def to_dataframe(self) -> DataFrame:
        """Return the table as a ``pandas.DataFrame``."""


class Labelled(Protocol):
    """Interface of answers computed with a choice of laws, such as `Alternative`."""

    @property
    def answer(self) -> Any:
        """Answer to the case, or its error."""

    def laws(self) -> Row:
        """Return the names of the laws, as columns of a table."""


def columns(answers: Iterable[Trajectory | CriticalAngle | PerforationLimit | RicochetError | Labelled]) -> Columns:
    """Return a table of the answers to many cases, as arrays by name with a row for each answer.

    Parameters
    ----------
    answers
        Answers from one of the functions for many cases, or from `solver.alternatives`; all must be of one kind.

    Returns
    -------
    dict of str to array
        The first columns are the inputs that were given as sequences, if `answers` is the object that the function
        returned and not a list; for alternatives they are the laws. Then follow, for trajectories, ``outcome``,
        ``maximum_depth``, ``protrusion_final`` and ``protrusion_greatest`` [m], ``bending_peak_stress`` [Pa],
        ``strength_factor`` and ``final_time`` [s] to ``final_kinetic_energy`` [J]; for critical angles ``status``,
        ``angle``, ``standard_error``, ``bracket_low`` and ``bracket_high`` [rad], and ``strength_factor``; for limits
        of perforation ``status``, ``value``, ``value_low``, ``value_high`` and ``without_protrusion`` [m or m/s]. The
        last columns are ``warnings``, the codes separated by spaces, and ``error``, empty unless the case failed.
        Missing values are NaN or empty strings.

    Raises
    ------
    ParameterError
        If `answers` is not a sequence, or has answers of different kinds or of a kind without a table row.
    """
    if not isinstance(answers, Iterable):
        raise ParameterError("answers", f"must be a sequence of answers, got {type(answers).__name__}")
    given = list(answers)
    found: list[Any] = [getattr(each, "answer", each) for each in given]
    kinds = {type(answer) for answer in found if not isinstance(answer, RicochetError)}
    if unknown := sorted(kind.__name__ for kind in kinds if not hasattr(kind, "row")):
        raise ParameterError("answers", f"must have trajectories, critical angles or limits, got {unknown[0]}")
    if len(kinds) > 1:
        raise ParameterError("answers", "must be of one kind, trajectories, critical angles or limits of perforation")
    rows: list[Row] = [{} if isinstance(answer, RicochetError) else answer.row() for answer in found]
    names = next(filter(None, rows), {})
    laws = [each.laws() for each in given if hasattr(each, "laws")]
    table: Columns = {name: _column([row[name] for row in laws]) for name in next(iter(laws), {})}
    table |= {name: _column([row.get(name) for row in rows]) for name in names}
    table["warnings"] = _texts([getattr(answer, "warnings", ()) for answer in found])
    table["error"] = np.array([str(answer) if isinstance(answer, RicochetError) else "" for answer in found], str)
    return answers.inputs(table) | table if isinstance(answers, Answers) else table


def to_dataframe(
    answers: Iterable[Trajectory | CriticalAngle | PerforationLimit | RicochetError | Labelled] | Tabular,
) -> DataFrame:
    """Return the table of `columns` as a ``pandas.DataFrame``, with units in its `attrs`.

    An object with a table of its own, such as a trajectory or a fit, gives that table.

    Raises
    ------
    ModuleNotFoundError
        If pandas is not installed.
    """
    if hasattr(answers, "to_dataframe"):
        return answers.to_dataframe()
    return dataframe(columns(answers), *ANSWERS, *INPUTS)


def _texts(warnings: Sequence[Any]) -> Any:
    return np.array([" ".join(warning.code for warning in found) for found in warnings], str)
