"""Depth of normal impact in closed form."""

import math

import numpy as np

from solver.arrays import gauss_rule
from solver.projectile import GAUSS_POINTS, Projectile
from solver.target import Target
from solver.validation import require_positive


def nose_factor(projectile: Projectile) -> float:
    """N: resistance of the nose to inertia over that of a flat face.

    Notes
    -----
    ``N = (2/a²) ∫ r sin²α dr`` over the nose, by Gauss quadrature; for an ogive (8ψ - 1) / (24ψ²).
    """
    t, w = gauss_rule(GAUSS_POINTS).T
    total = 0.0
    for piece in projectile.nose.outline(projectile.radius):
        _, r, sine, _ = piece.at(t)
        total += piece.length * float((r * sine**3) @ w)
    return 2.0 * total / projectile.radius**2


def closed_form_depth(*, projectile: Projectile, target: Target, velocity: float, strength_factor: float) -> float:
    """Depth of normal impact with a crater of two diameters, in closed form.

    Parameters
    ----------
    projectile, target
        What strikes and what is struck.
    velocity
        At first contact. [m/s]
    strength_factor
        S. [1]

    Returns
    -------
    float
        Depth of the nose tip at rest. [m]

    Raises
    ------
    ParameterError
        If the velocity or the strength factor is not greater than 0.

    Notes
    -----
    Forrestal, Altman, Cargile and Hanchak (1994): the resistance is ``c z`` in the crater, which is 4a deep, and
    ``π a² (S f'c + N ρ V²)`` beyond, so

        z = 4a + m / (2π a² N ρ) ln(1 + N ρ V₁² / (S f'c)),  V₁² = (m V² - 4π a³ S f'c) / (m + 4π a³ N ρ)

    with the speed V₁ at the end of the crater. A projectile too slow to get there stops where the spring has taken up
    its energy, ``z = V sqrt(m/c)`` with c of V₁ = 0, π a S f'c / 4; at the limit both are 4a. The source has ogives
    only; for other noses N is the same integral over their outline.
    """
    require_positive("velocity", velocity)
    require_positive("strength_factor", strength_factor)
    m, a, static = projectile.mass, projectile.radius, strength_factor * target.compressive_strength
    inertia = nose_factor(projectile) * target.density
    excess = m * velocity**2 - 4.0 * math.pi * a**3 * static
    if excess <= 0.0:
        return velocity * math.sqrt(4.0 * m / (math.pi * a * static))
    after_crater = excess / (m + 4.0 * math.pi * a**3 * inertia)
    return 4.0 * a + m / (2.0 * math.pi * a**2 * inertia) * float(np.log1p(inertia * after_crater / static))
