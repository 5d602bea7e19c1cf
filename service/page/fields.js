// The fields of a case as the form shows them: label, unit and factor to SI. Bounds are the contract's.

import { valueAt } from "./case.js";
import { nodeAt } from "./contract.js";
import { areUs, unitOf } from "./units.js";

/** Return a field: a `number`; `choice` of a variant or a name; `flag`; `numbers`, a list or a list of lists; or `shots`. */
export const fieldOf = (kind, path, label, si = "", extra = {}) => ({
  ...{ kind, path, label, si, ...extra },
  get unit() {
    return unitOf(si).unit;
  },
  get factor() {
    return unitOf(si).factor;
  },
});
const number = (path, label, si, extra) => fieldOf("number", path, label, si, extra);
const OPTIONAL = { optional: true };

/**
 * Groups of fields in the order of the form.
 *
 * `si` is the unit in which a field is shown, but for US customary units, `unit` the one that is shown, and `factor` times what
 * is shown the value in SI without a prefix; `optional` may be empty and then shows `open`; `choices` are labels
 * by value, `variant` marks one that decides which other fields there are; `pairs` is a list of them; `slider` is
 * [least, most, step] in the unit of SI.
 */
export const GROUPS = [
  {
    name: "Strike",
    fields: [
      number("impact.velocity_m_s", "Speed", "m/s", { slider: [50, 800, 1] }),
      number("impact.oblique_angle_deg", "Oblique angle", "°", { slider: [0, 89.9, 0.1], note: "from the normal" }),
      number("impact.angle_of_attack_deg", "Angle of attack", "°", OPTIONAL),
      number("impact.angular_velocity_rad_s", "Angular velocity", "rad/s", OPTIONAL),
    ],
  },
  {
    name: "Projectile",
    fields: [
      fieldOf("choice", "projectile.nose.shape", "Nose", "", {
        variant: true,
        choices: {
          ogive: "Ogive",
          conical: "Cone",
          spherical: "Spherical cap",
          flat: "Flat",
          profile: "Profile",
          sphere: "Sphere",
        },
      }),
      number("projectile.nose.caliber_radius_head", "Caliber radius head ψ", ""),
      number("projectile.nose.length_to_diameter", "Cone height over diameter", ""),
      fieldOf("numbers", "projectile.nose.points", "Points x, r", "mm", { pairs: true, note: "a pair a line" }),
      number("projectile.diameter_m", "Diameter", "mm"),
      number("projectile.length_m", "Length", "mm"),
      number("projectile.mass_kg", "Mass", "kg"),
      number("projectile.center_of_gravity_m", "Centre of gravity", "mm", {
        ...OPTIONAL,
        note: "behind the tip",
      }),
      number("projectile.moment_of_inertia_kg_m2", "Moment of inertia", "kg m²", OPTIONAL),
    ],
  },
  {
    name: "Target",
    fields: [
      number("target.compressive_strength_pa", "Compressive strength", "MPa"),
      number("target.density_kg_m3", "Density", "kg/m³"),
      number("target.youngs_modulus_pa", "Young's modulus", "GPa", OPTIONAL),
      number("target.poissons_ratio", "Poisson's ratio", "", OPTIONAL),
      number("target.thickness_m", "Thickness", "mm", { ...OPTIONAL, open: "∞", note: "of a wall" }),
    ],
  },
  {
    name: "Model",
    fields: [
      fieldOf("choice", "resistance.strength_factor.model", "Strength factor", "", {
        variant: true,
        choices: {
          obliquity_polynomial: "Polynomial in θ",
          constant: "Constant",
          strength_power_law: "Power of the strength",
          published_tests: "Published tests",
          own_tests: "Own depth tests",
        },
      }),
      fieldOf("shots", "resistance.strength_factor.shots", "Shots: speed, depth", "", {
        note: "a line each, such as 250 m/s, 0.31 m, at normal impact into this concrete; paste or drop a CSV",
      }),
      number("resistance.strength_factor.value", "Value", ""),
      fieldOf("numbers", "resistance.strength_factor.coefficients", "Coefficients", "", { ...OPTIONAL, note: "of 1, θ, θ² ..., θ in °" }),
      number("resistance.strength_factor.coefficient", "Coefficient", "", OPTIONAL),
      number("resistance.strength_factor.exponent", "Exponent", "", OPTIONAL),
      number("resistance.strength_factor.reference_strength_pa", "Reference strength", "MPa", OPTIONAL),
      number("resistance.strength_factor.diameter_exponent", "Diameter exponent", "", OPTIONAL),
      number("resistance.strength_factor.reference_diameter_m", "Reference diameter", "mm", OPTIONAL),
      fieldOf("choice", "resistance.strength_factor.obliquity_shape", "Over the angle", "", {
        choices: { constant: "Constant", equation_9: "Polynomial in θ" },
      }),
      fieldOf("choice", "resistance.free_surface.model", "Free surface", "", {
        choices: { elastic_plastic: "Elastic-plastic", mohr_coulomb: "Mohr-Coulomb", none: "None" },
      }),
      fieldOf("flag", "resistance.free_surface.inertia", "with inertia of the solid"),
      number("resistance.inertia_factor", "Inertia factor", "", OPTIONAL),
      number("resistance.crater.depth_diameters", "Crater depth over diameter", "", {
        ...OPTIONAL,
        open: "none",
        note: "published: 2",
      }),
      number("resistance.rear_plug.cone_angle_deg", "Rear plug, angle of its cone", "°", {
        ...OPTIONAL,
        open: "none",
        note: "of a wall; published: 66.1°",
      }),
    ],
  },
  {
    name: "Search",
    fields: [
      fieldOf("choice", "search.method", "Method", "", {
        choices: { outcome: "Change of outcome", bisection: "Bisection (paper)", secant: "Secant (paper)" },
      }),
      number("search.lower_deg", "From", "°", OPTIONAL),
      number("search.upper_deg", "To", "°", OPTIONAL),
      number("search.tolerance_deg", "Tolerance", "°", OPTIONAL),
      number("search.relative_tolerance", "Relative tolerance", "", { ...OPTIONAL, note: "paper's searches" }),
    ],
  },
];

/** The fields of a study, which are not of a case. */
export const SAMPLING = {
  name: "Sampling",
  fields: [
    number("sampling.half_width", "Half width", "", OPTIONAL),
    number("sampling.max_samples", "Samples at most", "", OPTIONAL),
    number("sampling.seed", "Seed", "", OPTIONAL),
  ],
};

/** Return the field at a path; undefined if the form has none. */
export function fieldAt(path) {
  return GROUPS.flatMap(({ fields }) => fields).find((each) => each.path === path);
}

/** Return whether a case, with the nose and models it has, has this field. */
export function isThere({ path }, values) {
  return nodeAt(path, values) !== undefined;
}

/**
 * Return the bounds of a field in the unit shown.
 *
 * @returns {{least?: number, most?: number, above?: number, below?: number}} `above` and `below` are not reached
 */
export function boundsOf(field, values) {
  const node = nodeAt(field.path, values) ?? {};
  const shown = (bound) => (bound === undefined ? undefined : shownNumber(field, bound));
  return {
    least: shown(node.minimum),
    most: shown(node.maximum),
    above: shown(node.exclusiveMinimum),
    below: shown(node.exclusiveMaximum),
  };
}

/** Return the fields of a case that are single numbers, which a sweep may vary. */
export function numericFields(values) {
  return GROUPS.flatMap(({ fields }) => fields).filter((each) => each.kind === "number" && isThere(each, values));
}

/** Return the value of a field in the unit shown; undefined if the case leaves it open. */
export function shownValue(field, values) {
  const value = valueAt(values, field.path);
  return typeof value === "number" ? shownNumber(field, value) : value;
}

/** Return a number in SI in the unit of a field, without what floating point adds, or a conversion. */
export function shownNumber({ factor }, value) {
  return Number((value / factor).toPrecision(areUs() ? 6 : 12));
}

/** Return an error of the service for a field: with its name, lengths and pressures in the unit of the field. */
export function inUnit(field, detail) {
  const convert = (text, number) => (field.factor === 1 ? text : withUnit(shownNumber(field, Number(number)), field.unit));
  const words = detail.replace(/(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?) (?:m|Pa)\b(?![²³/])/g, convert);
  return /^(must|at least|at most|more than|less than)\b/.test(words) ? `${field.label} ${words}` : words;
}

/** Return a number with its unit. */
export function withUnit(number, unit) {
  return unit && unit !== "°" ? `${number} ${unit}` : `${number}${unit}`;
}

/** Return a field's label with its unit, for an axis or a column. */
export function labelWithUnit({ label, unit }) {
  return unit ? `${label} [${unit}]` : label;
}
