"""Free-surface decay for the compiled code: one polynomial on either side of its corner.

A decay function has one corner, at the ratio k at which the plastic zone first reaches the face, and is smooth on
either side of it. In the variable ``x = (k - a) / (k + a)``, with a the square root of k at the corner, it is so
smooth that polynomials of a low degree follow both of its parts, P / P(endless) and Q, to 1e-7.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import exact, lean
from solver.free_surface import FreeSurface, NoFreeSurface
from solver.polynomials import fit
from solver.target import Target

DEGREE = 12
"""A multiple of four: terms are summed in groups of four, which takes a third of the time of one after the other."""
TINY = 1e-300


class Side(NamedTuple):
    """Decay on one side of the corner: polynomials in ``scale x + shift``, coefficients constant first."""

    scale: float
    shift: float
    static: FloatArray
    """(DEGREE + 1,) P / P(endless)."""
    inertia: FloatArray
    """(DEGREE + 1,) Q."""


class Decay(NamedTuple):
    """Decay function of a target."""

    corner: float
    """k of the corner; 0 for a target without decay. [1]"""
    pivot: float
    """a, where x is zero. [1]"""
    inertia_scale: float
    """ρ / P(endless), zero for a decay without inertia. [s²/m²]"""
    inertia_endless: float
    """Q of an endless target. [1]"""
    near: Side
    """Between the face and the corner."""
    deep: Side
    """Beyond the corner."""


@lru_cache  # the cases of a study share few targets
def build_decay(model: FreeSurface, target: Target) -> Decay:
    """Polynomials of a decay model."""
    nothing = np.zeros(DEGREE + 1)
    if isinstance(model, NoFreeSurface):
        side = Side(0.0, 0.0, nothing, nothing)
        return Decay(0.0, 1.0, 0.0, 0.0, side, side)
    endless = np.zeros(1)
    static = float(model.static_pressure(endless, target)[0])
    inertia = float(model.inertia_coefficient(endless, target)[0])
    corner = model.plastic_ratio(target)
    pivot = math.sqrt(corner)
    edge = (pivot - 1.0) / (pivot + 1.0)

    def fit_side(lowest: float, highest: float) -> Side:
        def inverse_ratio(t: FloatArray) -> FloatArray:
            x = lowest + (highest - lowest) * (t + 1.0) / 2.0
            return (1.0 - x) / (1.0 + x) / pivot

        width = highest - lowest
        return Side(
            scale=2.0 / width,
            shift=-(lowest + highest) / width,
            static=fit(lambda t: model.static_pressure(inverse_ratio(t), target) / static, DEGREE),
            inertia=fit(lambda t: model.inertia_coefficient(inverse_ratio(t), target), DEGREE) if inertia else nothing,
        )

    scale = target.density / static if inertia > 0.0 else 0.0
    return Decay(corner, pivot, scale, inertia, near=fit_side(-edge, edge), deep=fit_side(edge, 1.0))


@exact
def side_variable(inward: float, outward: float, pivot: float, scale: float, shift: float) -> float:
    """Argument of the polynomials of one side, from the distance to the face and that to the axis, which make up k."""
    whole = inward + outward + TINY
    return (whole - pivot * outward) / (whole + pivot * outward) * scale + shift


@exact
def polynomial(coefficients: FloatArray, t: float) -> float:
    """Value at `t`."""
    square = t * t
    fourth = square * square
    value = float(coefficients[DEGREE])
    for k in range(DEGREE - 4, -1, -4):
        low, high = coefficients[k] + coefficients[k + 1] * t, coefficients[k + 2] + coefficients[k + 3] * t
        value = value * fourth + (low + high * square)
    return value


@exact
def with_inertia(static: float, inertia: float, pressure: float, endless: float) -> float:
    """f from its two parts, for a dynamic pressure ρ v² over P(endless)."""
    return (static + pressure * inertia) / (1.0 + pressure * endless)


@lean
def decay_at(inward: float, outward: float, speed: float, decay: Decay) -> float:
    """f of eq. 2 for one element: its distance to the face along its normal, that to the axis, its normal velocity."""
    if decay.corner == 0.0 or outward <= 0.0:
        return 1.0
    side = decay.deep if inward + outward >= decay.corner * outward else decay.near
    t = side_variable(inward, outward, decay.pivot, side.scale, side.shift)
    factor = polynomial(side.static, t)
    if decay.inertia_scale > 0.0:
        pressure = decay.inertia_scale * speed * speed
        factor = with_inertia(factor, polynomial(side.inertia, t), pressure, decay.inertia_endless)
    return factor
