"""Display names of terms of the contract, such as inputs and outcomes, for the page, reports and the command line.

The module imports the standard library only, because `ricochet --help` and shell completion load it.
"""

from collections.abc import Mapping
from typing import Final

CHOICES: Final[Mapping[str, Mapping[str, str]]] = {
    "projectile.nose.shape": {
        "ogive": "ogive",
        "conical": "cone",
        "spherical": "spherical cap",
        "flat": "flat",
        "profile": "profile",
        "sphere": "sphere",
    },
    "resistance.strength_factor.model": {
        "obliquity_polynomial": "polynomial in θ",
        "constant": "constant",
        "strength_power_law": "power of the strength",
        "published_tests": "published tests",
        "own_tests": "own depth tests",
    },
    "resistance.strength_factor.obliquity_shape": {
        "constant": "constant",
        "equation_9": "polynomial in θ",
        "finite_elements": "finite element motions",
    },
    "resistance.theory": {"elastic_plastic": "elastic-plastic", "mohr_coulomb": "Mohr-Coulomb"},
    "resistance.free_surface.model": {
        "elastic_plastic": "elastic-plastic",
        "mohr_coulomb": "Mohr-Coulomb",
        "none": "none",
    },
    "strength_scatter": {"law": "law, or own tests", "paper_table_1": "four tests of the paper"},
    "flight.incidence_plane": {"up": "up the face", "level": "level along the face", "down": "down the face"},
    "search.method": {
        "outcome": "change of outcome",
        "bisection": "bisection (paper)",
        "secant": "secant (paper)",
    },
    "numerics.method": {"adaptive": "adaptive", "panels": "panels (paper)"},
}
"""Display names of field values, keyed by the dotted path of the field and worded for the middle of a sentence."""
QUANTITIES: Final[Mapping[str, str]] = {
    "impact.velocity_m_s": "Speed",
    "impact.oblique_angle_deg": "Oblique angle",
    "impact.angle_of_attack_deg": "Angle of attack",
    "impact.angular_velocity_rad_s": "Angular velocity",
    "projectile.nose.shape": "Nose",
    "projectile.nose.caliber_radius_head": "Caliber radius head ψ",
    "projectile.nose.length_to_diameter": "Cone height over diameter",
    "projectile.nose.points": "Points x, r",
    "projectile.diameter_m": "Diameter",
    "projectile.length_m": "Length",
    "projectile.mass_kg": "Mass",
    "projectile.boat_tail.length_m": "Length of the boat-tail",
    "projectile.boat_tail.base_diameter_m": "Diameter of the base",
    "projectile.inner_diameter_m": "Diameter of the bore",
    "projectile.yield_strength_pa": "Yield strength of the body",
    "projectile.center_of_gravity_m": "Centre of gravity from tip",
    "projectile.moment_of_inertia_kg_m2": "Moment of inertia",
    "target.compressive_strength_pa": "Compressive strength",
    "target.density_kg_m3": "Density",
    "target.youngs_modulus_pa": "Young's modulus",
    "target.poissons_ratio": "Poisson's ratio",
    "target.thickness_m": "Thickness",
    "target.characteristic_strength_pa": "Characteristic strength",
    "target.reinforcement_ratio_percent": "Reinforcement each way and face",
    "resistance.strength_factor.model": "Strength factor",
    "resistance.strength_factor.shots": "Shots: speed, depth",
    "resistance.strength_factor.value": "Value of S",
    "resistance.strength_factor.coefficients": "Coefficients, θ in\N{NO-BREAK SPACE}°",
    "resistance.strength_factor.covariance": "Covariance",
    "resistance.strength_factor.held_from_deg": "S held from",
    "resistance.strength_factor.coefficient": "Coefficient",
    "resistance.strength_factor.exponent": "Strength exponent",
    "resistance.strength_factor.reference_strength_pa": "Reference strength",
    "resistance.strength_factor.diameter_exponent": "Diameter exponent",
    "resistance.strength_factor.reference_diameter_m": "Reference diameter",
    "resistance.strength_factor.obliquity_shape": "S over the angle",
    "resistance.strength_residual": "Factor on the strength factor",
    "resistance.theory": "Theory of the decay",
    "strength_scatter": "Scatter of S by",
    "resistance.inertia_factor": "Inertia factor",
    "resistance.free_surface.model": "Free surface",
    "resistance.free_surface.inertia": "Inertia of the solid",
    "resistance.crater.depth_diameters": "Crater depth over diameter",
    "resistance.rear_plug.cone_angle_deg": "Rear plug, angle of its cone",
    "flight.face_tilt_deg": "Tilt of the impact face",
    "flight.incidence_plane": "Plane of incidence",
    "flight.drag_coefficient": "Drag coefficient in flight",
    "flight.height_m": "Height of launch",
    "numerics.method": "Forces and steps",
    "numerics.termination_time_s": "Termination time",
    "numerics.relative_tolerance": "Relative tolerance",
    "numerics.retention_energy_fraction": "Least energy left",
    "search.method": "Search by",
    "search.lower_deg": "Range from",
    "search.upper_deg": "Range to",
    "search.tolerance_deg": "Width of the bracket",
    "search.relative_tolerance": "Relative tolerance",
    "sampling.half_width": "Half width",
    "sampling.max_samples": "Samples at most",
    "sampling.seed": "Seed",
}
"""Labels of the inputs, keyed by their dotted paths."""
ALIASES: Final[Mapping[str, tuple[str, ...]]] = {
    "impact.velocity_m_s": (
        "velocity",
        "speed",
        "impact_velocity",
        "impact_speed",
        "striking_velocity",
        "v",
        "v0",
        "vs",
    ),
    "impact.oblique_angle_deg": (
        "oblique_angle",
        "angle",
        "obliquity",
        "incidence",
        "angle_of_incidence",
        "impact_angle",
        "theta",
    ),
    "impact.angle_of_attack_deg": ("angle_of_attack", "attack", "attack_angle", "aoa", "yaw"),
    "impact.angular_velocity_rad_s": ("angular_velocity", "angular_speed", "rotation_rate", "omega"),
    "projectile.diameter_m": ("diameter", "projectile_diameter", "caliber", "calibre", "d"),
    "projectile.length_m": ("length", "projectile_length", "l"),
    "projectile.mass_kg": ("mass", "projectile_mass", "weight", "m"),
    "projectile.nose.shape": ("nose", "nose_shape", "shape", "nose_type"),
    "projectile.nose.caliber_radius_head": ("caliber_radius_head", "calibre_radius_head", "crh", "psi"),
    "projectile.center_of_gravity_m": ("center_of_gravity", "centre_of_gravity", "cg", "cog", "x_cg"),
    "projectile.moment_of_inertia_kg_m2": ("moment_of_inertia", "inertia", "transverse_inertia"),
    "target.compressive_strength_pa": (
        "compressive_strength",
        "concrete_strength",
        "strength",
        "fc",
        "f_c",
        "fcm",
        "cylinder_strength",
    ),
    "target.density_kg_m3": ("density", "concrete_density", "rho"),
    "target.youngs_modulus_pa": ("youngs_modulus", "young_modulus", "elastic_modulus", "modulus", "e_modulus", "ec"),
    "target.poissons_ratio": ("poissons_ratio", "poisson_ratio", "poisson", "nu"),
    "target.thickness_m": ("thickness", "wall_thickness", "wall", "target_thickness"),
    "resistance.strength_factor.value": ("strength_factor", "s"),
    "target.characteristic_strength_pa": ("characteristic_strength", "fck", "f_ck"),
    "custom_id": ("id", "name", "label", "case", "case_id", "shot", "test", "no", "nr", "number"),
}
"""Common names of inputs, without units, keyed by the dotted path of the input. Table headers and unknown fields are
matched against them. They are lower-case, with an underscore for any character that is not a letter or digit."""
FORMULAS: Final[Mapping[str, str]] = {
    "modified_ndrc": "Modified NDRC",
    "degen": "Degen",
    "cea_edf": "CEA-EDF",
    "ukaea": "UKAEA (Barr)",
    "chang": "Chang",
    "hughes": "Hughes",
    "kar": "Kar",
    "ace": "ACE",
    "brl": "BRL",
    "li_chen": "Li and Chen",
    "whiffen": "Whiffen",
}
"""Display names of the empirical formulas."""
UNITS: Final[Mapping[str, str]] = {"si": "SI", "us": "US customary"}
"""Display names of the systems of units."""
OUTCOMES: Final[Mapping[str, str]] = {
    "ricochet": "ricochet",
    "embedded": "embedded",
    "in_motion": "still in motion",
    "perforated": "perforated",
}
"""Display names of the outcomes of a strike."""
STATUSES: Final[Mapping[str, str]] = {
    "converged": "converged",
    "no_ricochet": "no ricochet",
    "always_ricochet": "ricochet at the lower end already",
    "not_converged": "not converged",
    "always_perforated": "always perforated",
    "never_perforated": "never perforated",
}
"""Display names of the statuses of a search."""
WARNINGS: Final[Mapping[str, str]] = {
    "base_strikes_first": "the tail strikes first",
    "bending_unknown": "no bending stress: the mass lies otherwise than in the shape",
    "bends": "its surface yields in bending",
    "crater_at_obliquity": "a crater of normal impact",
    "fixed_step_energy_gain": "time step too long",
    "implausible": "breaks a rule of every strike: a fault, please report",
    "plug_through_wall": "plug as high as the wall",
    "range_clipped": "range cut where S falls to zero",
    "rear_face_unconservative": "wall without a plug holds less",
    "rear_plug_quasi_static": "plug without mass or energy",
    "retention_decides": "retention energy decides the angle",
    "ricochet_at_lower_bound": "ricochet at the lower end already",
    "scatter_of_table_1": "S as sure as after the paper's tests",
    "samples_outside": "samples outside the accepted range",
    "shallow_penetration": "at rest within the front crater",
    "strength_factor_not_held": "polynomial of S far beyond its fit",
    "strength_factor_of_other_concrete": "S fitted to another concrete",
    "strength_fit_extrapolated": "angle beyond the fit of S",
    "tumbling": "turns end over end",
    "undecided": "still moving at the termination time",
    "velocity_beyond_rigid": "so fast that noses erode",
}
"""Short descriptions of warnings whose codes are not self-explanatory."""
OPERATIONS: Final[Mapping[str, str]] = {
    "cra": "critical angles",
    "trajectory": "trajectories",
    "thickness": "least thicknesses",
    "limit-speed": "limit speeds",
    "cra_uncertainty": "how sure an angle is",
    "trajectory_uncertainty": "how sure an outcome is",
    "unknown": "cases that cannot be read",
}
"""Display names of the operations that jobs perform, in the plural."""
JOB_STATUSES: Final[Mapping[str, str]] = {
    "accepted": "waiting",
    "running": "running",
    "successful": "done",
    "failed": "failed",
    "dismissed": "cancelled",
    "damaged": "damaged",
}
"""Display names of the statuses of a job."""
TITLES: Final[Mapping[str, str]] = {
    "impact.velocity_m_s": "speed",
    "impact.oblique_angle_deg": "angle",
    "target.compressive_strength_pa": "strength",
}
"""Short names of inputs for job titles, where the label would be too long."""


def named(names: Mapping[str, str], value: str) -> str:
    """Return the display name of a value, or the value itself if it is unknown, for example from a newer service."""
    return names.get(value, value)
