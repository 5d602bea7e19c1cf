"""A strike as the contract has it: the projectile, the target, the motion at first contact; and the examples."""

import math
from typing import Annotated, Any, Literal

from pydantic import MISSING, Field
from typing_extensions import TypeAliasType

import solver
from service.schemas.quantities import Num, Part, SolverPart, solver_arguments, with_examples, within
from service.schemas.resistance import CONSTANT, MOHR_COULOMB
from solver.checks import BOUNDS
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY

OGIVE = {"shape": "ogive", "caliber_radius_head": 3.0}
CONICAL = {"shape": "conical", "length_to_diameter": 1.5}
SPHERICAL = {"shape": "spherical", "caliber_radius_head": 0.5}
FLAT = {"shape": "flat"}
SPHERE = {"shape": "sphere"}
PROFILE = {"shape": "profile", "points": [[0.0, 0.01], [0.06, 0.03], [0.12, 0.04]]}
"""A truncated cone and a second, more slender one, for a shank of 80 mm."""

BOAT_TAIL = {"length_m": 0.08, "base_diameter_m": 0.06}

PROJECTILE = {
    "nose": OGIVE,
    "diameter_m": PAPER_PROJECTILE.diameter,
    "length_m": PAPER_PROJECTILE.length,
    "mass_kg": PAPER_PROJECTILE.mass,
}

CaliberRadiusHead = Annotated[
    Num,
    Field(
        **within("projectile.nose.caliber_radius_head"),
        description="Radius of the nose arc over the shank diameter; 0.5 is a hemisphere. [1] "
        "100 is a nose ten times as long as the shank is wide.",
    ),
]
Coordinate = Annotated[Num, Field(ge=0.0, le=BOUNDS["projectile.length"].upper)]
ProfilePoint = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]


class OgiveNose(SolverPart[solver.Ogive]):
    """Tangent ogive."""

    model_config = with_examples(OGIVE)

    shape: Literal["ogive"]
    caliber_radius_head: CaliberRadiusHead


class ConicalNose(SolverPart[solver.Conical]):
    """Cone."""

    model_config = with_examples(CONICAL)

    shape: Literal["conical"]
    length_to_diameter: Annotated[Num, Field(**within("projectile.nose.length_to_diameter"))]
    """Height of the cone over the shank diameter. [1]"""


class SphericalNose(SolverPart[solver.Spherical]):
    """Spherical cap."""

    model_config = with_examples(SPHERICAL)

    shape: Literal["spherical"]
    caliber_radius_head: CaliberRadiusHead


class FlatNose(SolverPart[solver.Flat]):
    """Flat face: the shank cut square."""

    model_config = with_examples(FLAT)

    shape: Literal["flat"]


class ProfileNose(SolverPart[solver.Profile]):
    """Convex chain of cones through points; a first radius above zero makes a flat face."""

    model_config = with_examples(PROFILE)

    shape: Literal["profile"]
    points: Annotated[list[ProfilePoint], Field(min_length=2, max_length=1000)]
    """[x, r] from the tip: x, the distance behind it, from 0; r, the distance from the axis, up to the radius of the
    shank. x may not decrease, and the slope may not increase. Where r falls behind its largest value, the points are
    the outline of the whole body, up to its length. [m]"""


class SphereNose(SolverPart[solver.Sphere]):
    """A ball: the whole body, whose length is its diameter."""

    model_config = with_examples(SPHERE)

    shape: Literal["sphere"]


class BoatTail(SolverPart[solver.BoatTail]):
    """Cone behind the shank, narrower towards the base."""

    model_config = with_examples(BOAT_TAIL)

    length_m: Annotated[Num, Field(**within("projectile.boat_tail.length"))]
    """Part of the length of the projectile that tapers, at most what is behind the nose. [m]"""
    base_diameter_m: Annotated[Num, Field(**within("projectile.boat_tail.base_diameter"))]
    """Diameter of the flat base, at most that of the shank. [m]"""


Nose = TypeAliasType(
    "Nose",
    Annotated[
        OgiveNose | ConicalNose | SphericalNose | FlatNose | ProfileNose | SphereNose,
        Field(discriminator="shape", description="Shape of the nose, or of the whole body."),
    ],
)


class Projectile(SolverPart[solver.Projectile]):
    """A rigid body of revolution: a nose and a cylindrical shank with a flat base, or a body that tapers behind."""

    model_config = with_examples(PROJECTILE, PROJECTILE | {"nose": PROFILE}, PROJECTILE | {"boat_tail": BOAT_TAIL})

    nose: Nose
    diameter_m: Annotated[Num, Field(**within("projectile.diameter"))]
    """Diameter of the shank. [m] A pellet to far above any gun or bomb."""
    length_m: Annotated[Num, Field(**within("projectile.length"))]
    """From the nose tip to the base, at least the length of the nose. [m]"""
    mass_kg: Annotated[Num, Field(**within("projectile.mass"))]
    """[kg] At most that of uranium 5 m wide and 20 m long."""
    center_of_gravity_m: Annotated[Num, Field(**within("projectile.center_of_gravity"))] | MISSING = MISSING
    """Distance behind the nose tip, less than the length; that of the homogeneous solid of the outer shape when not
    given. [m]"""
    moment_of_inertia_kg_m2: Annotated[Num, Field(**within("projectile.moment_of_inertia"))] | MISSING = MISSING
    """About a transverse axis through the centre of gravity; that of the homogeneous solid of the outer shape when not
    given. [kg m²]"""
    boat_tail: BoatTail | MISSING = MISSING
    """Taper behind the shank; a cylinder up to the base when not given."""


TARGET = {"compressive_strength_pa": PAPER_TARGET.compressive_strength, "density_kg_m3": PAPER_TARGET.density}
STRIKE = {"velocity_m_s": PAPER_VELOCITY}


class Target(SolverPart[solver.Target]):
    """Concrete: a half-space, or a wall of a thickness."""

    model_config = with_examples(TARGET, TARGET | {"youngs_modulus_pa": 29.5e9, "poissons_ratio": 0.2})

    compressive_strength_pa: Annotated[Num, Field(**within("target.compressive_strength"))]
    """Unconfined compressive strength. [Pa] From the weakest foam to above any concrete; the tests behind the model
    used 13 to 97 MPa."""
    density_kg_m3: Annotated[Num, Field(**within("target.density"))]
    """[kg/m³] From foam to above any heavy concrete."""
    youngs_modulus_pa: Annotated[Num, Field(**within("target.youngs_modulus"))] | MISSING = MISSING
    """Taken from the strength by ACI 318-19, 4700 MPa times the square root of the strength in MPa, when not given.
    [Pa]"""
    poissons_ratio: Annotated[Num, Field(**within("target.poissons_ratio"))] = PAPER_TARGET.poissons_ratio
    """0.5 is an incompressible solid. [1]"""
    thickness_m: Annotated[Num, Field(**within("target.thickness"))] | MISSING = MISSING
    """Thickness of a wall, at least a tenth of the diameter of the projectile; a half-space when not given. [m]"""
    characteristic_strength_pa: Annotated[Num, Field(**within("target.characteristic_strength"))] | MISSING = MISSING
    """Strength that 95 % of the concrete has, as of a strength class. Design values of walls rest on it where it is
    given; all else takes `compressive_strength_pa`, which is the mean. [Pa]"""
    reinforcement_ratio_percent: Annotated[Num, Field(**within("target.reinforcement_ratio_percent"))] | MISSING = (
        MISSING
    )
    """Reinforcement, steel over concrete each way and each face. Neither the model nor a formula here takes it: it
    changes nothing, and a ratio above 0 brings the warning `reinforcement_not_counted`. [%]"""


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

    velocity_m_s: Annotated[Num, Field(**within("impact.velocity"))]
    """Speed of the centre of gravity. [m/s] Bodies stay rigid up to some 800 m/s."""
    angle_of_attack_deg: AngleOfAttack = 0.0
    angular_velocity_rad_s: AngularVelocity = 0.0

    def arguments(self) -> dict[str, float]:
        """Return what the solver calls these."""
        return {
            "velocity": self.velocity_m_s,
            "angle_of_attack": math.radians(self.angle_of_attack_deg),
            "angular_velocity": self.angular_velocity_rad_s,
        }


class Impact(Strike, SolverPart[solver.Impact]):
    """The motion at first contact."""

    model_config = with_examples(STRIKE | {"oblique_angle_deg": 45.0})

    oblique_angle_deg: ObliqueAngle


class Approach(Part):
    """The motion at first contact but for the speed."""

    model_config = with_examples({"oblique_angle_deg": 20.0})

    oblique_angle_deg: ObliqueAngle
    angle_of_attack_deg: AngleOfAttack = 0.0
    angular_velocity_rad_s: AngularVelocity = 0.0

    def arguments(self) -> dict[str, float]:
        """Return what the solver calls these."""
        return solver_arguments(self)


# The paper's strike and others, the examples of the contract: a test sends each to a running service.
PAPER: dict[str, Any] = {"projectile": PROJECTILE, "target": TARGET, "impact": STRIKE}
PAPER_AT_45 = PAPER | {"impact": STRIKE | {"oblique_angle_deg": 45.0}}
PAPER_BY_SECANT = PAPER | {"search": {"method": "secant"}, "numerics": {"panels": 3000}}

TRUNCATED_CONE = {
    "projectile": PROJECTILE | {"nose": PROFILE, "center_of_gravity_m": 0.29, "moment_of_inertia_kg_m2": 0.25},
    "target": TARGET | {"youngs_modulus_pa": 29.5e9, "poissons_ratio": 0.2},
    "impact": {"velocity_m_s": 300.0, "oblique_angle_deg": 60.0, "angle_of_attack_deg": -1.0},
    "resistance": {"strength_factor": CONSTANT, "free_surface": MOHR_COULOMB},
    "numerics": {"method": "panels", "panels": 3000, "time_step_s": 2e-5, "termination_time_s": 0.01},
    "output": {"history": True, "sample_interval_s": 1e-4},
}
HEMISPHERE = PAPER | {
    "projectile": PROJECTILE | {"nose": SPHERICAL},
    "resistance": {"strength_factor": {"model": "strength_power_law"}, "free_surface": {"model": "none"}},
    "search": {"lower_deg": 30.0, "upper_deg": 80.0, "tolerance_deg": 0.1},
    "output": {"history": True, "sample_interval_s": 1e-4},
}
