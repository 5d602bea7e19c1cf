"""The paper's strike as named values, shared by tests, examples and figures."""

import math

from solver.impact import Impact
from solver.nose import Ogive
from solver.projectile import Projectile
from solver.target import Target

PAPER_PROJECTILE = Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.08, length=0.53, mass=13.0)
PAPER_TARGET = Target(compressive_strength=39e6, density=2250.0)
PAPER_VELOCITY = 238.0
"""[m/s]"""


def paper_impact(*, oblique_angle_degrees: float) -> Impact:
    """The paper's strike at an oblique angle in degrees from the normal."""
    return Impact(velocity=PAPER_VELOCITY, oblique_angle=math.radians(oblique_angle_degrees))
