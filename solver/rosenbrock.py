"""One step of RODAS, a stiffly stable Rosenbrock pair of order 4 (3), for motion under resistance, compiled.

A shank at rest sideways in its hole makes the equations stiff; this pair walks over that in steps of the motion's
own size. Coefficients: Hairer and Wanner, Solving Ordinary Differential Equations II (1996), IV.7. The state is
(position, velocity) with equal positions and velocities in number, so each stage needs one 3 × 3 solve.
"""

import math

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled

STAGES = 6
GAMMA = 0.25

STAGE_WEIGHTS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [1.544, 0.0, 0.0, 0.0, 0.0],
        [0.9466785280815826, 0.2557011698983284, 0.0, 0.0, 0.0],
        [3.314825187068521, 2.896124015972201, 0.9986419139977817, 0.0, 0.0],
        [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 0.0],
        [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0],
    ]
)
COUPLINGS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [-5.6688, 0.0, 0.0, 0.0, 0.0],
        [-2.430093356833875, -0.2063599157091915, 0.0, 0.0, 0.0],
        [-0.1073529058151375, -9.594562251023355, -20.47028614809616, 0.0, 0.0],
        [7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160, 0.0],
        [8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054],
    ]
)


@compiled
def newton_inverse(stiffness: FloatArray, damping: FloatArray, step: float, inverse: FloatArray) -> None:
    """Inverse of ``I/(hγ) - ∂a/∂v - hγ ∂a/∂q``, by cofactors."""
    g = step * GAMMA
    m = -damping - g * stiffness
    for i in range(3):
        m[i, i] += 1.0 / g
    for i in range(3):
        for j in range(3):
            a, b, c, d = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            inverse[i, j] = m[a, c] * m[b, d] - m[a, d] * m[b, c]
    inverse /= m[0, 0] * inverse[0, 0] + m[0, 1] * inverse[1, 0] + m[0, 2] * inverse[2, 0]


@compiled
def stage_state(state: FloatArray, stages: FloatArray, index: int, out: FloatArray) -> None:
    """State at which stage `index` evaluates the acceleration."""
    for n in range(6):
        out[n] = state[n]
        for j in range(index):
            out[n] += STAGE_WEIGHTS[index, j] * stages[j, n]


@compiled
def solve_stage(
    velocity: FloatArray,
    acceleration: FloatArray,
    step: float,
    stiffness: FloatArray,
    inverse: FloatArray,
    stages: FloatArray,
    index: int,
) -> None:
    """Fill row `index` of `stages` from the rate at its state."""
    g = step * GAMMA
    rate = np.empty(6)
    for n in range(3):
        rate[n], rate[n + 3] = velocity[n], acceleration[n]
    for n in range(6):
        for j in range(index):
            rate[n] += COUPLINGS[index, j] / step * stages[j, n]
    force = np.empty(3)
    for i in range(3):
        force[i] = rate[i + 3]
        for j in range(3):
            force[i] += g * stiffness[i, j] * rate[j]
    for i in range(3):
        stages[index, i + 3] = inverse[i, 0] * force[0] + inverse[i, 1] * force[1] + inverse[i, 2] * force[2]
        stages[index, i] = g * (rate[i] + stages[index, i + 3])


@compiled
def error_norm(stages: FloatArray, scale: FloatArray, relative_tolerance: float) -> float:
    """Estimated error of the step over the tolerance; the last stage is the difference of the pair."""
    total = 0.0
    for n in range(6):
        total += (stages[STAGES - 1, n] / scale[n]) ** 2
    return math.sqrt(total / 6.0) / relative_tolerance
