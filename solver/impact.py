"""The strike: how fast, from where and turning how."""

from dataclasses import dataclass

from solver.bounds import require_angle, require_bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """The strike.

    Parameters
    ----------
    velocity
        Speed of the centre of gravity at first contact, 0.1 to 10,000. [m/s]
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
        require_bounds("impact.velocity", self.velocity)
        require_angle("impact.oblique_angle", self.oblique_angle, below=True)
        require_angle("impact.angle_of_attack", self.angle_of_attack, below=False)
        require_bounds("impact.angular_velocity", self.angular_velocity)

    @property
    def axis_angle(self) -> float:
        """From the inward normal to the axis. [rad]"""
        return self.oblique_angle + self.angle_of_attack
