"""Oblique impact of rigid projectiles on concrete: motion and critical ricochet angle, in SI units and radians.

    projectile = Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.08, length=0.53, mass=13.0)
    target = Target(compressive_strength=39e6, density=2250.0)
    found = critical_angle(projectile=projectile, target=target, velocity=238.0)
    math.degrees(found.angle)

simulate, simulate_many                motion of one strike or of many
critical_angle, critical_angle_many    smallest oblique angle at which a projectile is turned away
critical_angle_sweep                   critical angle over a grid of speeds, strengths, noses or laws
least_thickness, limit_velocity        thinnest wall that is not perforated, lowest speed that perforates a wall
formulas                               empirical formulas for penetration, scabbing and perforation
flight, flight_after                   flight of a body that has left the target, and its landing
solver.uncertainty.verdict             assessment of a strike in one sentence, with the range of the critical angle
solver.calibration                     strength factors from depths and motions
warm_up                                compile the whole solver in advance: a minute, once for each installation

Angles are measured from the inward normal of the face: 0 is a head-on strike. Physical quantities are keyword-only
arguments.
"""

from solver.bending import Bending, BendingHistory
from solver.cancellation import Cancellation, CancelledError
from solver.checks import IntegrationError, ParameterError, RicochetError, StepLimitError, name_keywords
from solver.flight import Flight, FlightConditions, flight, flight_after, launch_elevation, mean_projected_area
from solver.formulas import FormulaResult, OutOfRange, cea_edf_limit_speed, formulas
from solver.free_surface import ElasticPlastic, MohrCoulomb, NoFreeSurface, decay_factor
from solver.many import (
    columns,
    critical_angle_many,
    least_thickness_many,
    limit_velocity_many,
    simulate_many,
    to_dataframe,
)
from solver.perforation import (
    PerforationLimit,
    PerforationStatus,
    PerforationTrial,
    least_thickness,
    limit_velocity,
)
from solver.prepared import Exit, Outcome, Protrusion
from solver.projectile import (
    BoatTail,
    Conical,
    Flat,
    MassProperties,
    Ogive,
    Profile,
    Projectile,
    SolidProperties,
    Sphere,
    Spherical,
    mass_properties,
    solid_properties,
)
from solver.resistance import (
    ConstantStrengthFactor,
    ObliquityPolynomial,
    OwnTests,
    PublishedTests,
    Resistance,
    Shot,
    StrengthPosterior,
    StrengthPowerLaw,
    closed_form_depth,
    strength_factor,
    strength_factor_of_depth,
)
from solver.search.critical_angle import critical_angle
from solver.search.types import CriticalAngle, OutcomeInterval, Search, SearchStatus, Trial
from solver.strike import Impact, Numerics
from solver.sweeps import Alternative, alternative_resistances, alternatives, critical_angle_sweep, simulate_sweep
from solver.target import Crater, ShearPlug, Target, concrete_youngs_modulus
from solver.trajectory import Motion, Trajectory, simulate
from solver.warm_up import warm_up
from solver.warnings import ModelWarning

# Raise this version whenever any part of a result changes, including the text of a warning.
ENGINE_VERSION = "17"
"""Version of the results of this package; cached results of another version are not used."""

__all__ = [
    "ENGINE_VERSION",
    "Alternative",
    "Bending",
    "BendingHistory",
    "BoatTail",
    "Cancellation",
    "CancelledError",
    "Conical",
    "ConstantStrengthFactor",
    "Crater",
    "CriticalAngle",
    "ElasticPlastic",
    "Exit",
    "Flat",
    "Flight",
    "FlightConditions",
    "FormulaResult",
    "Impact",
    "IntegrationError",
    "MassProperties",
    "ModelWarning",
    "MohrCoulomb",
    "Motion",
    "NoFreeSurface",
    "Numerics",
    "ObliquityPolynomial",
    "Ogive",
    "OutOfRange",
    "Outcome",
    "OutcomeInterval",
    "OwnTests",
    "ParameterError",
    "PerforationLimit",
    "PerforationStatus",
    "PerforationTrial",
    "Profile",
    "Projectile",
    "Protrusion",
    "PublishedTests",
    "Resistance",
    "RicochetError",
    "Search",
    "SearchStatus",
    "ShearPlug",
    "Shot",
    "SolidProperties",
    "Sphere",
    "Spherical",
    "StepLimitError",
    "StrengthPosterior",
    "StrengthPowerLaw",
    "Target",
    "Trajectory",
    "Trial",
    "alternative_resistances",
    "alternatives",
    "cea_edf_limit_speed",
    "closed_form_depth",
    "columns",
    "concrete_youngs_modulus",
    "critical_angle",
    "critical_angle_many",
    "critical_angle_sweep",
    "decay_factor",
    "flight",
    "flight_after",
    "formulas",
    "launch_elevation",
    "least_thickness",
    "least_thickness_many",
    "limit_velocity",
    "limit_velocity_many",
    "mass_properties",
    "mean_projected_area",
    "simulate",
    "simulate_many",
    "simulate_sweep",
    "solid_properties",
    "strength_factor",
    "strength_factor_of_depth",
    "to_dataframe",
    "warm_up",
]

name_keywords(globals())
