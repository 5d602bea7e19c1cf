"""What the calibrations have in common."""

from typing import Annotated, Any

from pydantic import MISSING, Field

import solver
from service.schemas.projectile import Projectile
from service.schemas.quantities import Num, Part, with_examples
from service.schemas.resistance import MOHR_COULOMB, Decay, InertiaFactor
from service.schemas.strike import Target
from solver.calibration import Estimate

MOST_COMPARED = 20

StrengthFactorValue = Annotated[
    Num, Field(ge=0.1, le=1000.0, description="[1] Measured ones lie between some 5 and 25.")
]
StandardError = Annotated[Num, Field(ge=0.0, description="Standard error of the strength factor. [1]")]
ConfidenceInterval = Annotated[
    list[Num],
    Field(
        min_length=2,
        max_length=2,
        description="Lower and upper end, at the requested confidence level, by Student's distribution. [1]",
    ),
]
Residuals = Annotated[list[Num], Field(description="Given minus predicted, in the order of the request.")]


class CalibrationResistance(Part):
    """How the target resists, but for the strength factor, which is sought."""

    model_config = with_examples({"inertia_factor": 0.9, "free_surface": MOHR_COULOMB})

    inertia_factor: InertiaFactor = 1.0
    free_surface: Decay

    def to_solver(self) -> solver.Resistance:
        """Return the solver's resistance; its strength factor is not used."""
        return solver.Resistance(inertia_factor=self.inertia_factor, free_surface=self.free_surface.to_solver())


class Calibration(Part):
    """What fits of the model have in common."""

    projectile: Projectile
    target: Target
    resistance: Annotated[CalibrationResistance, Field(default_factory=CalibrationResistance)]
    confidence_level: Annotated[
        Num, Field(ge=0.5, le=0.9999, description="Chance that the interval holds the strength factor. [1]")
    ] = 0.95
    compare_strength_factors: (
        Annotated[
            list[StrengthFactorValue],
            Field(
                min_length=1,
                max_length=MOST_COMPARED,
                description="Asks what the model predicts with these as well. [1]",
            ),
        ]
        | MISSING
    ) = MISSING

    def canonical(self) -> dict[str, Any]:
        """Return the request as JSON data, defaults filled in."""
        return self.model_dump(mode="json")

    def model_arguments(self) -> dict[str, Any]:
        """Return the arguments that all functions of the solver take that run the model."""
        return {
            "projectile": self.projectile.to_solver(),
            "target": self.target.to_solver(),
            "resistance": self.resistance.to_solver(),
        }

    def compared(self) -> tuple[float, ...]:
        """Return the strength factors to compare."""
        return () if self.compare_strength_factors is MISSING else tuple(self.compare_strength_factors)


class FittedStrength(Part):
    """A strength factor and how well it is known."""

    strength_factor: Annotated[Num, Field(gt=0.0, description="That fits best. [1]")]
    standard_error: StandardError
    confidence_interval: ConfidenceInterval


def estimate_told(estimate: Estimate) -> dict[str, Any]:
    """Return an estimate as the contract has it."""
    return {
        "strength_factor": estimate.strength_factor,
        "standard_error": estimate.standard_error,
        "confidence_interval": list(estimate.confidence_interval),
    }
