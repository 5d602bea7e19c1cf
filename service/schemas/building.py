"""From what the solver returns to answers."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

import solver
from service.columns import UNITS
from service.schemas.answers import Exit, MotionState
from service.schemas.quantities import Part, degrees
from solver.arrays import FloatArray

Columns = dict[str, FloatArray]


def _names(model: type[Part]) -> dict[str, str]:
    """Return the names of a model's fields in the solver, which end without a unit, and in the contract."""
    ends = {name: next((end for end in UNITS if name.endswith(end)), "") for name in model.model_fields}
    return {name.removesuffix(end): name for name, end in ends.items()}


NAMES = _names(MotionState)
"""The quantities of a motion in the solver and in the contract."""


EXIT_NAMES = _names(Exit)
"""The quantities of an exit in the solver and in the contract."""


def exit_answer(left: solver.Exit | None) -> dict[str, Any]:
    """Return the exit of a run as a field of an answer; nothing if the projectile stayed."""
    if left is None:
        return {}
    values = {to: (degrees if to.endswith("_deg") else float)(getattr(left, own)) for own, to in EXIT_NAMES.items()}
    return {"exit": values}


def exit_in(answer: Mapping[str, float]) -> solver.Exit:
    """Return the exit of an answer."""
    return solver.Exit(
        **{
            own: math.radians(answer[name]) if name.endswith("_deg") else answer[name]
            for own, name in EXIT_NAMES.items()
        }
    )


def strength_answer(found: solver.Trajectory | solver.CriticalAngle) -> dict[str, Any]:
    """Return how sure the strength factor is, and what shots into the very concrete changed."""
    answer: dict[str, Any] = {"strength_factor_dispersion": found.strength_factor_dispersion}
    if (tests := found.own_tests) is not None:
        numbers = {name: getattr(tests, name) for name in ("median", "dispersion", "prior_median", "prior_dispersion")}
        answer["own_tests"] = {"shots": len(tests.factors)} | numbers
    return answer


def trajectory_answer(trajectory: solver.Trajectory) -> tuple[dict[str, Any], Columns | None]:
    """Answer without its history, and the columns of the history if there is one."""
    final = {NAMES[field.name]: getattr(trajectory.final, field.name) for field in fields(trajectory.final)}
    answer = {
        "outcome": trajectory.outcome.value,
        "final": final | {"axis_angle_deg": degrees(trajectory.final.axis_angle)},
        **exit_answer(trajectory.exit),
        "maximum_depth_m": trajectory.maximum_depth,
        "strength_factor": trajectory.strength_factor,
        **strength_answer(trajectory),
        "warnings": warning_texts(trajectory.warnings),
    }
    return answer, None if trajectory.history is None else _columns(trajectory.history)


def critical_angle_answer(
    found: solver.CriticalAngle, trajectory: solver.Trajectory | None
) -> tuple[dict[str, Any], Columns | None]:
    """Answer without the history of its trajectory, and the columns of that if there is one."""
    answer: dict[str, Any] = {"status": found.status.value}
    if found.angle is not None:
        answer["critical_angle_deg"] = degrees(found.angle)
    if found.standard_error is not None:
        answer["critical_angle_standard_error_deg"] = degrees(found.standard_error)
    if found.bracket is not None:
        answer["bracket_deg"] = [degrees(angle) for angle in found.bracket]
    if found.strength_factor is not None:
        answer |= {"strength_factor": found.strength_factor, **strength_answer(found)}
    if found.energy_fraction_below is not None and found.energy_fraction_above is not None:
        answer["energy_fraction_below"] = found.energy_fraction_below
        answer["energy_fraction_above"] = found.energy_fraction_above
    answer |= exit_answer(found.exit)
    answer["iterations"] = [
        {
            "oblique_angle_deg": degrees(trial.oblique_angle),
            "final_position_m": trial.final_position,
            "outcome": trial.outcome.value,
            "fine": trial.fine,
            **exit_answer(trial.exit if trial.fine else None),
        }
        for trial in found.iterations
    ]
    answer["other_crossings_deg"] = [degrees(angle) for angle in found.other_crossings]
    if found.outcomes:
        answer["outcomes"] = [
            {
                "outcome": interval.outcome.value,
                "lower_deg": degrees(interval.lower),
                "upper_deg": degrees(interval.upper),
            }
            for interval in found.outcomes
        ]
    history = None
    if trajectory is not None:
        answer["trajectory"], history = trajectory_answer(trajectory)
    return answer | {"warnings": warning_texts(found.warnings)}, history


def _columns(history: solver.Motion[FloatArray]) -> Columns:
    columns = {NAMES[field.name]: getattr(history, field.name) for field in fields(history)}
    return columns | {"axis_angle_deg": np.degrees(history.axis_angle)}


def warning_texts(warnings: tuple[solver.ModelWarning, ...]) -> list[dict[str, str]]:
    """Return warnings as the contract has them."""
    return [{"code": warning.code, "detail": warning.detail} for warning in warnings]
