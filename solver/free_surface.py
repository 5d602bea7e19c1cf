"""Free-surface decay: the weakening of the resistance by a nearby face (eqs. 2-3).

The stress on an element whose outward normal meets the face is a fraction f of the stress in an infinite target. f is
the wall pressure of a spherical cavity in a sphere of finite outer radius, divided by the pressure in an infinite
solid. With k the outer radius divided by the cavity radius and y = 1/k its inverse (0 in an infinite solid, 1 at the
face),

    f = (P(y) + ρ v² Q(y)) / (P(0) + ρ v² Q(0)),

so a static wall pressure P and an inertia coefficient Q define a decay law.

The compiled code evaluates P / P(0) and Q as polynomials, with different ones on either side of a corner. The corner is
the ratio k at which the plastic zone first reaches the face. For larger k an outer shell stays elastic, and P and Q are
exactly polynomials of degree four in 1/k. Nearer to the face they are smooth functions of ``x = (k - a) / (k + a)``,
with a the square root of k at the corner, and polynomials in x approximate them. For concretes of 13 to 108 MPa with
the default Young's modulus the errors are at most 2e-7 of P / P(0) and 2e-5 of Q.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np

from solver.arrays import FloatArray, interpolation
from solver.checks import require
from solver.compilation import exact, lean
from solver.target import Target
from solver.units import Amount


@dataclass(frozen=True, slots=True, kw_only=True)
class ElasticPlastic:
    """Decay law of a perfectly plastic solid with yield strength f'c and an elastic shell around it (Hill 1950).

    Parameters
    ----------
    inertia
        Include the inertia of the expanding solid, incompressible as in Warren et al.

    Notes
    -----
    Poisson's ratio comes from the target. In an infinite solid the radius of the plastic zone is
    ``k = (E / (3 (1 - ν) f'c))^(1/3)`` times that of the cavity.
    """

    name: ClassVar[str] = "elastic_plastic"
    inertia: bool = False

    def plastic_ratio(self, target: Target) -> float:
        """Return the radius of the plastic zone divided by the radius of the cavity, in an infinite solid. [1]"""
        strain_limit = 3.0 * (1.0 - target.poissons_ratio) * target.compressive_strength
        return _plastic_ratio(target, strain_limit)

    def static_pressure(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Return the static wall pressure P(y). [Pa]"""
        beta = self.plastic_ratio(target)
        y = np.asarray(radius_ratio_inverse, dtype=np.float64)
        shell = (1.0 + 3.0 * math.log(beta) - (beta * y) ** 3) / 3.0
        plastic = -np.log(np.maximum(y, 1.0 / beta))
        return 2.0 * target.compressive_strength * np.where(y * beta <= 1.0, shell, plastic)

    def inertia_coefficient(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Return the wall pressure per unit of ρ v², Q(y). [1]"""
        y = np.asarray(radius_ratio_inverse, dtype=np.float64)
        return 1.5 - 2.0 * y + 0.5 * y**4 if self.inertia else np.zeros_like(y)


@dataclass(frozen=True, slots=True, kw_only=True)
class MohrCoulomb:
    """Decay law of a Mohr-Coulomb solid, ``σr - σθ = λ p + τ`` with λ = 2/3, with an elastic shell around it.

    Parameters
    ----------
    inertia
        Include the inertia of the expanding solid.

    Notes
    -----
    The cohesion ``τ = (3 - λ) f'c / 3`` makes the solid yield at f'c in uniaxial compression (Warren et al. 2004).
    """

    name: ClassVar[str] = "mohr_coulomb"
    inertia: bool = False
    pressure_hardening: ClassVar[float] = 2.0 / 3.0

    def cohesion(self, target: Target) -> float:
        """Return the yield strength τ at zero pressure. [Pa]"""
        return (3.0 - self.pressure_hardening) * target.compressive_strength / 3.0

    def plastic_ratio(self, target: Target) -> float:
        """Return the radius of the plastic zone divided by the radius of the cavity, in an infinite solid. [1]"""
        return _plastic_ratio(target, 1.5 * self.cohesion(target))

    def static_pressure(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Return the static wall pressure P(y). [Pa]"""
        lam, tau, beta, m = self._constants(target)
        y = np.asarray(radius_ratio_inverse, dtype=np.float64)
        at_interface = np.where(y * beta < 1.0, 2.0 * tau / 3.0 * (1.0 - (beta * y) ** 3), 0.0)
        plastic_radius = 1.0 / np.maximum(y, 1.0 / beta)
        return np.asarray(plastic_radius**m * (at_interface + tau / lam) - tau / lam)

    def inertia_coefficient(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Return the wall pressure per unit of ρ v², Q(y). [1]"""
        y = np.asarray(radius_ratio_inverse, dtype=np.float64)
        if not self.inertia:
            return np.zeros_like(y)
        _, _, beta, m = self._constants(target)
        shell = np.where(y * beta < 1.0, 1.0 / beta - y - (beta**-4 - y**4) / 4.0, 0.0)
        radius = 1.0 / np.maximum(y, 1.0 / beta)
        plastic = (radius ** (m - 1.0) - 1.0) / (m - 1.0) - (radius ** (m - 4.0) - 1.0) / (m - 4.0)
        return np.asarray(2.0 * (radius**m * shell + plastic))

    def _constants(self, target: Target) -> tuple[float, float, float, float]:
        lam = self.pressure_hardening
        return lam, self.cohesion(target), self.plastic_ratio(target), 6.0 * lam / (3.0 + 2.0 * lam)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoFreeSurface:
    """No decay: the stress on every loaded element is that in an infinite target, f = 1."""

    name: ClassVar[str] = "none"

    def static_pressure(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Return a constant wall pressure, independent of the distance from the face. [Pa]"""
        return np.full_like(radius_ratio_inverse, target.compressive_strength, dtype=np.float64)

    def inertia_coefficient(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Return zero: this law has no inertia. [1]"""
        return np.zeros_like(radius_ratio_inverse, dtype=np.float64)


FreeSurface: TypeAlias = ElasticPlastic | MohrCoulomb | NoFreeSurface


def decay_laws(*, inertia: bool = False) -> tuple[FreeSurface, ...]:
    """Return all decay laws; if `inertia` is true, those that can include the inertia of the expanding solid do so."""
    return ElasticPlastic(inertia=inertia), MohrCoulomb(inertia=inertia), NoFreeSurface()


def decay_factor(
    *, model: FreeSurface, target: Target, radius_ratio: FloatArray, normal_velocity: float = 0.0
) -> FloatArray:
    """Return the fraction f of the resistance of an infinite target that remains near a face.

    Parameters
    ----------
    model
        Decay law.
    target
        Target, whose concrete determines the wall pressures.
    radius_ratio
        (n,) ratios k of outer to cavity radius, from 1 at the face to infinity deep inside. [1]
    normal_velocity
        Velocity of the element along its outward normal; only laws with inertia use it. [m/s]

    Returns
    -------
    (n,) array
        Fractions f, from 0 at the face to 1 deep inside. [1]

    Notes
    -----
    Eqs. 2-3 of the source paper, with the wall pressures of Hill (1950) and Warren et al. (2004).
    """
    y = 1.0 / np.asarray(radius_ratio, dtype=np.float64)
    endless = np.zeros(1)
    dynamic_pressure = target.density * normal_velocity**2

    def pressure(inverse: FloatArray) -> FloatArray:
        inertia = model.inertia_coefficient(inverse, target)
        return np.asarray(model.static_pressure(inverse, target) + dynamic_pressure * inertia)

    return np.asarray(pressure(y) / pressure(endless))


def _plastic_ratio(target: Target, least_modulus: float) -> float:
    """Return the radius of the plastic zone divided by the radius of the cavity, in an infinite solid. [1]

    Parameters
    ----------
    least_modulus
        Young's modulus at which the plastic zone vanishes. [Pa]

    Raises
    ------
    ParameterError
        If Young's modulus of the target is not above `least_modulus`.
    """
    require(
        target.elastic_modulus > least_modulus,
        "target.youngs_modulus",
        "must be greater than {} for concrete of {}, which would not yield around the cavity otherwise, got {}",
        Amount(least_modulus, "GPa", 4),
        Amount(target.compressive_strength, "MPa"),
        Amount(target.elastic_modulus, "GPa"),
    )
    return float((target.elastic_modulus / least_modulus) ** (1.0 / 3.0))


# Degree 12 gives the errors that the docstring of this module states. With a multiple of four, terms are summed in
# groups of four (Estrin's scheme), which takes a third of the time of Horner's scheme, where each term waits for the
# previous one.
DEGREE = 12
"""Degree of the decay polynomials for k below the corner, where the plastic zone reaches the face."""
# Above the corner the laws are exactly polynomials of degree four in 1/k.
SHELL_DEGREE = 4
"""Degree of the decay polynomials for k above the corner, where a shell stays elastic."""
NODES, FROM_NODES = interpolation(DEGREE)
SHARES = np.arange(SHELL_DEGREE + 1) / SHELL_DEGREE
"""Interpolation nodes for k above the corner: 1/k divided by its value at the corner."""
FROM_SHARES = np.linalg.inv(np.vander(SHARES, increasing=True))
"""Matrix that turns values at `SHARES` into coefficients, constant first."""
# Added to a sum of lengths, it avoids 0/0 and is too small to change any other value.
TINY = 1e-300
"""Number added to a denominator that may be zero. [m]"""


class Near(NamedTuple):
    """Decay for k below the corner: polynomials in ``scale x``, coefficients from the constant upwards."""

    scale: float
    """Inverse of the largest x below the corner. [1]"""
    static: FloatArray
    """(DEGREE + 1,) coefficients of P / P(0)."""
    inertia: FloatArray
    """(DEGREE + 1,) coefficients of Q."""


class Deep(NamedTuple):
    """Decay for k above the corner: polynomials in (k at the corner) / k, coefficients from the constant upwards."""

    static: FloatArray
    """(SHELL_DEGREE + 1,) coefficients of P / P(0)."""
    inertia: FloatArray
    """(SHELL_DEGREE + 1,) coefficients of Q."""


class Decay(NamedTuple):
    """Polynomials of the decay function of a target."""

    corner: float
    """Ratio k at the corner, where the plastic zone first reaches the face; 0 for a target without decay. [1]"""
    pivot: float
    """Ratio k at which x is zero: a, the square root of k at the corner. [1]"""
    inertia_scale: float
    """Ratio ρ / P(0); zero for a decay without inertia. [s²/m²]"""
    inertia_endless: float
    """Inertia coefficient Q of an infinite target. [1]"""
    near: Near
    deep: Deep


@lru_cache  # the cases of a study share few targets
def build_decay(model: FreeSurface, target: Target) -> Decay:
    """Convert a decay law to the polynomials of the compiled code."""
    if isinstance(model, NoFreeSurface):
        none, nothing = np.zeros(DEGREE + 1), np.zeros(SHELL_DEGREE + 1)
        return Decay(0.0, 1.0, 0.0, 0.0, Near(0.0, none, none), Deep(nothing, nothing))
    corner = float(model.plastic_ratio(target))
    # The laws vary like ln k. With this pivot x is an odd function of ln(k / a), so its range is symmetric about zero.
    pivot = math.sqrt(corner)
    edge = (pivot - 1.0) / (pivot + 1.0)
    near = (1.0 - edge * NODES) / (1.0 + edge * NODES) / pivot
    inverse_ratios = np.concatenate((SHARES / corner, near))  # the first one, 0, is that of an infinite target
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
    # Here k = whole / outward. Multiplying numerator and denominator by `outward` avoids a division by zero at the
    # axis.
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
    """Return f of a decay without inertia at k = 1 + inward / outward. [1]

    Parameters
    ----------
    inward, outward
        Distances from the element to the face and to the axis of the body, both along the normal of the element, in
        any common unit.
    deep
        Whether to use the polynomials above the corner.
    """
    if deep:
        return _deep_value(decay.deep.static, _deep_variable(inward, outward, decay))
    return _near_value(decay.near.static, _near_variable(inward, outward, decay))


@exact
def inertial_factor(inward: float, outward: float, speed: float, decay: Decay, deep: bool) -> float:
    """Return f of a decay with inertia at the normal velocity `speed`; other arguments as in `static_factor`. [1]"""
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
    """Return f of eq. 2 for one element. [1]

    Parameters
    ----------
    inward, outward
        Distances from the element to the face and to the axis of the body, both along the normal of the element, in
        any common unit.
    speed
        Normal velocity of the element. [m/s]
    """
    if decay.corner == 0.0 or outward <= 0.0:
        return 1.0
    deep = inward + outward >= decay.corner * outward
    if decay.inertia_scale > 0.0:
        return inertial_factor(inward, outward, speed, decay, deep)
    return static_factor(inward, outward, decay, deep)
