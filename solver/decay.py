"""Free-surface decay for the compiled code: polynomials on either side of its corner, for P / P(endless) and for Q.

A decay function has one corner, at the ratio k at which the plastic zone first reaches the face. Beyond it a shell of
the solid stays elastic, and both parts are polynomials of degree four in 1/k. Nearer to the face they are so smooth in
the variable ``x = (k - a) / (k + a)``, with a the square root of k at the corner, that others follow them to 1e-7.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, interpolation
from solver.compilation import exact, lean
from solver.free_surface import FreeSurface, NoFreeSurface
from solver.target import Target

DEGREE = 12
"""Near the face. A multiple of four: terms are summed in groups of four, a third of the time of one after another."""
SHELL_DEGREE = 4
NODES, FROM_NODES = interpolation(DEGREE)
SHARES = np.arange(SHELL_DEGREE + 1) / SHELL_DEGREE
FROM_SHARES = np.linalg.inv(np.vander(SHARES, increasing=True))
"""From values at `SHARES` of the corner's 1/k to coefficients."""
TINY = 1e-300


class Near(NamedTuple):
    """Decay between the face and the corner: polynomials in ``scale x``, coefficients constant first."""

    scale: float
    """One over the largest x there is between them."""
    static: FloatArray
    """(DEGREE + 1,) P / P(endless)."""
    inertia: FloatArray
    """(DEGREE + 1,) Q."""


class Deep(NamedTuple):
    """Decay beyond the corner: polynomials in k of the corner over k, coefficients constant first."""

    static: FloatArray
    """(SHELL_DEGREE + 1,) P / P(endless)."""
    inertia: FloatArray
    """(SHELL_DEGREE + 1,) Q."""


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
    near: Near
    deep: Deep


@lru_cache  # the cases of a study share few targets
def build_decay(model: FreeSurface, target: Target) -> Decay:
    """Polynomials of a decay model."""
    if isinstance(model, NoFreeSurface):
        none, nothing = np.zeros(DEGREE + 1), np.zeros(SHELL_DEGREE + 1)
        return Decay(0.0, 1.0, 0.0, 0.0, Near(0.0, none, none), Deep(nothing, nothing))
    corner = float(model.plastic_ratio(target))
    pivot = math.sqrt(corner)
    edge = (pivot - 1.0) / (pivot + 1.0)
    near = (1.0 - edge * NODES) / (1.0 + edge * NODES) / pivot
    inverse_ratios = np.concatenate((SHARES / corner, near))  # the first is that of an endless target
    static = model.static_pressure(inverse_ratios, target)
    inertia = model.inertia_coefficient(inverse_ratios, target)
    endless, inertia_endless = float(static[0]), float(inertia[0])
    return Decay(
        corner=corner,
        pivot=pivot,
        inertia_scale=target.density / endless if inertia_endless > 0.0 else 0.0,
        inertia_endless=inertia_endless,
        near=Near(1.0 / edge, FROM_NODES @ (static[SHARES.size :] / endless), FROM_NODES @ inertia[SHARES.size :]),
        deep=Deep(FROM_SHARES @ static[: SHARES.size] / endless, FROM_SHARES @ inertia[: SHARES.size]),
    )


@exact
def _near_variable(inward: float, outward: float, decay: Decay) -> float:
    whole = inward + outward + TINY
    return (whole - decay.pivot * outward) / (whole + decay.pivot * outward) * decay.near.scale


@exact
def _deep_variable(inward: float, outward: float, decay: Decay) -> float:
    return decay.corner * outward / (inward + outward + TINY)


@exact
def _near_value(coefficients: FloatArray, t: float) -> float:
    square = t * t
    fourth = square * square
    value = float(coefficients[DEGREE])
    for k in range(DEGREE - 4, -1, -4):
        low, high = coefficients[k] + coefficients[k + 1] * t, coefficients[k + 2] + coefficients[k + 3] * t
        value = value * fourth + (low + high * square)
    return value


@exact
def _deep_value(coefficients: FloatArray, t: float) -> float:
    square = t * t
    low, high = coefficients[0] + coefficients[1] * t, coefficients[2] + coefficients[3] * t
    return float(low + square * (high + coefficients[4] * square))


@exact
def static_factor(inward: float, outward: float, decay: Decay, deep: bool) -> float:
    """f of a decay without inertia, from the distance to the face and that to the axis, which make up k."""
    if deep:
        return _deep_value(decay.deep.static, _deep_variable(inward, outward, decay))
    return _near_value(decay.near.static, _near_variable(inward, outward, decay))


@exact
def inertial_factor(inward: float, outward: float, speed: float, decay: Decay, deep: bool) -> float:
    """f of a decay with inertia."""
    if deep:
        t = _deep_variable(inward, outward, decay)
        static, inertia = _deep_value(decay.deep.static, t), _deep_value(decay.deep.inertia, t)
    else:
        t = _near_variable(inward, outward, decay)
        static, inertia = _near_value(decay.near.static, t), _near_value(decay.near.inertia, t)
    pressure = decay.inertia_scale * speed * speed
    return (static + pressure * inertia) / (1.0 + pressure * decay.inertia_endless)


@lean
def decay_at(inward: float, outward: float, speed: float, decay: Decay) -> float:
    """f of eq. 2 for one element: its distance to the face along its normal, that to the axis, its normal velocity."""
    if decay.corner == 0.0 or outward <= 0.0:
        return 1.0
    deep = inward + outward >= decay.corner * outward
    if decay.inertia_scale > 0.0:
        return inertial_factor(inward, outward, speed, decay, deep)
    return static_factor(inward, outward, decay, deep)
