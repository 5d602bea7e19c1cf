// The fields of a case as the form shows them: label, unit and factor to SI. The bounds come from the contract.

import { valueAt, withValue } from "./case.js";
import { names, nodeAt } from "./contract.js";
import { solidVolume } from "./outline.js";
import { areUs, unitOf } from "./units.js";
import { capital, grouped, lengthShown, quantityShown } from "./words.js";

/** Return a field of a kind: `number`, `choice` (a variant or a name), `flag`, `numbers` (a list, or a list of pairs) or `shots`. */
export const fieldOf = (kind, path, si = "", extra = {}) => ({
  ...{ kind, path, si, ...extra },
  get label() {
    return extra.label ?? names.quantities[path];
  },
  get choices() {
    if (extra.classes) return extra.classes;
    const own = names.choices[path];
    return own && Object.fromEntries(Object.entries(own).map(([value, name]) => [value, capital(name)]));
  },
  get unit() {
    return unitOf(si).unit;
  },
  get factor() {
    return unitOf(si).factor;
  },
});
const number = (path, si, extra) => fieldOf("number", path, si, extra);
const OPTIONAL = { optional: true };
const STEEL_KG_M3 = 7850;
const LENGTH = "projectile.length_m";
export const DIAMETER = "projectile.diameter_m";
export const MASS = "projectile.mass_kg";
/** Names of the concrete classes by characteristic cylinder strength [Pa], from EN 1992-1-1, table 3.1. */
const CONCRETE_PA = Object.fromEntries(
  ["20/25", "25/30", "30/37", "35/45", "40/50", "45/55", "50/60", "55/67", "60/75", "70/85", "80/95", "90/105"].map((name) => [parseInt(name) * 1e6, `C${name}`]),
);
const MEAN_ABOVE_PA = 8e6; // mean minus characteristic strength, from the same table

/** Return a case with the mean strength of a concrete class, which the model uses; design values use the characteristic strength. */
function meanOfClass(values, characteristic) {
  return characteristic === undefined ? values : withValue(values, "target.compressive_strength_pa", characteristic + MEAN_ABOVE_PA);
}

export const isSphere = ({ projectile }) => projectile?.nose.shape === "sphere";

/** Return the mass of a solid body of steel with three digits [kg]. */
const steelMass = ({ projectile }) => Number((STEEL_KG_M3 * solidVolume(projectile)).toPrecision(3));

/** Return a case in which a sphere is as long as wide and, if it had the mass of steel `before` a change, has it again. */
export function withSphere(values, before) {
  if (!isSphere(values)) return values;
  const sphere = withValue(values, LENGTH, values.projectile.diameter_m);
  const isSteel = Math.abs(values.projectile.mass_kg / steelMass(before) - 1) < 1e-5; // a mass in pounds has six digits
  return isSteel ? withValue(sphere, MASS, steelMass(sphere)) : sphere;
}

/**
 * Groups of fields in the order of the form; a group that `isFolded` is open only if the case differs from the paper's in it.
 *
 * `si` is the unit when SI is shown, `unit` the unit shown, and `factor` converts the number shown to SI without a prefix. An `optional` field may be empty,
 * and then shows `open`. `choices` are labels by value; `classes` are the choices of a number, for which `takes` returns the changed case. `fill` is a button
 * that fills in a value. A `variant` decides which other fields there are. `pairs` marks a list of pairs of numbers.
 * `slider` is [least, most, step] in the unit of SI.
 */
export const GROUPS = [
  {
    name: "What strikes",
    fields: [
      fieldOf("choice", "projectile.nose.shape", "", { variant: true }),
      number("projectile.nose.caliber_radius_head"),
      number("projectile.nose.length_to_diameter"),
      fieldOf("numbers", "projectile.nose.points", "mm", { pairs: true, note: "one pair on each line" }),
      number(DIAMETER, "mm"),
      number(LENGTH, "mm"),
      number(MASS, "kg", { fill: { name: "Steel", of: steelMass } }),
      number("projectile.center_of_gravity_m", "mm", OPTIONAL),
      number("projectile.moment_of_inertia_kg_m2", "kg m²", OPTIONAL),
      number("projectile.inner_diameter_m", "mm", { ...OPTIONAL, open: "solid" }),
      number("projectile.yield_strength_pa", "MPa", { ...OPTIONAL, open: 1.2e9, note: "for bending" }),
    ],
  },
  {
    name: "What it strikes",
    fields: [
      fieldOf("choice", "target.characteristic_strength_pa", "", {
        ...{ classes: CONCRETE_PA, label: "Concrete class", takes: meanOfClass },
        note: "the model uses its mean strength, design values its characteristic strength",
      }),
      number("target.compressive_strength_pa", "MPa", { note: "mean, of cylinders" }),
      number("target.density_kg_m3", "kg/m³"),
      number("target.youngs_modulus_pa", "GPa", OPTIONAL),
      number("target.poissons_ratio", "", OPTIONAL),
      number("target.thickness_m", "mm", { ...OPTIONAL, open: "∞", note: "of a wall" }),
    ],
  },
  {
    name: "How it strikes",
    fields: [
      number("impact.velocity_m_s", "m/s", { slider: [50, 800, 1] }),
      number("impact.oblique_angle_deg", "°", { slider: [0, 89.9, 0.1], note: "from the normal" }),
      number("impact.angle_of_attack_deg", "°", OPTIONAL),
      number("impact.angular_velocity_rad_s", "rad/s", OPTIONAL),
    ],
  },
  {
    name: "Laws",
    isFolded: true,
    fields: [
      fieldOf("choice", "resistance.strength_factor.model", "", { variant: true }),
      fieldOf("shots", "resistance.strength_factor.shots", "", {
        note: "one on each line, at normal impact into this concrete; paste or drop a CSV",
      }),
      number("resistance.strength_factor.value"),
      fieldOf("numbers", "resistance.strength_factor.coefficients", "", { ...OPTIONAL, note: "of 1, θ, θ² ..." }),
      number("resistance.strength_factor.coefficient", "", OPTIONAL),
      number("resistance.strength_factor.exponent", "", OPTIONAL),
      number("resistance.strength_factor.reference_strength_pa", "MPa", OPTIONAL),
      number("resistance.strength_factor.diameter_exponent", "", OPTIONAL),
      number("resistance.strength_factor.reference_diameter_m", "mm", OPTIONAL),
      fieldOf("choice", "resistance.strength_factor.obliquity_shape"),
      fieldOf("choice", "strength_scatter"),
      fieldOf("choice", "resistance.free_surface.model"),
      fieldOf("flag", "resistance.free_surface.inertia"),
      number("resistance.inertia_factor", "", OPTIONAL),
      number("resistance.crater.depth_diameters", "", { ...OPTIONAL, open: "none", note: "published: 2" }),
      number("resistance.rear_plug.cone_angle_deg", "°", { ...OPTIONAL, open: "none", note: "of a wall; published: 66.1°" }),
    ],
  },
  {
    name: "Search",
    isFolded: true,
    fields: [
      fieldOf("choice", "search.method"),
      number("search.lower_deg", "°", OPTIONAL),
      number("search.upper_deg", "°", OPTIONAL),
      number("search.tolerance_deg", "°", OPTIONAL),
      number("search.relative_tolerance", "", { ...OPTIONAL, note: "paper's searches" }),
    ],
  },
];

/** The fields of a study, which are not part of a case. */
export const SAMPLING = {
  name: "Sampling",
  fields: [
    number("sampling.half_width", "", OPTIONAL),
    number("sampling.max_samples", "", OPTIONAL),
    number("sampling.seed", "", OPTIONAL),
  ],
};

/** Return the field at a path; undefined if the form has none. */
export const fieldAt = (path) => GROUPS.flatMap(({ fields }) => fields).find((each) => each.path === path);

/** Return whether a case has a field, which depends on its nose and its models; the length of a sphere follows from its diameter. */
export const isThere = ({ path }, values) => nodeAt(path, values) !== undefined && !(path === LENGTH && isSphere(values));

/**
 * Return the bounds of a field in the unit shown.
 *
 * @returns {{least?: number, most?: number, above?: number, below?: number}} `above` and `below` are exclusive
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

/** Return the fields of a case that are single numbers, which a sweep can vary. */
export const numericFields = (values) => GROUPS.flatMap(({ fields }) => fields).filter((each) => each.kind === "number" && isThere(each, values));

/** Return the value of a field in the unit shown; undefined if the case leaves it open. */
export function shownValue(field, values) {
  const value = valueAt(values, field.path);
  return typeof value === "number" ? shownNumber(field, value) : value;
}

/** Return what an empty field shows: a word, or its default value converted from SI. */
export const openShown = (field) => (typeof field.open === "number" ? shownNumber(field, field.open) : field.open);

/** Return the value of a field as text, without its unit. */
export function fieldShown(field, values) {
  if (!isThere(field, values)) return "-";
  const value = shownValue(field, values);
  if (value === undefined || value === "") return openShown(field) ?? "auto";
  if (field.choices) return field.choices[value];
  if (field.kind === "shots") return `${value.length} own shot${value.length === 1 ? "" : "s"}: ${value.map((shot) => shotShown(shot)).join("; ")}`;
  if (field.kind === "numbers") return linesOf(field, values).join(field.pairs ? "; " : ", ");
  return typeof value === "number" ? grouped(value) : String(value);
}

/** Return the texts of the numbers or the pairs of numbers in a field, in the unit shown. */
export function linesOf(field, values) {
  return (valueAt(values, field.path) ?? []).map((item) => [item].flat().map((number) => shownNumber(field, number)).join(", "));
}

/** Format the speed and the depth of a shot. */
export const shotShown = ({ velocity_m_s: speed, depth_m: depth }, count = 6) => `${quantityShown(speed, "m/s", count)}, ${lengthShown(depth, count)}`;

/** Convert a number in SI to the unit of a field, without rounding errors of floating point and conversion. */
export const shownNumber = ({ factor }, value) => Number((value / factor).toPrecision(areUs() ? 6 : 12));

/** Format a number, or a text in place of a number, with its unit. */
export const withUnit = (value, unit) => `${typeof value === "number" ? grouped(value) : value}${unit && unit !== "°" ? ` ${unit}` : unit}`;

/** Return a field's label with its unit, for an axis or a column. */
export const labelWithUnit = ({ label, unit }) => unit ? `${label} [${unit}]` : label;
