"""The published depth tests as strikes that the solver can compute."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from service.reports.reference import PenetrationTest
from solver import ModelWarning, Ogive, Projectile, Target, solid_properties
from solver.warnings import input_warnings

OUTLIER_ROW = 55
LIKELY_VELOCITY = 690.0
"""Of that test, if its 590 m/s are a slip. [m/s]"""
STEEL_DENSITY = 7850.0
"""[kg/m³]"""
NEXT_GRADE = 1.25
"""A strength more than this many times the next lower one of its series begins another grade of concrete."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Strike:
    """A test and what the solver needs for it."""

    test: PenetrationTest
    projectile: Projectile
    target: Target
    group: str
    """Series and grade of concrete, within which one strength factor is fitted."""
    flags: tuple[ModelWarning, ...]
    """What the model warns of."""

    @property
    def counted(self) -> bool:
        """Whether it enters fits and statistics."""
        return self.test.row != OUTLIER_ROW


def strikes(tests: Sequence[PenetrationTest]) -> tuple[Strike, ...]:
    """Prepare every test, in the given order."""
    groups = grades(tests)
    return tuple(_strike(test, group) for test, group in zip(tests, groups, strict=True))


def grades(tests: Sequence[PenetrationTest]) -> list[str]:
    """Name series and grade of concrete of each test: strengths of a series that lie close together are one grade."""
    names: dict[tuple[str, float], str] = {}
    for series in dict.fromkeys(test.series for test in tests):
        grade: list[float] = []
        for strength in sorted({test.compressive_strength for test in tests if test.series == series}):
            if grade and strength > NEXT_GRADE * grade[-1]:
                grade = []
            grade.append(strength)
            names |= {(series, member): f"{series}, {_range(grade)} MPa" for member in grade}
    return [names[test.series, test.compressive_strength] for test in tests]


def _range(strengths: Sequence[float]) -> str:
    lowest, highest = (f"{strength / 1e6:.3g}" for strength in (strengths[0], strengths[-1]))
    return lowest if lowest == highest else f"{lowest} to {highest}"


def _strike(test: PenetrationTest, group: str) -> Strike:
    projectile = _projectile(test)
    target = Target(compressive_strength=test.compressive_strength, density=test.density)
    warnings = input_warnings(projectile=projectile, target=target, velocity=test.velocity, angle_of_attack=0.0)
    flags = tuple(warning for warning in warnings if warning.code != "mass_properties_assumed")  # it does not turn
    return Strike(test=test, projectile=projectile, target=target, group=group, flags=flags)


def _projectile(test: PenetrationTest) -> Projectile:
    """The body; where its length is not known, that of a solid one of steel with the mass of the test."""
    nose = Ogive(caliber_radius_head=test.caliber_radius_head)
    nose_length = nose.length(test.diameter / 2.0)
    body = Projectile(nose=nose, diameter=test.diameter, length=test.length or nose_length, mass=test.mass)
    if test.length is not None:
        return body
    shank_volume = test.mass / STEEL_DENSITY - solid_properties(body).volume
    return replace(body, length=nose_length + shank_volume / (math.pi * body.radius**2))
