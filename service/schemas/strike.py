"""What is struck, and how, as the contract has it."""

import math
from typing import Annotated

from pydantic import MISSING, Field

import solver
from service.schemas.quantities import Num, Part, with_examples, within
from solver.strike import PAPER_TARGET, PAPER_VELOCITY

TARGET = {"compressive_strength_pa": PAPER_TARGET.compressive_strength, "density_kg_m3": PAPER_TARGET.density}
STRIKE = {"velocity_m_s": PAPER_VELOCITY}


class Target(Part):
    """Concrete: a half-space, or a wall of a thickness."""

    model_config = with_examples(TARGET, TARGET | {"youngs_modulus_pa": 29.5e9, "poissons_ratio": 0.2})

    compressive_strength_pa: Annotated[
        Num,
        Field(
            **within("target.compressive_strength"),
            description="Unconfined compressive strength. [Pa] From the weakest foam to above any concrete; the tests "
            "behind the model used 13 to 97 MPa.",
        ),
    ]
    density_kg_m3: Annotated[
        Num, Field(**within("target.density"), description="[kg/m³] From foam to above any heavy concrete.")
    ]
    youngs_modulus_pa: (
        Annotated[
            Num,
            Field(
                **within("target.youngs_modulus"),
                description="Taken from the strength by ACI 318-19, 4700 MPa times the square root of the strength in "
                "MPa, when not given. [Pa]",
            ),
        ]
        | MISSING
    ) = MISSING
    poissons_ratio: Annotated[
        Num, Field(**within("target.poissons_ratio"), description="0.5 is an incompressible solid. [1]")
    ] = PAPER_TARGET.poissons_ratio
    thickness_m: (
        Annotated[
            Num,
            Field(
                **within("target.thickness"),
                description="Thickness of a wall, at least a tenth of the diameter of the projectile; a half-space "
                "when not given. [m]",
            ),
        ]
        | MISSING
    ) = MISSING

    def to_solver(self) -> solver.Target:
        """Return the solver's target."""
        modulus = self.youngs_modulus_pa
        return solver.Target(
            compressive_strength=self.compressive_strength_pa,
            density=self.density_kg_m3,
            youngs_modulus=None if modulus is MISSING else modulus,
            poissons_ratio=self.poissons_ratio,
            thickness=None if self.thickness_m is MISSING else self.thickness_m,
        )


AngleOfAttack = Annotated[
    Num,
    Field(
        ge=-90.0,
        le=90.0,
        description="Axis angle minus velocity angle, positive with the nose turned toward the face. [°]",
    ),
]
AngularVelocity = Annotated[
    Num,
    Field(
        **within("impact.angular_velocity"),
        description="Rate of the axis angle, positive with the nose turning toward the face. [rad/s] Faster than "
        "any tumbling body holds together.",
    ),
]
ObliqueAngle = Annotated[
    Num,
    Field(
        ge=0.0,
        lt=90.0,
        description="From the inward normal of the face to the velocity: 0 is normal impact, 90 would graze. [°]",
    ),
]


class Strike(Part):
    """The motion at first contact but for the oblique angle."""

    model_config = with_examples(STRIKE, STRIKE | {"angle_of_attack_deg": 1.5, "angular_velocity_rad_s": -4.0})

    velocity_m_s: Annotated[
        Num,
        Field(
            **within("impact.velocity"),
            description="Speed of the centre of gravity. [m/s] Bodies stay rigid up to some 800 m/s.",
        ),
    ]
    angle_of_attack_deg: AngleOfAttack = 0.0
    angular_velocity_rad_s: AngularVelocity = 0.0

    def arguments(self) -> dict[str, float]:
        """Return what the solver calls these."""
        return {
            "velocity": self.velocity_m_s,
            "angle_of_attack": math.radians(self.angle_of_attack_deg),
            "angular_velocity": self.angular_velocity_rad_s,
        }


class Impact(Strike):
    """The motion at first contact."""

    model_config = with_examples(STRIKE | {"oblique_angle_deg": 45.0})

    oblique_angle_deg: ObliqueAngle

    def to_solver(self) -> solver.Impact:
        """Return the solver's impact."""
        return solver.Impact(oblique_angle=math.radians(self.oblique_angle_deg), **self.arguments())


class Approach(Part):
    """The motion at first contact but for the speed."""

    model_config = with_examples({"oblique_angle_deg": 20.0})

    oblique_angle_deg: ObliqueAngle
    angle_of_attack_deg: AngleOfAttack = 0.0
    angular_velocity_rad_s: AngularVelocity = 0.0

    def arguments(self) -> dict[str, float]:
        """Return what the solver calls these."""
        return {
            "oblique_angle": math.radians(self.oblique_angle_deg),
            "angle_of_attack": math.radians(self.angle_of_attack_deg),
            "angular_velocity": self.angular_velocity_rad_s,
        }
