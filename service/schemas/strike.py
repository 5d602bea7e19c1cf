"""Models of a strike: projectile, target and motion at first contact. The examples of the contract are here too."""

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
"""Nose of two truncated cones, the second more slender, for a shank of 80 mm."""

BOAT_TAIL = {"length_m": 0.08, "base_diameter_m": 0.06}

PROJECTILE = {
    "nose": OGIVE,
    "diameter_m": PAPER_PROJECTILE.diameter,
    "length_m": PAPER_PROJECTILE.length,
    "mass_kg": PAPER_PROJECTILE.mass,
}

CaliberRadiusHead = Annotated[Num, Field(**within("projectile.nose.caliber_radius_head"))]
Coordinate = Annotated[Num, Field(ge=0.0, le=BOUNDS["projectile.length"].upper)]
ProfilePoint = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]


class OgiveNose(SolverPart[solver.Ogive]):
    """Tangent ogive: a circular arc that meets the shank without a corner."""

    model_config = with_examples(OGIVE)

    shape: Literal["ogive"]
    caliber_radius_head: CaliberRadiusHead


class ConicalNose(SolverPart[solver.Conical]):
    """Cone from the tip to the shank."""

    model_config = with_examples(CONICAL)

    shape: Literal["conical"]
    length_to_diameter: Annotated[Num, Field(**within("projectile.nose.length_to_diameter"))]


class SphericalNose(SolverPart[solver.Spherical]):
    """Nose in the shape of a spherical cap, such as a hemisphere."""

    model_config = with_examples(SPHERICAL)

    shape: Literal["spherical"]
    caliber_radius_head: CaliberRadiusHead


class FlatNose(SolverPart[solver.Flat]):
    """Flat face of a shank that is cut square."""

    model_config = with_examples(FLAT)

    shape: Literal["flat"]


class ProfileNose(SolverPart[solver.Profile]):
    """Nose of truncated cones through the points of a convex outline. A first radius above zero makes a flat face."""

    model_config = with_examples(PROFILE)

    shape: Literal["profile"]
    # The bounds are the same as in the solver.
    points: Annotated[list[ProfilePoint], Field(min_length=2, max_length=1000)]
    """Points [x, r] of the outline: x is the distance behind the tip, from 0, and r the distance from the axis, up to
    the radius of the shank. x must not decrease, and the slope must not increase. If r decreases after its largest
    value, the points are the outline of the whole body, up to its length. [m]"""


class SphereNose(SolverPart[solver.Sphere]):
    """Sphere, which is the whole body, so its length is its diameter."""

    model_config = with_examples(SPHERE)

    shape: Literal["sphere"]


class BoatTail(SolverPart[solver.BoatTail]):
    """Cone behind the shank that narrows towards the base."""

    model_config = with_examples(BOAT_TAIL)

    length_m: Annotated[Num, Field(**within("projectile.boat_tail.length"))]
    base_diameter_m: Annotated[Num, Field(**within("projectile.boat_tail.base_diameter"))]


Nose = TypeAliasType(
    "Nose",
    Annotated[
        OgiveNose | ConicalNose | SphericalNose | FlatNose | ProfileNose | SphereNose,
        Field(discriminator="shape", description="Shape of the nose, or of the whole body."),
    ],
)


class Projectile(SolverPart[solver.Projectile]):
    """Rigid body of revolution: a nose and a cylindrical shank with a flat base, or a body that tapers behind."""

    model_config = with_examples(
        PROJECTILE,
        PROJECTILE | {"nose": PROFILE},
        PROJECTILE | {"boat_tail": BOAT_TAIL},
        PROJECTILE | {"inner_diameter_m": 0.05, "yield_strength_pa": 1.4e9},
    )

    nose: Nose
    diameter_m: Annotated[Num, Field(**within("projectile.diameter"))]
    length_m: Annotated[Num, Field(**within("projectile.length"))]
    mass_kg: Annotated[Num, Field(**within("projectile.mass"))]
    center_of_gravity_m: Annotated[Num, Field(**within("projectile.center_of_gravity"))] | MISSING = MISSING
    moment_of_inertia_kg_m2: Annotated[Num, Field(**within("projectile.moment_of_inertia"))] | MISSING = MISSING
    boat_tail: BoatTail | MISSING = MISSING
    inner_diameter_m: Annotated[Num, Field(**within("projectile.inner_diameter"))] | MISSING = MISSING
    yield_strength_pa: Annotated[Num, Field(**within("projectile.yield_strength"))] | MISSING = MISSING


TARGET = {"compressive_strength_pa": PAPER_TARGET.compressive_strength, "density_kg_m3": PAPER_TARGET.density}
STRIKE = {"velocity_m_s": PAPER_VELOCITY}


class Target(SolverPart[solver.Target]):
    """Concrete target: a half-space, or a wall if it has a thickness."""

    model_config = with_examples(TARGET, TARGET | {"youngs_modulus_pa": 29.5e9, "poissons_ratio": 0.2})

    compressive_strength_pa: Annotated[Num, Field(**within("target.compressive_strength"))]
    density_kg_m3: Annotated[Num, Field(**within("target.density"))]
    youngs_modulus_pa: Annotated[Num, Field(**within("target.youngs_modulus"))] | MISSING = MISSING
    poissons_ratio: Annotated[Num, Field(**within("target.poissons_ratio"))] = PAPER_TARGET.poissons_ratio
    thickness_m: Annotated[Num, Field(**within("target.thickness"))] | MISSING = MISSING
    characteristic_strength_pa: Annotated[Num, Field(**within("target.characteristic_strength"))] | MISSING = MISSING
    reinforcement_ratio_percent: Annotated[Num, Field(**within("target.reinforcement_ratio_percent"))] | MISSING = (
        MISSING
    )


AngleOfAttack = Annotated[Num, Field(ge=-90.0, le=90.0)]
AngularVelocity = Annotated[Num, Field(**within("impact.angular_velocity"))]
ObliqueAngle = Annotated[Num, Field(ge=0.0, lt=90.0)]


class Strike(Part):
    """Motion at first contact without the oblique angle."""

    solved = solver.Impact

    model_config = with_examples(STRIKE, STRIKE | {"angle_of_attack_deg": 1.5, "angular_velocity_rad_s": -4.0})

    velocity_m_s: Annotated[Num, Field(**within("impact.velocity"))]
    angle_of_attack_deg: AngleOfAttack = 0.0
    angular_velocity_rad_s: AngularVelocity = 0.0

    def arguments(self) -> dict[str, float]:
        """Return the fields as arguments of the solver."""
        return {
            "velocity": self.velocity_m_s,
            "angle_of_attack": math.radians(self.angle_of_attack_deg),
            "angular_velocity": self.angular_velocity_rad_s,
        }


class Impact(Strike, SolverPart[solver.Impact]):
    """Motion at first contact."""

    model_config = with_examples(STRIKE | {"oblique_angle_deg": 45.0})

    oblique_angle_deg: ObliqueAngle


class Approach(Part):
    """Motion at first contact without the speed."""

    solved = solver.Impact

    model_config = with_examples({"oblique_angle_deg": 20.0})

    oblique_angle_deg: ObliqueAngle
    angle_of_attack_deg: AngleOfAttack = 0.0
    angular_velocity_rad_s: AngularVelocity = 0.0

    def arguments(self) -> dict[str, float]:
        """Return the fields as arguments of the solver."""
        return solver_arguments(self)


# The following strikes, the paper's among them, are the examples of the contract. A test sends each to a service.
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
