"""Models of the resistance of the target: strength factor, decay near a face, crater and plug."""

import math
from collections.abc import Mapping
from enum import StrEnum
from functools import partial
from typing import Annotated, Literal, TypeAlias, get_args

from pydantic import MISSING, Field
from typing_extensions import TypeAliasType

import solver
from service.schemas.quantities import Flag, Num, Part, SolverPart, with_examples, within
from solver.free_surface import FreeSurface as SolverFreeSurface
from solver.free_surface import decay_laws
from solver.resistance import MOST_SHOTS

POLYNOMIAL = solver.ObliquityPolynomial()
POWER_LAW = solver.StrengthPowerLaw()
CONSTANT = {"model": "constant", "value": 8.52}
OBLIQUITY = {"model": "obliquity_polynomial", "coefficients": list(POLYNOMIAL.coefficients)}
UNCERTAIN = OBLIQUITY | {
    "covariance": [[0.0494, -0.00364, 5.78e-05], [-0.00364, 0.000566, -1.156e-05], [5.78e-05, -1.156e-05, 2.569e-07]]
}
STRENGTH = {"model": "strength_power_law", "coefficient": 72.0, "exponent": -0.5}
STRENGTH_AND_DIAMETER = {
    "model": "strength_power_law",
    "coefficient": 8.84,
    "exponent": -0.18,
    "reference_strength_pa": 39e6,
    "diameter_exponent": -0.24,
    "reference_diameter_m": 0.0762,
    "obliquity_shape": "equation_9",
}
PUBLISHED = {"model": "published_tests"}
SHOT = {"velocity_m_s": 238.1, "depth_m": 0.30, "mass_kg": 12.923}
OWN_TESTS = {"model": "own_tests", "shots": [SHOT]}
MOHR_COULOMB = {"model": "mohr_coulomb", "inertia": True}

LARGEST_COEFFICIENT = 1e6
"""Largest magnitude of a coefficient of the polynomial of S, an arbitrary choice. The coefficients of the paper are at
most 8.5; the bound only keeps products finite."""

Coefficient = Annotated[Num, Field(ge=-LARGEST_COEFFICIENT, le=LARGEST_COEFFICIENT)]
CovarianceRow = Annotated[list[Coefficient], Field(min_length=1, max_length=10)]
CovarianceMatrix = Annotated[
    list[CovarianceRow],
    Field(
        min_length=1,
        max_length=10,
        description="Covariance matrix of the coefficients, symmetric and positive semidefinite. With it the critical "
        "angle has a standard error. [1, 1/°, 1/°², ... times the same]",
    ),
]


class ConstantStrengthFactor(SolverPart[solver.ConstantStrengthFactor]):
    """Strength factor that is the same at every oblique angle."""

    model_config = with_examples(CONSTANT)

    model: Literal["constant"]
    # Most measured values lie between 5 and 25. The bound is an arbitrary choice that excludes a strength in Pa.
    value: Annotated[Num, Field(gt=0.0, le=1000.0)]


class ObliquityPolynomial(SolverPart[solver.ObliquityPolynomial]):
    """Polynomial in the initial oblique angle in degrees. It must be positive at every angle of the request."""

    model_config = with_examples(OBLIQUITY, UNCERTAIN, OBLIQUITY | {"held_from_deg": 55.0})

    model: Literal["obliquity_polynomial"]
    coefficients: Annotated[
        list[Coefficient],
        Field(
            min_length=1,
            max_length=10,
            default_factory=partial(list, POLYNOMIAL.coefficients),
            description="Coefficients from the constant term upwards. The default, fitted to finite element runs from "
            f"0° to 45°, is {list(POLYNOMIAL.coefficients)}. [1, 1/°, 1/°², ...]",
        ),
    ]
    covariance: CovarianceMatrix | MISSING = MISSING
    held_from_deg: Annotated[Num, Field(ge=0.0, le=90.0)] | MISSING = MISSING


class ObliquityShape(StrEnum):
    """Change of the strength factor with the oblique angle.

    `constant` means no change, `equation_9` is S(θ)/S(0) of the default polynomial, constant from 60° on, and
    `finite_elements` is the fit to finite element motions with the decay law in use, constant from 55° on.
    """

    CONSTANT = "constant"
    EQUATION_9 = "equation_9"
    FINITE_ELEMENTS = "finite_elements"


class StrengthPowerLaw(SolverPart[solver.StrengthPowerLaw]):
    """Power law of the compressive strength and, optionally, of the diameter.

    `coefficient * (strength / reference_strength_pa)^exponent * (diameter / reference_diameter_m)^diameter_exponent`
    """

    model_config = with_examples({"model": "strength_power_law"}, STRENGTH, STRENGTH_AND_DIAMETER)

    model: Literal["strength_power_law"]
    # The bounds are arbitrary choices that only keep powers finite: published exponents lie within ±1.
    coefficient: Annotated[Num, Field(gt=0.0, le=1e6)] = POWER_LAW.coefficient
    exponent: Annotated[Num, Field(ge=-10.0, le=10.0)] = POWER_LAW.exponent
    reference_strength_pa: Annotated[Num, Field(ge=1e5, le=1e9)] = POWER_LAW.reference_strength
    diameter_exponent: Annotated[Num, Field(ge=-10.0, le=10.0)] = POWER_LAW.diameter_exponent
    reference_diameter_m: Annotated[Num, Field(ge=1e-4, le=100.0)] = POWER_LAW.reference_diameter
    obliquity_shape: ObliquityShape = ObliquityShape.CONSTANT


class PublishedTests(SolverPart[solver.PublishedTests]):
    """Power law fitted to 251 published penetration tests: 8.84 (f'c / 39 MPa)^-0.18 (d / 76.2 mm)^-0.24.

    The tests are normal impacts of projectiles of 9.9 to 203 mm at 67 to 897 m/s, concrete of 13 to 108 MPa. The S of
    an untested concrete scatters about this law: ln S has Student's distribution with a scale of 0.27 and 3 degrees of
    freedom.
    """

    model_config = with_examples(PUBLISHED, PUBLISHED | {"obliquity_shape": "constant"})

    model: Literal["published_tests"]
    obliquity_shape: ObliquityShape = ObliquityShape.EQUATION_9


class OwnShot(SolverPart[solver.Shot]):
    """A shot in normal impact into the concrete in question, which was thick enough to stop it."""

    model_config = with_examples(SHOT)

    velocity_m_s: Annotated[Num, Field(**within("impact.velocity"))]
    depth_m: Annotated[Num, Field(**within("shot.depth"))]
    mass_kg: Annotated[Num, Field(**within("projectile.mass"))] | MISSING = MISSING
    diameter_m: Annotated[Num, Field(**within("projectile.diameter"))] | MISSING = MISSING


class OwnTests(SolverPart[solver.OwnTests]):
    """Posterior median of S after the user's own shots into the concrete, with the published tests as the prior."""

    model_config = with_examples(OWN_TESTS)

    model: Literal["own_tests"]
    shots: Annotated[list[OwnShot], Field(min_length=1, max_length=MOST_SHOTS, fail_fast=True)]
    obliquity_shape: ObliquityShape = ObliquityShape.EQUATION_9


class StrengthLaw(StrEnum):
    """Strength factor models that have default constants."""

    OBLIQUITY_POLYNOMIAL = "obliquity_polynomial"
    PUBLISHED_TESTS = "published_tests"
    STRENGTH_POWER_LAW = "strength_power_law"


AnyStrengthFactor: TypeAlias = (
    ConstantStrengthFactor | ObliquityPolynomial | StrengthPowerLaw | PublishedTests | OwnTests
)
StrengthFactor = TypeAliasType(
    "StrengthFactor",
    Annotated[AnyStrengthFactor, Field(discriminator="model", description="Model of the strength factor.")],
)
STRENGTH_FACTORS: Mapping[str, type[Part]] = {
    name: model for model in get_args(AnyStrengthFactor) for name in get_args(model.model_fields["model"].annotation)
}
"""Models of the strength factor, keyed by name."""


class FreeSurfaceModel(StrEnum):
    """Law by which a nearby face weakens the resistance; `none` means no decay."""

    ELASTIC_PLASTIC = "elastic_plastic"
    MOHR_COULOMB = "mohr_coulomb"
    NONE = "none"


class FreeSurface(SolverPart[SolverFreeSurface]):
    """Decay of the resistance near the face."""

    model_config = with_examples({"model": "elastic_plastic"}, MOHR_COULOMB, {"model": "none"})

    model: FreeSurfaceModel
    inertia: Flag = False
    """Include the inertia of the expanding solid. It has no effect on `none`."""

    def to_solver(self) -> SolverFreeSurface:
        """Return the decay law of the solver."""
        laws = {law.name: law for law in decay_laws(inertia=self.inertia)}
        return laws[self.model]


InertiaFactor = Annotated[Num, Field(ge=0.0, le=10.0)]
Decay = Annotated[
    FreeSurface,
    Field(
        default_factory=partial(FreeSurface, model=FreeSurfaceModel.ELASTIC_PLASTIC),
        description="Decay near the face. The default is `elastic_plastic` without inertia.",
    ),
]


CRATER = solver.Crater()
PLUG = solver.ShearPlug()


class Crater(SolverPart[solver.Crater]):
    """Front crater, within which all forces grow in proportion to the depth (Forrestal et al. 1994)."""

    model_config = with_examples({"depth_diameters": 2.0})

    # The bounds are the same as in the solver.
    depth_diameters: Annotated[Num, Field(gt=0.0, le=20.0)] = CRATER.depth_diameters


class ShearPlug(SolverPart[solver.ShearPlug]):
    """Conical plug that shears out of the rear of a wall and then offers no resistance (Li and Tong 2003)."""

    model_config = with_examples({"cone_angle_deg": 66.1})

    # The bounds are the same as in the solver.
    cone_angle_deg: Annotated[Num, Field(ge=10.0, le=85.0)] = round(math.degrees(PLUG.cone_angle), 9)


class Resistance(SolverPart[solver.Resistance]):
    """Resistance of the target."""

    model_config = with_examples(
        {"strength_factor": CONSTANT},
        {"inertia_factor": 0.9, "free_surface": MOHR_COULOMB},
        {"crater": {"depth_diameters": 2.0}, "rear_plug": {"cone_angle_deg": 66.1}},
    )

    strength_factor: Annotated[
        StrengthFactor, Field(default_factory=partial(ObliquityPolynomial, model="obliquity_polynomial"))
    ]
    """Factor on the compressive strength. The default is `obliquity_polynomial`."""
    inertia_factor: InertiaFactor = 1.0
    free_surface: Decay
    crater: Crater | MISSING = MISSING
    rear_plug: ShearPlug | MISSING = MISSING
