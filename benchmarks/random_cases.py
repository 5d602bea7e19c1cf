"""Random strikes, usual and unusual ones; the same seed gives the same strikes."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TypedDict

import numpy as np

from solver import (
    Conical,
    CriticalAngle,
    ElasticPlastic,
    Flat,
    MohrCoulomb,
    NoFreeSurface,
    ObliquityPolynomial,
    Ogive,
    Profile,
    Projectile,
    Resistance,
    RicochetError,
    Spherical,
    StrengthPowerLaw,
    Target,
    critical_angle,
    solid_properties,
)
from solver.projectile import NoseShape
from solver.strike import PAPER_PROJECTILE

DECAYS = (
    ElasticPlastic(),
    ElasticPlastic(inertia=True),
    MohrCoulomb(),
    MohrCoulomb(inertia=True),
    NoFreeSurface(),
)
STRENGTH_FACTORS = (ObliquityPolynomial(), StrengthPowerLaw())
"""Strength factors: eq. 9 of the paper, and the power law of Frew et al."""


class Case(TypedDict):
    """One strike without its angle, as arguments of `critical_angle`."""

    projectile: Projectile
    target: Target
    velocity: float
    angle_of_attack: float
    resistance: Resistance


class Cases(TypedDict):
    """Many strikes, as arguments of `critical_angle_many`."""

    projectile: list[Projectile]
    target: list[Target]
    velocity: list[float]
    angle_of_attack: list[float]
    resistance: list[Resistance]


def random_cases(count: int, seed: int) -> Cases:
    """Return `count` strikes. With the same seed, a larger count begins with the same strikes.

    Velocity 100 to 800 m/s, angle of attack -3° to 3°; concrete of 15 to 90 MPa and 2100 to 2500 kg/m³; homogeneous
    ogives of 5000 to 9000 kg/m³, calibre-radius-head 1.5 to 6, diameter 20 to 150 mm and length 3 to 10 diameters,
    enough for the longest of these noses (2.4 diameters). The five decay laws alternate, and each is combined with both
    strength factors.
    """
    random = np.random.default_rng(seed)
    return together(_random_case(random, index) for index in range(count))


def study_cases(count: int, seed: int) -> Cases:
    """Return `count` strikes near the paper's, as in a study of one projectile; they cost less than random strikes.

    Velocity 200 to 400 m/s, mass 11 to 15 kg, concrete of 25 to 55 MPa and 2100 to 2500 kg/m³.
    """
    random = np.random.default_rng(seed)
    return together(_study_case(random) for _ in range(count))


def _study_case(random: np.random.Generator) -> Case:
    return {
        "projectile": replace(PAPER_PROJECTILE, mass=random.uniform(11.0, 15.0)),
        "target": Target(compressive_strength=random.uniform(25e6, 55e6), density=random.uniform(2100.0, 2500.0)),
        "velocity": random.uniform(200.0, 400.0),
        "angle_of_attack": 0.0,
        "resistance": Resistance(),
    }


def _random_case(random: np.random.Generator, index: int) -> Case:
    return {
        "projectile": _random_projectile(random),
        "target": Target(compressive_strength=random.uniform(15e6, 90e6), density=random.uniform(2100.0, 2500.0)),
        "velocity": random.uniform(100.0, 800.0),
        "angle_of_attack": math.radians(random.uniform(-3.0, 3.0)),
        "resistance": Resistance(
            free_surface=DECAYS[index % len(DECAYS)],
            strength_factor=STRENGTH_FACTORS[index // len(DECAYS) % len(STRENGTH_FACTORS)],
        ),
    }


def _random_projectile(random: np.random.Generator) -> Projectile:
    nose = Ogive(caliber_radius_head=random.uniform(1.5, 6.0))
    diameter = random.uniform(0.02, 0.15)
    length = diameter * random.uniform(3.0, 10.0)
    density = random.uniform(5000.0, 9000.0)
    volume = solid_properties(Projectile(nose=nose, diameter=diameter, length=length, mass=1.0)).volume
    return Projectile(nose=nose, diameter=diameter, length=length, mass=density * volume)


def wall_cases(count: int, seed: int) -> Cases:
    """Return the strikes of `random_cases`, on walls of 0.5 to 5 diameters."""
    cases, random = random_cases(count, seed), np.random.default_rng(seed + 1)
    cases["target"] = [
        replace(target, thickness=random.uniform(0.5, 5.0) * projectile.diameter)
        for projectile, target in zip(cases["projectile"], cases["target"], strict=True)
    ]
    return cases


def odd_cases(count: int, seed: int) -> Cases:
    """Return `count` strikes from a range far wider than that of `random_cases`, with five kinds of nose.

    Velocity 30 to 900 m/s and diameter 5 to 250 mm, both log-uniform, angle of attack -5° to 5°; concrete of 10 to
    150 MPa and 1900 to 2600 kg/m³; ogives, cones, caps, flat and profiled noses in turn, shanks of 1 to 8 diameters,
    homogeneous at 3000 to 12,000 kg/m³. Decay law and strength factor are chosen at random.
    """
    random = np.random.default_rng(seed)
    return together(_odd_case(random, index) for index in range(count))


def _odd_case(random: np.random.Generator, index: int) -> Case:
    return {
        "projectile": _odd_projectile(random, index),
        "target": Target(compressive_strength=random.uniform(10e6, 150e6), density=random.uniform(1900.0, 2600.0)),
        "velocity": math.exp(random.uniform(math.log(30.0), math.log(900.0))),
        "angle_of_attack": math.radians(random.uniform(-5.0, 5.0)),
        "resistance": Resistance(
            free_surface=DECAYS[random.integers(len(DECAYS))],
            strength_factor=STRENGTH_FACTORS[random.integers(len(STRENGTH_FACTORS))],
        ),
    }


def _odd_projectile(random: np.random.Generator, index: int) -> Projectile:
    diameter = math.exp(random.uniform(math.log(0.005), math.log(0.25)))
    radius = diameter / 2.0
    tip, height = random.uniform(0.1, 0.9), random.uniform(0.1, 2.0)
    noses: tuple[NoseShape, ...] = (
        Ogive(caliber_radius_head=random.uniform(0.5, 10.0)),
        Conical(length_to_diameter=random.uniform(0.2, 5.0)),
        Spherical(caliber_radius_head=random.uniform(0.5, 3.0)),
        Flat(),
        Profile(points=((0.0, tip * radius), (height * diameter, radius))),
    )
    nose = noses[index % len(noses)]
    length = nose.length(radius) + diameter * random.uniform(1.0, 8.0)
    density = random.uniform(3000.0, 12_000.0)
    volume = solid_properties(Projectile(nose=nose, diameter=diameter, length=length, mass=1.0)).volume
    return Projectile(nose=nose, diameter=diameter, length=length, mass=density * volume)


def together(cases: Iterator[Case]) -> Cases:
    """Combine single cases into the sequences of `Cases`."""
    rows = list(cases)
    return {
        "projectile": [row["projectile"] for row in rows],
        "target": [row["target"] for row in rows],
        "velocity": [row["velocity"] for row in rows],
        "angle_of_attack": [row["angle_of_attack"] for row in rows],
        "resistance": [row["resistance"] for row in rows],
    }


def one_by_one(cases: Cases) -> Iterator[Case]:
    """Split the sequences of `Cases` into single cases."""
    for row in zip(*cases.values(), strict=True):
        yield Case(**dict(zip(cases, row, strict=True)))  # type: ignore[typeddict-item]


def answer_or_error(case: Case) -> CriticalAngle | RicochetError:
    try:
        return critical_angle(**case)
    except RicochetError as error:
        return error
