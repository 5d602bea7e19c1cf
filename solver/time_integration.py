"""Compiled time integration of a motion: the fixed step of the paper, and the error-controlled steps of this package.

The paper uses the classical Runge-Kutta method of order 4 with a fixed step. The adaptive method uses GRK4T,
a Rosenbrock pair of order 4 (3) for stiff equations. The equations are stiff where the wall of the hole keeps the shank
from moving sideways: an explicit pair took thousands of steps there. Coefficients: Kaps and Rentrop, Numerische
Mathematik 33 (1979) 55-68, in the form of Hairer and Wanner, Solving Ordinary Differential Equations II (1996), IV.7.
The state consists of three positions and three velocities; eliminating the velocities leaves a 3 × 3 system in each
stage.
"""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.cancellation import may_step
from solver.compilation import compiled, lean
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

# A gain while the energy is above this limit means that the step is too long for the strike; the result reports it.
UNRESOLVED_ENERGY = 1e-2
"""Kinetic energy relative to its initial value, below which a fixed step that gains energy may count as rest. [1]"""

# An exact solution gains no energy. With too few stations, a body between the faces of a wall gains energy without
# bound, in ever shorter steps: searches on walls took seconds before such runs were ended. The factor 2 is far above
# the error of any run worth reporting.
MOST_ENERGY = 2.0
"""Kinetic energy relative to its initial value, above which a run counts as diverged. [1]"""


@lean
def _attempt_fixed_step(state: FloatArray, step: float, model: Model, work: Workspace) -> None:
    """Write the state after one Runge-Kutta step to ``work.trial``."""
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
    """Return the kinetic energy that a constant load gives to a body at rest within one step. [J]"""
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

    A fixed step overshoots rest and then gains energy, which an exact solution never does. Such a step counts as rest
    if the load could stop the projectile within one step, and less than `UNRESOLVED_ENERGY` is left. Otherwise the
    result reports the gain, because the step is too long for the strike.

    Parameters
    ----------
    start
        (6,) state at first contact.
    steps
        (n, `STEP_WIDTH`) output: a row for each step. With a single row, only the last step is kept.
    state
        (6,) output: state at the end of the run.
    control
        Shared array that cancels the run, see `solver.cancellation`.
    work
        Scratch arrays.
    """
    body, lasting = model.body, lasting_energy(start, model.body)
    initial_energy = kinetic_energy(start, body) - lasting
    energies = Thresholds(lasting + thresholds.retention * initial_energy, lasting + thresholds.rest * initial_energy)
    event = work.event
    event[0] = -1.0
    assign(start, state)
    deepest, gain, energy = 0.0, 0.0, initial_energy  # a run begins with the deepest point at the face
    loaded = accelerate(state, model, work.scratch, work.start)
    # Without the factor, rounding could add a step if the termination time is a whole number of steps.
    count = math.ceil(end_time / time_step * (1.0 - 1e-12))
    evaluations = 1
    for index in range(count):
        time = index * time_step
        if not may_step(control):
            return Termination.CANCELLED.value, time, deepest, index, evaluations, gain
        step = min(time_step, end_time - time)
        _attempt_fixed_step(state, step, model, work)
        was_loaded, loaded = loaded, accelerate(work.trial, model, work.scratch, work.end)
        evaluations += 4
        before, energy = energy, kinetic_energy(work.trial, body) - lasting
        # The panel method applies the full static stress at any velocity, so near rest the load changes sign from step
        # to step, and adds energy to the body.
        enough = min(_impulse_energy(work.end, step, body), UNRESOLVED_ENERGY * initial_energy)
        if before < energy < enough:
            return Termination.REST.value, time, deepest, index, evaluations, gain
        gain = max(gain, (energy - before) / initial_energy)
        if energy > MOST_ENERGY * initial_energy:
            return Termination.NOT_FINITE.value, time, deepest, index, evaluations, gain
        row = steps[index if steps.shape[0] > 1 else 0]
        store_step(row, time, step, state, work)
        end = end_of_step(row, model, work, was_loaded, loaded, energies, start[2], index == count - 1, event)
        until = time + step if event[0] < 0.0 else event[0]  # the depth counts until the body is released
        if until > time:
            deepest = max(deepest, greatest_depth(row, until, body, work.point))
        if end != Termination.NONE:
            assign(event[1:], state)
            return end.value, event[0], deepest, index + 1, evaluations, gain
        assign(work.trial, state)
        assign(work.end, work.start)
    return Termination.TIME.value, end_time, deepest, count, evaluations, gain


STAGES = 4
"""Number of stages of GRK4T."""
# With γ = 0.231 the method is A(89.3°)-stable (Kaps and Rentrop 1979). The similar methods GRK4A and ROS4, and other
# pairs, stepped over the kinks of nose entry, chattered, or had two to six times the error (`benchmarks/NOTES.md`).
GAMMA = 0.231
"""Diagonal coefficient γ of GRK4T. [1]"""

STAGE_WEIGHTS = np.array(
    [
        [0.0, 0.0],
        [2.0, 0.0],
        [4.524708207373116, 4.163528788597648],
    ]
)
"""Coefficients of earlier stages in the state of a stage. There is no row for the last stage, which reuses the
evaluation of the third."""
# The first four rows are those of GRK4T. The fifth is this package's own, for `end_error`: no stage evaluates the load
# beyond 0.88 of a step, so a load that begins later shows only at the end. With the change of the rates from start to
# end of the step as its input, the fifth stage cancels the others up to order 3. Without it, 26 of 400 runs lost energy
# unnoticed; with it, one did.
COUPLINGS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [-5.071675338776316, 0.0, 0.0, 0.0],
        [6.020152728650786, 0.1597506846727117, 0.0, 0.0],
        [-1.856343618686113, -8.505380858179826, -2.084075136023187, 0.0],
        [8.567684694187544, -4.513188113271111, -4.443119282433976, -5.224572232181423],
    ]
)
"""Coefficients of earlier stages in the right-hand side of a stage, to be divided by the length of the step."""
WEIGHTS = np.array([3.957503746640777, 4.624892388363313, 0.6174772638750108, 1.282612945269037])
"""Weights of the stages in the solution of order 4."""
ERROR_WEIGHTS = np.array([2.302155402932996, 3.073634485392623, -0.8732808018045032, -1.282612945269037])
"""Weights of the stages in the difference of the solutions of order 4 and 3."""
EVALUATIONS = 2
"""Number of evaluations of the load in one attempt at a step, not counting its two ends."""
# The error of a forward difference is smallest near the square root of the rounding error, 1.5e-8. A value
# several times as large allows for the rounding of the sums over the rings.
DIFFERENCE = 1e-7
"""Increment of position in finite differences, relative to the distance from centre of gravity to tip. [1]"""
# The static stress rises from zero over the ramp velocity, so the increment has to be a small fraction of it.
VELOCITY_DIFFERENCE = 1e-3
"""Increment of velocity in finite differences, relative to the ramp velocity. [1]"""
DIFFERENCES = MOST_STATES
"""Number of evaluations of the load for one linearisation."""


class Linearisation(NamedTuple):
    """Jacobian of the accelerations at the start of a step, and the inverse matrix that all stages share."""

    stiffness: FloatArray
    """(3, 3) derivatives of the accelerations with respect to position."""
    damping: FloatArray
    """(3, 3) derivatives of the accelerations with respect to velocity."""
    inverse: FloatArray
    """(3, 3) inverse of ``I/(hγ) - damping - hγ stiffness`` for the step h."""


def make_linearisation() -> Linearisation:
    """Allocate a `Linearisation` for one run."""
    return Linearisation(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))


@lean
def linearise(state: FloatArray, model: Model, work: Workspace, linear: Linearisation) -> None:
    """Compute the Jacobian of the accelerations at `state` by forward differences.

    The column of the lateral position stays zero: the target is the same everywhere along its face.
    """
    points, slopes, length = work.points, work.slopes, model.body.tip
    # Velocities are varied along and across the axis instead of along the coordinates. A shank in its hole is free to
    # move along its axis and is held across it, so a difference in another direction would mix a small derivative with
    # a large one. This saved 11 to 20 % of the evaluations of a search.
    for k in range(DIFFERENCES):
        for n in range(6):
            points[6 * k + n] = state[n]
    small, c, s = VELOCITY_DIFFERENCE * model.law.ramp_velocity, math.cos(state[2]), math.sin(state[2])
    # Increments point away from zero, so that the differences of mirrored states mirror each other. Central
    # differences in the velocities have that property too, but take three more evaluations in each step.
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
    # One call for all five states fills the vector registers, which made a search 13 % faster than five calls.
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
    """Invert ``I/(hγ) - ∂a/∂v - hγ ∂a/∂q`` for the step h."""
    # The velocities have been eliminated, which leaves three equations instead of six. For so few, cofactors cost less
    # than Gaussian elimination, and need no pivoting, which would be a branch.
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
    """Write the increments of one stage to row `index` of `stages`, given the rates at the state of that stage."""
    # The form of Hairer and Wanner, in increments, needs no product of the Jacobian with earlier stages.
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
    state: FloatArray, step: float, model: Model, work: Workspace, linear: Linearisation, scale: FloatArray
) -> float:
    """Try a step with the initial accelerations ``work.start``; write ``work.trial`` and return the error norm. [1]"""
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
    """Return a second error norm of the last step, given its final accelerations in ``work.end``. [1]"""
    for n in range(3):
        work.point[n + 3] = work.trial[n + 3] - state[n + 3]
        work.stage[n] = work.end[n] - work.start[n]
    _solve_stage(work.point, work.stage, step, linear, work.stages, STAGES)
    return _size(work.stages[STAGES], scale)


@lean
def _size(error: FloatArray, scale: FloatArray) -> float:
    """Return the root mean square of the errors, each divided by its scale: the norm of Hairer and Wanner. [1]"""
    total = 0.0
    for n in range(6):
        total += (error[n] / scale[n]) ** 2
    return math.sqrt(total / 6.0)


# Usual runs take tens to hundreds of steps. Only runs with a stiff phase, at tolerances of 1e-8 and below, have reached
# this limit.
STEP_LIMIT = 100_000
"""Largest number of steps tried in one run of the adaptive method."""
# The first step is short, because the step control has no history yet. The largest step prevents steps from passing
# over the kinks of nose entry; a quarter is arbitrary. Below the smallest step, near the rounding error of time, a
# run counts as diverged.
FIRST_STEP, LARGEST_STEP, SMALLEST_STEP = 1e-2, 0.25, 1e-15
"""Lengths of steps, relative to the time to travel the distance from centre of gravity to tip at the impact speed; for
the largest step see `Accuracy`. [1]"""


class Accuracy(NamedTuple):
    """Tolerance and limits of the error-controlled steps."""

    relative_tolerance: float
    """Largest error of one step, relative to the scale of the motion. [1]"""
    largest_step: float
    """Largest step, relative to the time to travel the distance from centre of gravity to tip at the present pace: the
    speed plus the speed at which the tip turns about the centre of gravity. [1]"""
    most_steps: int = STEP_LIMIT
    """Number of attempts at a step, after which a run ends as `Termination.STEP_LIMIT`."""


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
        (n, `STEP_WIDTH`) output: `STEP_LIMIT` rows keep every step, a single row only the last one.
    state
        (6,) output: state at the end of the run.
    control
        Shared array that cancels the run, see `solver.cancellation`.
    work, linear
        Scratch arrays.
    """
    body, lasting = model.body, lasting_energy(start, model.body)
    initial_energy = kinetic_energy(start, body) - lasting
    energies = Thresholds(lasting + thresholds.retention * initial_energy, lasting + thresholds.rest * initial_energy)
    impact = math.hypot(start[3], start[4])
    # Errors are measured relative to the size of the body and the impact velocity, so that one tolerance serves
    # lengths, angles and rates. If they were measured relative to the current values, ever smaller errors would be
    # required as the body comes to rest.
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
        # Each outline piece that enters the target makes a kink in the load. A longer step could pass over one without
        # any sign of it in the error estimate.
        pace = math.hypot(state[3], state[4]) + abs(state[5]) * body.tip
        step = min(step, accuracy.largest_step * body.tip / pace, end_time - time)
        # The Jacobian takes five of the eight evaluations of a step. It depends only on the state, so a step that is
        # repeated with another length reuses it. Computing it only every second step saved nothing, because so many
        # more steps were rejected.
        if not fresh:
            linearise(state, model, work, linear)
            evaluations += DIFFERENCES
            fresh = True
        error = attempt_step(state, step, model, work, linear, scale) / accuracy.relative_tolerance
        evaluations += EVALUATIONS
        if error <= 1.0:
            # The second estimate shows a load that begins after the last evaluation of a stage, see `COUPLINGS`. The
            # next step needs the accelerations at the end anyway, so the estimate costs only one solve.
            end_loaded = accelerate(work.trial, model, work.scratch, work.end)
            evaluations += 1
            error = max(error, end_error(state, step, work, linear, scale) / accuracy.relative_tolerance)
        if not error <= 1.0:  # also true for NaN
            # The error estimate is proportional to the fourth power of the step. The factor 0.9 makes the next attempt
            # likely to pass. A step shrinks at most fivefold, because beside a kink the estimate does not follow that
            # power. Other factors changed the time of a search by less than 2 %, or made it up to 40 % longer.
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
        # Rounding may make the sum of the steps miss the termination time, which must not add another step.
        last = time + step >= end_time * (1.0 - 1e-12)
        end = end_of_step(row, model, work, was_loaded, loaded, energies, start[2], last, event)
        # An event is located on the cubic through both ends of the step, so no step has to be cut short to meet it.
        until = time + step if event[0] < 0.0 else event[0]  # the depth counts until the body is released
        if until > time:
            deepest = max(deepest, greatest_depth(row, until, body, work.point))
        if end != Termination.NONE:
            assign(event[1:], state)
            return end.value, event[0], deepest, count, evaluations, 0.0
        time += step
        assign(work.trial, state)
        assign(work.end, work.start)
        fresh = False
        # In free flight the error is zero, whatever load lies ahead, so a step grows at most fivefold. The floor of the
        # error avoids a division by zero, and is below the error at which the factor 5 applies.
        step *= min(5.0, 0.9 / math.sqrt(math.sqrt(max(error, 1e-10))))
    return Termination.STEP_LIMIT.value, time, deepest, count, evaluations, 0.0
