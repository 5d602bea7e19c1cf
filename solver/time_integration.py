"""Time integration of a motion, compiled: the fixed step of the paper, and the error-controlled steps of this package.

The route of the paper is the classical Runge-Kutta method of order 4 with a fixed step. That of this package takes
steps of GRK4T, a Rosenbrock pair of order 4 (3) for stiff equations. A shank at rest sideways in its hole makes the
equations stiff; this pair walks over that in steps of the motion's own size. Coefficients: Kaps and Rentrop, Numerische
Mathematik 33 (1979) 55-68, in the form of Hairer and Wanner, Solving Ordinary Differential Equations II (1996), IV.7.
The state is (position, velocity) with equal positions and velocities in number, so each stage needs one 3 × 3 solve.
"""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.cancellation import may_step
from solver.compilation import compiled, lean, once
from solver.loads import MOST_STATES
from solver.motion import (
    Model,
    RunValues,
    Termination,
    Thresholds,
    Workspace,
    accelerate,
    assign,
    end_of_step,
    greatest_depth,
    kinetic_energy,
    lasting_energy,
    store_step,
)
from solver.surface import Body

UNRESOLVED_ENERGY = 1e-2
"""Kinetic energy, over its initial value, below which a fixed step may be unable to tell motion from rest."""

MOST_ENERGY = 2.0
"""Kinetic energy, over its initial value, from which on a run has diverged: a true motion has no gain at all. With too
few stations a body between the faces of a wall can gain without bound, in ever shorter steps; so can fixed
steps that are too long."""


@once
def _attempt_fixed_step(state: FloatArray, step: float, model: Model, work: Workspace) -> None:
    """One step; the new state is in ``work.trial``."""
    rate, point = work.stages, work.point
    for n in range(6):
        point[n] = state[n]
    for index in range(4):
        if index > 0:
            reach = step if index == 3 else 0.5 * step
            for n in range(6):
                point[n] = state[n] + reach * rate[index - 1, n]
            accelerate(point, model, work.scratch, work.stage)
        for n in range(3):
            rate[index, n] = point[n + 3]
            rate[index, n + 3] = work.start[n] if index == 0 else work.stage[n]
    for n in range(6):
        work.trial[n] = state[n] + step / 6.0 * (rate[0, n] + 2.0 * (rate[1, n] + rate[2, n]) + rate[3, n])


@lean
def _impulse_energy(acceleration: FloatArray, step: float, body: Body) -> float:
    """Kinetic energy that the present load gives or takes within one step, from rest or to rest. [J]"""
    translation = body.mass * (acceleration[0] ** 2 + acceleration[1] ** 2)
    return 0.5 * float(translation + body.moment_of_inertia * acceleration[2] ** 2) * step**2


@compiled
def integrate_fixed(
    start: FloatArray,
    model: Model,
    end_time: float,
    thresholds: Thresholds,
    time_step: float,
    steps: FloatArray,
    state: FloatArray,
    control: IntArray,
    work: Workspace,
) -> RunValues:
    """Integrate with the fixed step of the paper until an event or `end_time`.

    A fixed step cannot follow the end of the motion: it overshoots rest and then gains energy, which no true motion
    does. A step that gains energy while the load could stop the projectile within one step is taken for rest, if little
    energy is left; with more, the step is too long for the strike, which the reported gain shows.

    Parameters
    ----------
    start
        (6,) state at first contact.
    steps
        (n, `STEP_WIDTH`) table to fill: a row for each step, or one row to keep none.
    state
        (6,) to fill, at the end of the run.
    control
        See `solver.cancellation`.
    work
        Arrays to work in.
    """
    body, lasting = model.body, lasting_energy(start, model.body)
    initial_energy = kinetic_energy(start, body) - lasting
    energies = Thresholds(lasting + thresholds.retention * initial_energy, lasting + thresholds.rest * initial_energy)
    event = work.event
    event[0] = -1.0
    assign(start, state)
    deepest, gain, energy = 0.0, 0.0, initial_energy  # a run begins with the deepest point at the face
    loaded = accelerate(state, model, work.scratch, work.start)
    # A termination time of a whole number of steps must not gain one more by rounding.
    count = math.ceil(end_time / time_step * (1.0 - 1e-12))
    for index in range(count):
        time = index * time_step
        if not may_step(control):
            return Termination.CANCELLED.value, time, deepest, index, 4 * index, gain
        step = min(time_step, end_time - time)
        _attempt_fixed_step(state, step, model, work)
        was_loaded, loaded = loaded, accelerate(work.trial, model, work.scratch, work.end)
        before, energy = energy, kinetic_energy(work.trial, body) - lasting
        enough = min(_impulse_energy(work.end, step, body), UNRESOLVED_ENERGY * initial_energy)
        if before < energy < enough:
            return Termination.REST.value, time, deepest, index, 4 * index, gain
        gain = max(gain, (energy - before) / initial_energy)
        if energy > MOST_ENERGY * initial_energy:
            return Termination.NOT_FINITE.value, time, deepest, index, 4 * index, gain
        row = steps[index if steps.shape[0] > 1 else 0]
        store_step(row, time, step, state, work)
        end = end_of_step(row, model, work, was_loaded, loaded, energies, start[2], index == count - 1, event)
        until = time + step if event[0] < 0.0 else event[0]  # what coasts on out of a wall is not held any deeper
        if until > time:
            deepest = max(deepest, greatest_depth(row, until, body, work.point))
        if end != Termination.NONE:
            assign(event[1:], state)
            return end.value, event[0], deepest, index + 1, 4 * index + 4, gain
        assign(work.trial, state)
        assign(work.end, work.start)
    return Termination.TIME.value, end_time, deepest, count, 4 * count, gain


STAGES = 4
GAMMA = 0.231
"""Diagonal element of the method; with it, any decay of the linear test equation whose eigenvalues lie within 89.3° of
the negative real axis stays a decay, however long the step."""

STAGE_WEIGHTS = np.array(
    [
        [0.0, 0.0],
        [2.0, 0.0],
        [4.524708207373116, 4.163528788597648],
    ]
)
"""The last stage is at the state of the one before, and needs no further evaluation."""
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
"""Weights of the difference of the pair."""
EVALUATIONS = 2
"""For one attempt of a step, without its end."""
DIFFERENCE = 1e-7
"""Step of the difference quotients in position, over the distance from centre of gravity to tip. Forward quotients
lose half the digits at best, near the square root of the rounding error, 1.5e-8; some times that leaves room for the
rounding of the sums over the rings."""
VELOCITY_DIFFERENCE = 1e-3
"""That in velocity, over the ramp velocity: below it the static stress is smooth."""
DIFFERENCES = MOST_STATES
"""Evaluations for one linearisation, all at once."""


class Linearisation(NamedTuple):
    """Derivatives of the accelerations by position and velocity, and the inverse that the stages share; all (3, 3)."""

    stiffness: FloatArray
    damping: FloatArray
    inverse: FloatArray


def make_linearisation() -> Linearisation:
    """Return arrays to fill."""
    return Linearisation(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))


@once
def linearise(state: FloatArray, model: Model, work: Workspace, linear: Linearisation) -> None:
    """Difference quotients of the accelerations, each away from zero. Nothing depends on the lateral position.

    Velocities are varied along the axis and across it: a shank that sits in its hole is free in one direction and held
    in the other, with a corner between the sides, and a mixture of the two would blur that by what it is held with.
    """
    points, slopes, length = work.points, work.slopes, model.body.tip
    for k in range(DIFFERENCES):
        for n in range(6):
            points[6 * k + n] = state[n]
    small, c, s = VELOCITY_DIFFERENCE * model.law.ramp_velocity, math.cos(state[2]), math.sin(state[2])
    deeper, turned = math.copysign(DIFFERENCE * length, state[0]), math.copysign(DIFFERENCE, state[2])
    along = math.copysign(small, c * state[3] + s * state[4])
    across = math.copysign(small, c * state[4] - s * state[3])
    spun = math.copysign(small / length, state[5])
    points[0] += deeper
    points[6 + 3] += along * c
    points[6 + 4] += along * s
    points[12 + 3] -= across * s
    points[12 + 4] += across * c
    points[18 + 5] += spun
    points[24 + 2] += turned
    accelerate(points, model, work.scratch, slopes)
    damping, stiffness = linear.damping, linear.stiffness
    for i in range(3):
        start = work.start[i]
        stiffness[i, 0], stiffness[i, 2] = (slopes[i] - start) / deeper, (slopes[12 + i] - start) / turned
        by_along, by_across = (slopes[3 + i] - start) / along, (slopes[6 + i] - start) / across
        damping[i, 0], damping[i, 1] = c * by_along - s * by_across, s * by_along + c * by_across
        damping[i, 2] = (slopes[9 + i] - start) / spun


@lean
def _invert(linear: Linearisation, step: float) -> None:
    """Inverse of ``I/(hγ) - ∂a/∂v - hγ ∂a/∂q``, by cofactors."""
    # Eliminating velocities first leaves three equations instead of six. For so few, cofactors cost less than an
    # elimination, and need no pivot, which would be a branch.
    g, m, damping, stiffness = step * GAMMA, linear.inverse, linear.damping, linear.stiffness
    for i in range(3):
        for j in range(3):
            own = 1.0 / g if i == j else 0.0
            m[i, j] = own - (damping[i, j] + g * stiffness[i, j])
    a, b, c = m[0, 0], m[0, 1], m[0, 2]
    d, e, f = m[1, 0], m[1, 1], m[1, 2]
    p, q, r = m[2, 0], m[2, 1], m[2, 2]
    m[0, 0], m[0, 1], m[0, 2] = e * r - f * q, c * q - b * r, b * f - c * e
    m[1, 0], m[1, 1], m[1, 2] = f * p - d * r, a * r - c * p, c * d - a * f
    m[2, 0], m[2, 1], m[2, 2] = d * q - e * p, b * p - a * q, a * e - b * d
    determinant = a * m[0, 0] + b * m[1, 0] + c * m[2, 0]
    for i in range(3):
        for j in range(3):
            m[i, j] /= determinant


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


@once
def attempt_step(
    state: FloatArray, step: float, model: Model, work: Workspace, linear: Linearisation, scale: FloatArray
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
def end_error(state: FloatArray, step: float, work: Workspace, linear: Linearisation, scale: FloatArray) -> float:
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


STEP_LIMIT = 100_000
"""Reached only in a stiff phase at tolerances of 1e-8 and below."""
FIRST_STEP, LARGEST_STEP, SMALLEST_STEP = 1e-2, 0.25, 1e-15
"""Over the time to travel the distance from centre of gravity to tip."""


class Accuracy(NamedTuple):
    """What limits a step."""

    relative_tolerance: float
    """Error of one step over the scale of the motion."""
    largest_step: float
    """Over the time to travel, at the present speed, the distance from centre of gravity to tip."""
    most_steps: int = STEP_LIMIT
    """Steps that are tried before a run is given up."""


@compiled
def integrate_adaptive(
    start: FloatArray,
    model: Model,
    end_time: float,
    thresholds: Thresholds,
    accuracy: Accuracy,
    steps: FloatArray,
    state: FloatArray,
    control: IntArray,
    work: Workspace,
    linear: Linearisation,
) -> RunValues:
    """Integrate with error control until an event or `end_time`.

    Parameters
    ----------
    start
        (6,) state at first contact.
    steps
        (n, `STEP_WIDTH`) table to fill: `STEP_LIMIT` rows to keep every step, one row to keep none.
    state
        (6,) to fill, at the end of the run.
    control
        See `solver.cancellation`.
    work, linear
        Arrays to work in.
    """
    body, lasting = model.body, lasting_energy(start, model.body)
    initial_energy = kinetic_energy(start, body) - lasting
    energies = Thresholds(lasting + thresholds.retention * initial_energy, lasting + thresholds.rest * initial_energy)
    impact = math.hypot(start[3], start[4])
    # Errors count over the size of the body and the velocity of impact, so that one tolerance serves all six numbers.
    scale = work.scale
    scale[0] = scale[1] = body.tip
    scale[2], scale[3], scale[4], scale[5] = 1.0, impact, impact, impact / body.tip
    event, time, step = work.event, 0.0, FIRST_STEP * body.tip / impact
    event[0] = -1.0
    assign(start, state)
    deepest = 0.0  # a run begins with the deepest point at the face
    loaded, fresh = accelerate(state, model, work.scratch, work.start), False
    end_loaded = loaded
    evaluations, count = 1, 0
    for _ in range(accuracy.most_steps):
        if not may_step(control):
            return Termination.CANCELLED.value, time, deepest, count, evaluations, 0.0
        # The nose enters by a row of kinks, which a longer step would pass over however smooth its own estimate is.
        pace = math.hypot(state[3], state[4]) + abs(state[5]) * body.tip
        step = min(step, accuracy.largest_step * body.tip / pace, end_time - time)
        # The Jacobian takes five of the eight evaluations of a step. It belongs to the state: a rejected step keeps it.
        if not fresh:
            linearise(state, model, work, linear)
            evaluations += DIFFERENCES
            fresh = True
        error = attempt_step(state, step, model, work, linear, scale) / accuracy.relative_tolerance
        evaluations += EVALUATIONS
        if error <= 1.0:
            # No stage looks beyond 0.88 of the step, so a load that begins after that is only seen from the end. The
            # accelerations there are also those that the next step starts from: the second estimate costs one solve.
            end_loaded = accelerate(work.trial, model, work.scratch, work.end)
            evaluations += 1
            error = max(error, end_error(state, step, work, linear, scale) / accuracy.relative_tolerance)
        if not error <= 1.0:  # NaN is refused too
            # The error falls with the fourth power of the step. A tenth is held back so that the next attempt passes,
            # and a step shrinks fivefold at most, as an estimate beside a kink says little of a much shorter one.
            step *= max(0.2, 0.9 / math.sqrt(math.sqrt(error))) if math.isfinite(error) else 0.2
            if step < SMALLEST_STEP * body.tip / impact:
                return Termination.NOT_FINITE.value, time, deepest, count, evaluations, 0.0
            continue
        was_loaded, loaded = loaded, end_loaded
        row = steps[count if steps.shape[0] > 1 else 0]
        store_step(row, time, step, state, work)
        count += 1
        if kinetic_energy(work.trial, body) - lasting > MOST_ENERGY * initial_energy:
            return Termination.NOT_FINITE.value, time, deepest, count, evaluations, 0.0
        last = time + step >= end_time * (1.0 - 1e-12)
        end = end_of_step(row, model, work, was_loaded, loaded, energies, start[2], last, event)
        # An event lies on the cubic through both ends of the step, so that no step has to be cut short to meet it.
        until = time + step if event[0] < 0.0 else event[0]  # what coasts on out of a wall is not held any deeper
        if until > time:
            deepest = max(deepest, greatest_depth(row, until, body, work.point))
        if end != Termination.NONE:
            assign(event[1:], state)
            return end.value, event[0], deepest, count, evaluations, 0.0
        time += step
        assign(work.trial, state)
        assign(work.end, work.start)
        fresh = False
        # In free flight the error is zero and says nothing of the load ahead, so a step grows fivefold at most.
        step *= min(5.0, 0.9 / math.sqrt(math.sqrt(max(error, 1e-10))))
    return Termination.STEP_LIMIT.value, time, deepest, count, evaluations, 0.0
