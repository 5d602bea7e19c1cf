// Inputs that scatter: their distributions, what is usual, and how they stand in a request and in an address.

import { valueAt } from "./case.js";
import { nodeAt, usualScatter } from "./contract.js";
import { fieldAt, fieldOf, numericFields } from "./fields.js";

const RESIDUAL = fieldOf("number", "resistance.strength_residual");
/** Settings of the quickest study: the fewest samples that the service takes. */
export const QUICK = { max_samples: 256, method: "direct", half_width: 0.5 };

const MEAN = { name: "mean", label: "Mean", centre: true };
const SPREAD = [
  { name: "coefficient_of_variation", label: "Coefficient of variation", si: "%" },
  { name: "standard_deviation", label: "or standard deviation" },
];
const ENDS = ["Lower", "Upper"].map((label) => ({ name: label.toLowerCase(), label }));

/** Distributions of a number with their parameters; the `centre` is the value of the case where it is left open. */
export const DISTRIBUTIONS = {
  normal: { label: "Normal", parameters: [MEAN, ...SPREAD] },
  truncated_normal: { label: "Truncated normal", parameters: [MEAN, ...SPREAD, ...ENDS] },
  lognormal: {
    label: "Lognormal",
    parameters: [
      { name: "median", label: "Median", centre: true },
      { name: "dispersion", label: "Dispersion, of the logarithm", si: "" },
    ],
  },
  log_student_t: {
    label: "Log Student t",
    parameters: [
      { name: "median", label: "Median", centre: true },
      { name: "scale", label: "Scale, of the logarithm", si: "" },
      { name: "degrees_of_freedom", label: "Degrees of freedom", si: "" },
      ...ENDS,
    ],
  },
  uniform: { label: "Uniform", parameters: ENDS },
  triangular: {
    label: "Triangular",
    parameters: [ENDS[0], { name: "mode", label: "Mode", centre: true }, ENDS[1]],
  },
};

/** Notes on how much fields usually scatter. */
export const NOTES = {
  "impact.velocity_m_s": "Usually scatters by 1 to 5 %.",
  "target.compressive_strength_pa": "Usually scatters by 10 to 15 %; by less where shots into this concrete leave less.",
  "impact.angle_of_attack_deg": "Usually scatters by about 1°.",
};
const BY_THEORY = { type: "discrete", given: { elastic_plastic: 0.8, mohr_coulomb: 0.2 } };
/** What is offered of inputs that do not scatter unless they are added. */
const ADDED = {
  "resistance.free_surface.model": BY_THEORY,
  "resistance.theory": BY_THEORY,
  "resistance.strength_factor.model": { type: "discrete", given: { obliquity_polynomial: 0.5, published_tests: 0.5 } },
  [RESIDUAL.path]: { type: "lognormal", given: { dispersion: 0.1 } },
};
const ANY = { type: "normal", given: { coefficient_of_variation: 0.05 } };
let usual; // of the case of the latest verdict, which depends on its tests
const MODELS = ["resistance.free_surface.model", "resistance.strength_factor.model"];
const THEORY = fieldOf("choice", "resistance.theory");

/** Return the fields of a case that may scatter. */
export function scatterFields(values) {
  const numbers = numericFields(values).filter(
    ({ path }) => path !== "impact.oblique_angle_deg" && !path.startsWith("search."),
  );
  return [...numbers, ...MODELS.map(fieldAt), THEORY, RESIDUAL];
}

/** Return the field of an input. */
export function inputField(path) {
  return [RESIDUAL, THEORY].find((each) => each.path === path) ?? (fieldAt(path) ?? { path, label: path, si: "", unit: "", factor: 1 });
}

/** Return an input with what usually scatters of this field; 5 % where nothing is usual. */
export function usualInput(field) {
  const own = (usual ?? usualScatter)[field];
  const { type, given } = own ? inputOf(own) : (ADDED[field] ?? ANY);
  return { field, type, given };
}

/** Return the inputs of a case that usually scatter: the theory only if the decay law of the case is one of the two. */
export function usualInputs(values) {
  const decay = valueAt(values, "resistance.free_surface.model");
  const isOne = ({ type, given }) => type !== "discrete" || decay in given;
  return Object.keys(usual ?? usualScatter).map(usualInput).filter(isOne);
}

/** Take what usually scatters from a verdict, but for the values of the case: the scatter of the strength factor is its own. */
export function takeUsual(inputs) {
  usual = Object.fromEntries(inputs.map(({ field, distribution: { mean, median, mode, ...spread } }) => [field, spread]));
}

function inputOf({ type, values, weights, ...given }) {
  return { type, given: values ? Object.fromEntries(values.map((value, i) => [value, weights[i]])) : given };
}

/**
 * Return the parameters of an input: weights of models, or those of its distribution.
 *
 * @returns {{name: string, label: string, si: string, centre?: boolean}[]} `si` is the unit in which SI shows it
 */
export function parametersOf({ field, type }) {
  const own = inputField(field);
  if (type === "discrete") {
    return Object.entries(own.choices).map(([name, label]) => ({ name, label, si: "weight" }));
  }
  return DISTRIBUTIONS[type].parameters.map((each) => ({ si: own.si, ...each }));
}

/** Return the value of the case around which an input scatters; undefined if the case leaves it to the service. */
export function centreOf(field, values) {
  return field === RESIDUAL.path ? 1 : (valueAt(values, field) ?? nodeAt(field, values)?.default);
}

/** Return an input as `/cra/uncertainty` takes it. */
export function uncertainInput({ field, type, given }, values) {
  if (type === "discrete") {
    const names = parametersOf({ field, type }).map(({ name }) => name).filter((name) => given[name] !== undefined);
    return { field, distribution: { type, values: names, weights: names.map((name) => given[name]) } };
  }
  const centre = DISTRIBUTIONS[type].parameters.find((each) => each.centre);
  const around = centre && { [centre.name]: centreOf(field, values) };
  return { field, distribution: { type, ...around, ...given } };
}

/** Return the inputs of a query; undefined if it has none. What cannot be read is left out. */
export function readInputs(query) {
  const found = query.getAll("scatter").map(readInput).filter(Boolean);
  return found.length ? found : undefined;
}

/** Return an input as text for an address: field, distribution, and what is given in SI units. */
export function writeInput({ field, type, given }) {
  return [field, type, ...Object.entries(given).map(([name, value]) => `${name}:${value}`)].join(",");
}

function readInput(text) {
  const [field, type, ...rest] = text.split(",");
  const isModel = [...MODELS, THEORY.path].includes(field);
  const isNumber = field === RESIDUAL.path || fieldAt(field)?.kind === "number";
  if (isModel ? type !== "discrete" : !(isNumber && type in DISTRIBUTIONS)) return undefined;
  const names = parametersOf({ field, type }).map(({ name }) => name);
  const pairs = rest.map((pair) => pair.split(":")).map(([name, value]) => [name, Number(value)]);
  return { field, type, given: Object.fromEntries(pairs.filter(([name, value]) => names.includes(name) && Number.isFinite(value))) };
}
