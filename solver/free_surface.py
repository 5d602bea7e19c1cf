"""Free-surface decay: how a nearby face weakens the resistance of the target (eqs. 2-3).

An element whose outward normal meets the face is resisted by a fraction f of what it would meet in an endless
target: the wall pressure of a spherical cavity in a sphere of finite outer radius, over that in an endless solid.
With k the outer radius over the cavity radius and y = 1/k its inverse (0 in an endless solid, 1 at the face),

    f = (P(y) + ρ v² Q(y)) / (P(0) + ρ v² Q(0)),

so a decay model is its static wall pressure P and its inertia coefficient Q, and nothing else.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np

from solver.arrays import FloatArray
from solver.target import Target
from solver.validation import require


@dataclass(frozen=True, slots=True, kw_only=True)
class ElasticPlastic:
    """Elastic shell around a perfectly plastic one of yield strength f'c (Hill 1950).

    Parameters
    ----------
    inertia
        Include the inertia of the expanding solid, incompressible as in Warren et al.

    Notes
    -----
    Poisson's ratio comes from the target. The plastic zone of an endless solid reaches
    ``k = (E / (3 (1 - ν) Y))^(1/3)``.
    """

    name: ClassVar[str] = "elastic_plastic"
    inertia: bool = False

    def plastic_ratio(self, target: Target) -> float:
        """Radius of the plastic zone over that of the cavity, in an endless solid. [1]"""
        strain_limit = 3.0 * (1.0 - target.poissons_ratio) * target.compressive_strength
        return _plastic_ratio(target.elastic_modulus / strain_limit)

    def static_pressure(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Static wall pressure P(y). [Pa]"""
        beta = self.plastic_ratio(target)
        y = np.asarray(radius_ratio_inverse, dtype=np.float64)
        shell = (1.0 + 3.0 * math.log(beta) - (beta * y) ** 3) / 3.0
        plastic = -np.log(np.maximum(y, 1.0 / beta))
        return 2.0 * target.compressive_strength * np.where(y * beta <= 1.0, shell, plastic)

    def inertia_coefficient(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Wall pressure for each unit of ρ v², Q(y). [1]"""
        y = np.asarray(radius_ratio_inverse, dtype=np.float64)
        return 1.5 - 2.0 * y + 0.5 * y**4 if self.inertia else np.zeros_like(y)


@dataclass(frozen=True, slots=True, kw_only=True)
class MohrCoulomb:
    """Elastic shell around one that yields by Mohr-Coulomb, ``σr - σθ = λ p + τ`` with λ = 2/3.

    Parameters
    ----------
    inertia
        Include the inertia of the expanding solid.

    Notes
    -----
    The cohesion ``τ = (3 - λ) f'c / 3`` makes the solid yield at f'c in plain compression (Warren et al. 2004).
    """

    name: ClassVar[str] = "mohr_coulomb"
    inertia: bool = False
    pressure_hardening: ClassVar[float] = 2.0 / 3.0

    def cohesion(self, target: Target) -> float:
        """Yield strength τ without pressure. [Pa]"""
        return (3.0 - self.pressure_hardening) * target.compressive_strength / 3.0

    def plastic_ratio(self, target: Target) -> float:
        """Radius of the plastic zone over that of the cavity, in an endless solid. [1]"""
        return _plastic_ratio(2.0 * target.elastic_modulus / (3.0 * self.cohesion(target)))

    def static_pressure(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Static wall pressure P(y). [Pa]"""
        lam, tau, beta, m = self._constants(target)
        y = np.asarray(radius_ratio_inverse, dtype=np.float64)
        at_interface = np.where(y * beta < 1.0, 2.0 * tau / 3.0 * (1.0 - (beta * y) ** 3), 0.0)
        plastic_radius = 1.0 / np.maximum(y, 1.0 / beta)
        return np.asarray(plastic_radius**m * (at_interface + tau / lam) - tau / lam)

    def inertia_coefficient(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """Wall pressure for each unit of ρ v², Q(y). [1]"""
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
    """No decay: every loaded element is resisted as in an endless target, f = 1."""

    name: ClassVar[str] = "none"

    def static_pressure(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """A constant: the same pressure at every distance. [Pa]"""
        return np.full_like(radius_ratio_inverse, target.compressive_strength, dtype=np.float64)

    def inertia_coefficient(self, radius_ratio_inverse: FloatArray, target: Target) -> FloatArray:
        """None. [1]"""
        return np.zeros_like(radius_ratio_inverse, dtype=np.float64)


FreeSurface: TypeAlias = ElasticPlastic | MohrCoulomb | NoFreeSurface


def decay_factor(
    *, model: FreeSurface, target: Target, radius_ratio: FloatArray, normal_velocity: float = 0.0
) -> FloatArray:
    """Fraction f of the resistance of an endless target.

    Parameters
    ----------
    model
        One of the decay models.
    target
        The concrete.
    radius_ratio
        (n,) k, from 1 at the face to infinity deep inside. [1]
    normal_velocity
        Of the element along its outward normal; matters only to a model with inertia. [m/s]

    Returns
    -------
    (n,) array
        From 0 at the face to 1 deep inside. [1]

    Notes
    -----
    Eqs. 2-3 of the source paper; the wall pressures are those of Hill (1950) and Warren et al. (2004).
    """
    y = 1.0 / np.asarray(radius_ratio, dtype=np.float64)
    endless = np.zeros(1)
    dynamic_pressure = target.density * normal_velocity**2

    def pressure(inverse: FloatArray) -> FloatArray:
        inertia = model.inertia_coefficient(inverse, target)
        return np.asarray(model.static_pressure(inverse, target) + dynamic_pressure * inertia)

    return np.asarray(pressure(y) / pressure(endless))


def _plastic_ratio(cubed: float) -> float:
    require(
        cubed > 1.0,
        "target.youngs_modulus",
        "too small against target.compressive_strength: the solid would never yield around the cavity",
    )
    return float(cubed ** (1.0 / 3.0))
