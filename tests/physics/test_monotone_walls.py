"""In normal impact the limit speed rises with strength and thickness of the wall, with or without plug and crater."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from solver import (
    ConstantStrengthFactor,
    Crater,
    Flat,
    Ogive,
    PerforationStatus,
    Projectile,
    PublishedTests,
    Resistance,
    ShearPlug,
    Spherical,
    Target,
    limit_velocity,
)

VARIANTS = {
    "plain": Resistance(),
    "plug": Resistance(rear_plug=ShearPlug()),
    "plug and crater": Resistance(rear_plug=ShearPlug(), crater=Crater()),
}
TWICE_THE_TOLERANCE = 2e-4
"""Largest error of the ratio of two limit speeds, each computed to 1e-4. [1]"""


class Wall(NamedTuple):
    """A wall, and a body that strikes it."""

    projectile: Projectile
    target: Target
    strength_factor: float


def random_walls(count: int, seed: int) -> Iterator[Wall]:
    """Yield random walls of 0.3 to 6 diameters; bodies of 10 to 300 mm, concrete of 15 to 120 MPa, S of 3 to 20."""
    random = np.random.default_rng(seed)
    for number in range(count):
        nose = (Ogive(caliber_radius_head=3.0), Flat(), Spherical(caliber_radius_head=0.5))[number % 3]
        diameter = float(np.exp(random.uniform(math.log(0.01), math.log(0.3))))
        length = diameter * float(random.uniform(3.0, 8.0))
        mass = float(random.uniform(3000.0, 8000.0)) * math.pi / 4.0 * diameter**2 * length
        target = Target(
            compressive_strength=float(random.uniform(15e6, 120e6)),
            density=float(random.uniform(2000.0, 2600.0)),
            thickness=diameter * float(np.exp(random.uniform(math.log(0.3), math.log(6.0)))),
        )
        body = Projectile(nose=nose, diameter=diameter, length=length, mass=mass)
        yield Wall(body, target, float(random.uniform(3.0, 20.0)))


def limit_speed(wall: Wall, variant: Resistance, *, published: bool = False) -> float:
    """Return the limit speed, with a constant S or with S from the published tests. [m/s]

    It is 0 if the lowest speed of the search, 1 m/s, perforates, and infinite if no speed does.
    """
    law = PublishedTests() if published else ConstantStrengthFactor(value=wall.strength_factor)
    resistance = replace(variant, strength_factor=law)
    found = limit_velocity(projectile=wall.projectile, target=wall.target, oblique_angle=0.0, resistance=resistance)
    if found.value is None:
        return 0.0 if found.status is PerforationStatus.ALWAYS_PERFORATED else math.inf
    return found.value


def assert_rises(wall: Wall, variant: Resistance) -> None:
    """Check that the limit speed rises with S, with thickness, and with strength for both choices of S."""
    stronger, thicker = wall.target.compressive_strength, wall.target.thickness or 0.0
    speed, by_law = limit_speed(wall, variant), limit_speed(wall, variant, published=True)
    for factor in (1.03, 1.25):
        strong = replace(wall.target, compressive_strength=factor * stronger)
        others = {
            "S": limit_speed(wall._replace(strength_factor=factor * wall.strength_factor), variant),
            "strength": limit_speed(wall._replace(target=strong), variant),
            "thickness": limit_speed(wall._replace(target=replace(wall.target, thickness=factor * thicker)), variant),
        }
        for name, other in others.items():
            assert other >= (1.0 - TWICE_THE_TOLERANCE) * speed, (name, factor, wall)
        other = limit_speed(wall._replace(target=strong), variant, published=True)
        assert other >= (1.0 - TWICE_THE_TOLERANCE) * by_law, ("strength by law", factor, wall)


@pytest.mark.parametrize("variant", VARIANTS)
def test_limit_speed_rises_with_strength_factor_strength_and_thickness(variant: str) -> None:
    for wall in random_walls(6, seed=1):
        assert_rises(wall, VARIANTS[variant])


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("seed", range(2, 12))
def test_limit_speed_rises_for_500_random_walls(variant: str, seed: int) -> None:
    for wall in random_walls(50, seed=seed):
        assert_rises(wall, VARIANTS[variant])
