"""Many answers as one table: a row each, in SI units and radians, under the names of the solver."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from operator import attrgetter
from typing import Any

import numpy as np

from solver.display import Columns, dataframe
from solver.search.types import CriticalAngle
from solver.trajectory import Motion, Trajectory
from solver.validation import ParameterError, RicochetError

FINAL = tuple(field.name for field in fields(Motion))
NO_BRACKET = (math.nan, math.nan)


def columns(answers: Iterable[Trajectory | CriticalAngle | RicochetError]) -> Columns:
    """Return what `simulate_many` or `critical_angle_many` yields as columns, a row for each answer.

    Parameters
    ----------
    answers
        Of one of the two, not of both.

    Returns
    -------
    dict of str to array
        Of trajectories ``outcome``, ``maximum_depth`` [m], ``strength_factor`` and ``final_time`` [s] to
        ``final_kinetic_energy`` [J]; of critical angles ``status``, ``angle``, ``standard_error``, ``bracket_low`` and
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
