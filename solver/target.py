"""Target: strength, density and elastic constants of its concrete, and the crater and the plug that break out of it."""

import math
from dataclasses import dataclass, fields

from solver.checks import require, require_bounds

# A plug as high as the wall would leave no resistance, and the slowest body would perforate. With a tenth of the wall
# left, the paper's body perforates a wall of 50 mm from 33 m/s on; the CEA-EDF formula gives 18 m/s, and the model
# without a plug 86 m/s.
MOST_PLUG = 0.9
"""Largest height of a plug, relative to the thickness of the wall. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Concrete target, a half-space or a wall.

    Parameters
    ----------
    compressive_strength
        Unconfined compressive strength f'c. Its bounds include every concrete from foam concrete up; the tests behind
        the model used 13 to 97 MPa. [Pa]
    density
        Density. Its bounds include every concrete from foam to heavy concrete. [kg/m³]
    youngs_modulus
        Young's modulus; when not given, 4700 MPa times the square root of the strength in MPa (ACI 318-19). [Pa]
    poissons_ratio
        Poisson's ratio. The decay theory of Warren et al. starts from an incompressible solid, 0.5. [1]
    thickness
        Thickness of a wall, at least a tenth of the diameter of the projectile; a half-space when not given. [m]
    characteristic_strength
        Strength that 95 % of the concrete exceeds, as in the name of a strength class. If it is given, design values of
        walls use it; everything else uses the compressive strength, which is the mean. [Pa]
    reinforcement_ratio_percent
        Area of steel divided by area of concrete, in each direction at each face. Neither the model nor any formula
        uses it: answers are for plain concrete, with a warning. [%]

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
    characteristic_strength: float | None = None
    reinforcement_ratio_percent: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None or field.default is not None:  # only fields that are None by default may be None
                require_bounds(f"target.{field.name}", value)

    @property
    def elastic_modulus(self) -> float:
        """Young's modulus in use: as given, or else by `concrete_youngs_modulus`. [Pa]"""
        if self.youngs_modulus is not None:
            return self.youngs_modulus
        return concrete_youngs_modulus(compressive_strength=self.compressive_strength)


def concrete_youngs_modulus(*, compressive_strength: float) -> float:
    """Estimate Young's modulus of normal-weight concrete from its compressive strength.

    Parameters
    ----------
    compressive_strength
        Unconfined compressive strength. [Pa]

    Returns
    -------
    float
        Young's modulus. [Pa]

    Notes
    -----
    ACI 318-19, 19.2.2.1: 4700 MPa times the square root of the strength in MPa.
    """
    return 4700e6 * math.sqrt(compressive_strength / 1e6)


@dataclass(frozen=True, slots=True, kw_only=True)
class Crater:
    """Front crater, in which the resistance builds up with depth.

    Parameters
    ----------
    depth_diameters
        Depth of the crater divided by the diameter of the projectile. [1] Forrestal et al. (1994) use 2; Li and Chen
        (2003) use 0.707 plus the length of the nose divided by the diameter.

    Notes
    -----
    The forces of the cavity expansion are multiplied by ``min(x / (k d), 1)``, where ``x`` is the depth of the deepest
    point of the projectile and ``k d`` the depth of the crater. In both publications (Forrestal, Altman, Cargile and
    Hanchak 1994; Li and Chen 2003) the axial force is proportional to the depth alone, up to its value at the end of
    the crater. In this model it also depends on the velocity at each instant. Both publications are about normal
    impact; the effect of a crater on an oblique strike has not been tested.
    """

    depth_diameters: float = 2.0

    def __post_init__(self) -> None:
        # Published depths are 2 diameters, or the length of the nose plus 0.7 diameters. The bound is arbitrary,
        # but far above both, so it detects depths in a wrong unit.
        fits = math.isfinite(self.depth_diameters) and 0.0 < self.depth_diameters <= 20.0
        require(fits, "resistance.crater.depth_diameters", f"must be above 0, up to 20, got {self.depth_diameters:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ShearPlug:
    """Plug: a cone of concrete that shears out of the rear of a wall and no longer resists.

    Parameters
    ----------
    cone_angle
        Angle between the axis of the cone and its side. [rad]

    Notes
    -----
    At the height h, a quasi-static force S f'c on the cross-section shears the cone off at a stress of (S / S_ref) f'c
    / √3: ``h / d = (√(1 + √3 S_ref tan α) - 1) / (2 tan α)``, as in Li and Tong (2003) and in Chen, Fan and Li (2004)
    for a shear strength of f'c / √3, with α = 66.1° from the tests of Dancygier (1998). S_ref is the median of the
    published tests for the concrete and the diameter, so the shear strength of a concrete is assumed proportional to
    its S. The plug takes up at most nine tenths of a wall. The inertial force, the obliquity, and the mass and energy
    of the plug are neglected; the decay near the rear face is kept.
    """

    cone_angle: float = math.radians(66.1)

    def __post_init__(self) -> None:
        # Near the ends of the accepted range the cone is almost a cylinder or a disc, for which the formula is not
        # meant; both ends are arbitrary. The margin allows for the conversion between degrees and radians.
        degrees = math.degrees(self.cone_angle)
        fits = math.isfinite(degrees) and 10.0 - 1e-9 <= degrees <= 85.0 + 1e-9
        require(fits, "resistance.rear_plug.cone_angle", f"must be 10° to 85°, got {degrees:g}°")

    def height(self, *, strength_factor: float, diameter: float) -> float:
        """Return the height of the plug in a wall of unlimited thickness; `strength_factor` is S_ref. [m]"""
        slope = math.tan(self.cone_angle)
        return diameter * (math.sqrt(1.0 + math.sqrt(3.0) * strength_factor * slope) - 1.0) / (2.0 * slope)
