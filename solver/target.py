"""The concrete: strength, density and elastic constants."""

import math
from dataclasses import dataclass

from solver.validation import require_between, require_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Concrete, a half-space or a wall.

    Parameters
    ----------
    compressive_strength
        Unconfined compressive strength f'c. [Pa]
    density
        [kg/m³]
    youngs_modulus
        Taken from the strength by `concrete_youngs_modulus` when not given. [Pa]
    poissons_ratio
        0.5 is the incompressible solid that the decay theory of Warren et al. starts from. [1]
    thickness
        Of a wall; a half-space unless given. At least a tenth of the projectile's diameter. [m]

    Raises
    ------
    ParameterError
        If a value is not finite or outside its physical range.
    """

    compressive_strength: float
    density: float
    youngs_modulus: float | None = None
    poissons_ratio: float = 0.5
    thickness: float | None = None

    def __post_init__(self) -> None:
        require_positive("target.compressive_strength", self.compressive_strength)
        require_positive("target.density", self.density)
        if self.youngs_modulus is not None:
            require_positive("target.youngs_modulus", self.youngs_modulus)
        require_between("target.poissons_ratio", self.poissons_ratio, 0.0, 0.5)
        if self.thickness is not None:
            require_positive("target.thickness", self.thickness)

    @property
    def elastic_modulus(self) -> float:
        """Young's modulus in use: the one given, or the correlation's. [Pa]"""
        if self.youngs_modulus is not None:
            return self.youngs_modulus
        return concrete_youngs_modulus(compressive_strength=self.compressive_strength)


def concrete_youngs_modulus(*, compressive_strength: float) -> float:
    """Young's modulus of normal-weight concrete from its compressive strength.

    Parameters
    ----------
    compressive_strength
        [Pa]

    Returns
    -------
    float
        [Pa]

    Notes
    -----
    ACI 318-19, 19.2.2.1: 4700 MPa times the square root of the strength in MPa.
    """
    return 4700e6 * math.sqrt(compressive_strength / 1e6)
