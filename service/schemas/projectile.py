"""The projectile as the contract has it."""

from typing import Annotated, Literal

from pydantic import MISSING, Field
from typing_extensions import TypeAliasType

import solver
from service.schemas.quantities import Num, Part, with_examples, within
from solver.strike import PAPER_PROJECTILE

OGIVE = {"shape": "ogive", "caliber_radius_head": 3.0}
CONICAL = {"shape": "conical", "length_to_diameter": 1.5}
SPHERICAL = {"shape": "spherical", "caliber_radius_head": 0.5}
FLAT = {"shape": "flat"}
PROFILE = {"shape": "profile", "points": [[0.0, 0.01], [0.06, 0.03], [0.12, 0.04]]}
"""A truncated cone and a second, more slender one, for a shank of 80 mm."""

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
Coordinate = Annotated[Num, Field(ge=0.0, le=20.0)]
ProfilePoint = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]


class OgiveNose(Part):
    """Tangent ogive."""

    model_config = with_examples(OGIVE)

    shape: Literal["ogive"]
    caliber_radius_head: CaliberRadiusHead

    def to_solver(self) -> solver.Ogive:
        """Return the solver's ogive."""
        return solver.Ogive(caliber_radius_head=self.caliber_radius_head)


class ConicalNose(Part):
    """Cone."""

    model_config = with_examples(CONICAL)

    shape: Literal["conical"]
    length_to_diameter: Annotated[
        Num,
        Field(
            **within("projectile.nose.length_to_diameter"),
            description="Height of the cone over the shank diameter. [1]",
        ),
    ]

    def to_solver(self) -> solver.Conical:
        """Return the solver's cone."""
        return solver.Conical(length_to_diameter=self.length_to_diameter)


class SphericalNose(Part):
    """Spherical cap."""

    model_config = with_examples(SPHERICAL)

    shape: Literal["spherical"]
    caliber_radius_head: CaliberRadiusHead

    def to_solver(self) -> solver.Spherical:
        """Return the solver's spherical cap."""
        return solver.Spherical(caliber_radius_head=self.caliber_radius_head)


class FlatNose(Part):
    """Flat face: the shank cut square."""

    model_config = with_examples(FLAT)

    shape: Literal["flat"]

    def to_solver(self) -> solver.Flat:
        """Return the solver's flat face."""
        return solver.Flat()


class ProfileNose(Part):
    """Convex chain of cones through points; a first radius above zero makes a flat face."""

    model_config = with_examples(PROFILE)

    shape: Literal["profile"]
    points: Annotated[
        list[ProfilePoint],
        Field(
            min_length=2,
            max_length=1000,
            description="[x, r] from the tip: x, the distance behind it, from 0; r, the distance from the axis, up to "
            "the radius of the shank. Neither may decrease, and the slope may not increase. [m]",
        ),
    ]

    def to_solver(self) -> solver.Profile:
        """Return the solver's profile."""
        return solver.Profile(points=tuple((x, r) for x, r in self.points))


Nose = TypeAliasType(
    "Nose",
    Annotated[
        OgiveNose | ConicalNose | SphericalNose | FlatNose | ProfileNose,
        Field(discriminator="shape", description="Shape of the nose."),
    ],
)


class Projectile(Part):
    """A rigid body of revolution: a nose and a cylindrical shank with a flat base."""

    model_config = with_examples(PROJECTILE, PROJECTILE | {"nose": PROFILE})

    nose: Nose
    diameter_m: Annotated[
        Num,
        Field(
            **within("projectile.diameter"),
            description="Diameter of the shank. [m] A pellet to far above any gun or bomb.",
        ),
    ]
    length_m: Annotated[
        Num,
        Field(
            **within("projectile.length"),
            description="From the nose tip to the base, at least the length of the nose. [m]",
        ),
    ]
    mass_kg: Annotated[Num, Field(**within("projectile.mass"), description="[kg] Up to 5 m by 20 m of uranium.")]
    center_of_gravity_m: (
        Annotated[
            Num,
            Field(
                **within("projectile.center_of_gravity"),
                description="Distance behind the nose tip, less than the length; that of the homogeneous solid of the "
                "outer shape when not given. [m]",
            ),
        ]
        | MISSING
    ) = MISSING
    moment_of_inertia_kg_m2: (
        Annotated[
            Num,
            Field(
                **within("projectile.moment_of_inertia"),
                description="About a transverse axis through the centre of gravity; that of the homogeneous solid of "
                "the outer shape when not given. [kg m²]",
            ),
        ]
        | MISSING
    ) = MISSING

    def to_solver(self) -> solver.Projectile:
        """Return the solver's projectile."""
        center, inertia = self.center_of_gravity_m, self.moment_of_inertia_kg_m2
        return solver.Projectile(
            nose=self.nose.to_solver(),
            diameter=self.diameter_m,
            length=self.length_m,
            mass=self.mass_kg,
            center_of_gravity=None if center is MISSING else center,
            moment_of_inertia=None if inertia is MISSING else inertia,
        )
