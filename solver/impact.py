"""The strike: how fast, from where and turning how."""

import math
from dataclasses import dataclass

from solver.validation import require, require_between, require_finite, require_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """The strike.

    Parameters
    ----------
    velocity
        Speed of the centre of gravity at first contact. [m/s]
    oblique_angle
        From the inward normal of the face to the velocity; 0 is normal impact. [rad]
    angle_of_attack
        Axis angle minus velocity angle, positive with the nose turned toward the face. [rad]
    angular_velocity
        Rate of the axis angle at first contact. [rad/s]

    Raises
    ------
    ParameterError
        If a value is not finite or outside its range.
    """

    velocity: float
    oblique_angle: float
    angle_of_attack: float = 0.0
    angular_velocity: float = 0.0

    def __post_init__(self) -> None:
        require_positive("impact.velocity", self.velocity)
        require(
            math.isfinite(self.oblique_angle) and abs(self.oblique_angle) < math.pi / 2.0,
            "impact.oblique_angle",
            f"must be less than 90° from the normal, got {math.degrees(self.oblique_angle):g}°",
        )
        require_between("impact.angle_of_attack", self.angle_of_attack, -math.pi / 2.0, math.pi / 2.0)
        require_finite("impact.angular_velocity", self.angular_velocity)

    @property
    def axis_angle(self) -> float:
        """From the inward normal to the axis. [rad]"""
        return self.oblique_angle + self.angle_of_attack
