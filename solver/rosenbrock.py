"""One step of GRK4T, a Rosenbrock pair of order 4 (3) for stiff equations, for motion under resistance, compiled.

A shank at rest sideways in its hole makes the equations stiff; this pair walks over that in steps of the motion's
own size. Coefficients: Kaps and Rentrop, Numerische Mathematik 33 (1979) 55-68, in the form of Hairer and Wanner,
Solving Ordinary Differential Equations II (1996), IV.7. The state is (position, velocity) with equal positions and
velocities in number, so each stage needs one 3 × 3 solve.
"""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled, lean
from solver.motion import Model, Work, accelerate

STAGES = 4
GAMMA = 0.231

STAGE_WEIGHTS = np.array(
    [
        [0.0, 0.0],
        [2.0, 0.0],
        [4.524708207373116, 4.163528788597648],
    ]
)
"""The last stage is at the state of the one before, and needs no evaluation of its own."""
COUPLINGS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [-5.071675338776316, 0.0, 0.0, 0.0],
        [6.020152728650786, 0.1597506846727117, 0.0, 0.0],
        [-1.856343618686113, -8.505380858179826, -2.084075136023187, 0.0],
        [8.567684694187544, -4.513188113271111, -4.443119282433976, -5.224572232181423],
    ]
)
"""The last row is our own. No stage looks beyond 0.88 of a step, so what happens there is seen from its end only: with
the change of the rates from start to end, which it is solved for, the other stages cancel to order 3."""
WEIGHTS = np.array([3.957503746640777, 4.624892388363313, 0.6174772638750108, 1.282612945269037])
ERROR_WEIGHTS = np.array([2.302155402932996, 3.073634485392623, -0.8732808018045032, -1.282612945269037])
"""Of the difference of the pair."""
EVALUATIONS = 2
"""For one attempt of a step, without its end."""
DIFFERENCE = 1e-7
"""Step of the difference quotients in position, over the distance from centre of gravity to tip."""
VELOCITY_DIFFERENCE = 1e-3
"""That in velocity, over the ramp velocity: below it the static stress is smooth."""
DIFFERENCES = 5
"""Evaluations for one linearisation."""


class Linearisation(NamedTuple):
    """Derivatives of the accelerations by position and velocity, and the inverse that the stages share; all (3, 3)."""

    stiffness: FloatArray
    damping: FloatArray
    inverse: FloatArray


@compiled
def make_linearisation() -> Linearisation:
    """Empty room."""
    return Linearisation(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))


@lean
def linearise(state: FloatArray, model: Model, work: Work, linear: Linearisation) -> None:
    """Difference quotients of the accelerations, each away from zero. Nothing depends on the lateral position.

    Velocities are varied along the axis and across it: a shank that sits in its hole is free in one direction and held
    in the other, with a corner between the sides, and a mixture of the two would blur that by what it is held with.
    """
    length, point = model.body.tip, work.point
    for n in range(6):
        point[n] = state[n]
    for n in (0, 2):
        unit = length if n == 0 else 1.0
        increment = math.copysign(DIFFERENCE * unit, state[n])
        point[n] = state[n] + increment
        _differ(point, increment, model, work, linear.stiffness[:, n])
        point[n] = state[n]
    small = VELOCITY_DIFFERENCE * model.law.ramp_velocity
    increment = math.copysign(small / length, state[5])
    point[5] = state[5] + increment
    _differ(point, increment, model, work, linear.damping[:, 2])
    point[5] = state[5]
    c, s, damping = math.cos(state[2]), math.sin(state[2]), linear.damping
    forward, sideways = c * state[3] + s * state[4], c * state[4] - s * state[3]
    increment = math.copysign(small, forward)
    point[3], point[4] = state[3] + increment * c, state[4] + increment * s
    _differ(point, increment, model, work, damping[:, 0])
    increment = math.copysign(small, sideways)
    point[3], point[4] = state[3] - increment * s, state[4] + increment * c
    _differ(point, increment, model, work, damping[:, 1])
    for i in range(3):
        along, across = damping[i, 0], damping[i, 1]
        damping[i, 0], damping[i, 1] = c * along - s * across, s * along + c * across


@lean
def _differ(point: FloatArray, increment: float, model: Model, work: Work, column: FloatArray) -> None:
    """Fill a column with the slopes of the accelerations from ``work.start`` to a point this far away."""
    accelerate(point, model, work.scratch, work.stage)
    for i in range(3):
        column[i] = (work.stage[i] - work.start[i]) / increment


@lean
def _invert(linear: Linearisation, step: float) -> None:
    """Inverse of ``I/(hγ) - ∂a/∂v - hγ ∂a/∂q``, by cofactors."""
    g, m = step * GAMMA, linear.inverse
    a, b, c = _newton(linear, g, 0, 0), _newton(linear, g, 0, 1), _newton(linear, g, 0, 2)
    d, e, f = _newton(linear, g, 1, 0), _newton(linear, g, 1, 1), _newton(linear, g, 1, 2)
    p, q, r = _newton(linear, g, 2, 0), _newton(linear, g, 2, 1), _newton(linear, g, 2, 2)
    m[0, 0], m[0, 1], m[0, 2] = e * r - f * q, c * q - b * r, b * f - c * e
    m[1, 0], m[1, 1], m[1, 2] = f * p - d * r, a * r - c * p, c * d - a * f
    m[2, 0], m[2, 1], m[2, 2] = d * q - e * p, b * p - a * q, a * e - b * d
    determinant = a * m[0, 0] + b * m[1, 0] + c * m[2, 0]
    for i in range(3):
        for j in range(3):
            m[i, j] /= determinant


@lean
def _newton(linear: Linearisation, g: float, i: int, j: int) -> float:
    own = 1.0 / g if i == j else 0.0
    return own - float(linear.damping[i, j] + g * linear.stiffness[i, j])


@lean
def _solve_stage(
    point: FloatArray, acceleration: FloatArray, step: float, linear: Linearisation, stages: FloatArray, index: int
) -> None:
    """Fill row `index` of `stages` from the rate at its state."""
    g, rate = step * GAMMA, 1.0 / step
    for n in range(3):
        position = velocity = 0.0
        for j in range(index):
            position += COUPLINGS[index, j] * stages[j, n]
            velocity += COUPLINGS[index, j] * stages[j, n + 3]
        stages[index, n], stages[index, n + 3] = point[n + 3] + position * rate, acceleration[n] + velocity * rate
    drift, push, inverse = stages[index, :3], stages[index, 3:], linear.inverse
    for i in range(3):
        for j in range(3):
            push[i] += g * linear.stiffness[i, j] * drift[j]
    a, b, c = push[0], push[1], push[2]
    for i in range(3):
        push[i] = inverse[i, 0] * a + inverse[i, 1] * b + inverse[i, 2] * c
        drift[i] = g * (drift[i] + push[i])


@lean
def attempt_step(
    state: FloatArray, step: float, model: Model, work: Work, linear: Linearisation, scale: FloatArray
) -> float:
    """Try a step from the accelerations in ``work.start`` to the state in ``work.trial``; return its error."""
    stages, trial = work.stages, work.trial
    _invert(linear, step)
    _solve_stage(state, work.start, step, linear, stages, 0)
    for index in range(1, STAGES - 1):
        for n in range(6):
            trial[n] = state[n]
            for j in range(index):
                trial[n] += STAGE_WEIGHTS[index, j] * stages[j, n]
        accelerate(trial, model, work.scratch, work.stage)
        _solve_stage(trial, work.stage, step, linear, stages, index)
    _solve_stage(trial, work.stage, step, linear, stages, STAGES - 1)
    error = stages[STAGES]
    for n in range(6):
        trial[n], error[n] = state[n], 0.0
        for j in range(STAGES):
            trial[n] += WEIGHTS[j] * stages[j, n]
            error[n] += ERROR_WEIGHTS[j] * stages[j, n]
    return _size(error, scale)


@lean
def end_error(state: FloatArray, step: float, work: Work, linear: Linearisation, scale: FloatArray) -> float:
    """Error of the step just tried as seen from its end, where the accelerations are in ``work.end``."""
    for n in range(3):
        work.point[n + 3] = work.trial[n + 3] - state[n + 3]
        work.stage[n] = work.end[n] - work.start[n]
    _solve_stage(work.point, work.stage, step, linear, work.stages, STAGES)
    return _size(work.stages[STAGES], scale)


@lean
def _size(error: FloatArray, scale: FloatArray) -> float:
    total = 0.0
    for n in range(6):
        total += (error[n] / scale[n]) ** 2
    return math.sqrt(total / 6.0)
