// Inputs that scatter: their distributions, the usual scatter, and their forms in requests and addresses.

import { valueAt } from "./case.js";
import { nodeAt, usualScatter } from "./contract.js";
import { fieldAt, fieldOf, numericFields } from "./fields.js";
import { untilAnswered } from "./lost.js";
import { reportRequest } from "./report.js";
import { clipped } from "./run.js";
import { request } from "./service.js";

const RESIDUAL = fieldOf("number", "resistance.strength_residual");
/** Settings of the quickest study, with the fewest samples that the service accepts. */
export const QUICK = { max_samples: 256, method: "direct", half_width: 0.5 };

const MEAN = { name: "mean", label: "Mean", centre: true };
const MEDIAN = { name: "median", label: "Median", centre: true };
const MODE = { name: "mode", label: "Mode", centre: true };
const SPREAD = [
  { name: "coefficient_of_variation", label: "Coefficient of variation", si: "%" },
  { name: "standard_deviation", label: "or standard deviation" },
];
const ENDS = ["Lower", "Upper"].map((label) => ({ name: label.toLowerCase(), label }));
const DISPERSION = { name: "dispersion", label: "Dispersion, of the logarithm", si: "" };
const TAILS = [{ name: "scale", label: "Scale, of the logarithm", si: "" }, { name: "degrees_of_freedom", label: "Degrees of freedom", si: "" }];

/** Distributions of a number with their parameters; the `centre` defaults to the value of the case. */
export const DISTRIBUTIONS = {
  normal: { label: "Normal", parameters: [MEAN, ...SPREAD] },
  truncated_normal: { label: "Truncated normal", parameters: [MEAN, ...SPREAD, ...ENDS] },
  lognormal: { label: "Lognormal", parameters: [MEDIAN, DISPERSION] },
  log_student_t: { label: "Log Student t", parameters: [MEDIAN, ...TAILS, ...ENDS] },
  uniform: { label: "Uniform", parameters: ENDS },
  triangular: { label: "Triangular", parameters: [ENDS[0], MODE, ENDS[1]] },
};

/** Notes on how much fields usually scatter. */
export const NOTES = {
  "impact.velocity_m_s": "Usually scatters by 1 to 5 %.",
  "target.compressive_strength_pa": "Usually scatters by 10 to 15 %; by less where shots into this concrete leave less.",
  "impact.angle_of_attack_deg": "Usually scatters by about 1°.",
};
const BY_THEORY = { type: "discrete", given: { elastic_plastic: 0.8, mohr_coulomb: 0.2 } };
/** Initial distributions of inputs that do not scatter unless the user adds them. */
const ADDED = {
  "resistance.free_surface.model": BY_THEORY,
  "resistance.theory": BY_THEORY,
  "resistance.strength_factor.model": { type: "discrete", given: { obliquity_polynomial: 0.5, published_tests: 0.5 } },
  [RESIDUAL.path]: { type: "lognormal", given: { dispersion: 0.1 } },
};
const ANY = { type: "normal", given: { coefficient_of_variation: 0.05 } };
let usual; // usual scatter from the latest verdict, which depends on the tests in its case
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

/** Return an input with the usual scatter of a field or, if there is none, with its distribution in `ADDED` or a scatter of 5 %. */
export function usualInput(field) {
  const own = (usual ?? usualScatter)[field];
  const { type, given } = own ? inputOf(own) : (ADDED[field] ?? ANY);
  return { field, type, given };
}

/** Return the inputs of a case that usually scatter; the theory is included only if the decay law of the case is among its choices. */
export function usualInputs(values) {
  const decay = valueAt(values, "resistance.free_surface.model");
  const isOne = ({ type, given }) => type !== "discrete" || decay in given;
  return Object.keys(usual ?? usualScatter).map(usualInput).filter(isOne);
}

/** Store the usual scatter of a verdict without the values of its case; the scatter of the strength factor depends on the case. */
export function takeUsual(inputs) {
  usual = Object.fromEntries(inputs.map(({ field, distribution: { mean, median, mode, ...spread } }) => [field, spread]));
}

/** Return the usual scatter of a case as inputs of a sweep, in which it is centred on the values of each case. */
export async function usualAround(values, signal) {
  const judge = () => request("verdict", { body: reportRequest(clipped(values)), signal });
  takeUsual((await untilAnswered(judge, signal)).data.usual_scatter);
  return usualInputs(values).map(uncertainInput);
}

function inputOf({ type, values, weights, ...given }) {
  return { type, given: values ? Object.fromEntries(values.map((value, i) => [value, weights[i]])) : given };
}

/**
 * Return the parameters of an input: weights of models, or the parameters of its distribution.
 *
 * @returns {{name: string, label: string, si: string, centre?: boolean}[]} `si` is the unit when SI is shown
 */
export function parametersOf({ field, type }) {
  const own = inputField(field);
  if (type === "discrete") return Object.entries(own.choices).map(([name, label]) => ({ name, label, si: "weight" }));
  return DISTRIBUTIONS[type].parameters.map((each) => ({ si: own.si, ...each }));
}

/** Return the value of the case around which an input scatters; undefined if the case leaves it to the service. */
export function centreOf(field, values) {
  return field === RESIDUAL.path ? 1 : (valueAt(values, field) ?? nodeAt(field, values)?.default);
}

/** Return an input in the form that `/cra/uncertainty` accepts, in which an omitted centre is the value of the case. */
export function uncertainInput({ field, type, given }) {
  if (type === "discrete") {
    const names = parametersOf({ field, type }).map(({ name }) => name).filter((name) => given[name] !== undefined);
    return { field, distribution: { type, values: names, weights: names.map((name) => given[name]) } };
  }
  return { field, distribution: { type, ...given } };
}

/** Return the inputs of a query, without those that cannot be read; undefined if there are none. */
export function readInputs(query) {
  const found = query.getAll("scatter").map(readInput).filter(Boolean);
  return found.length ? found : undefined;
}

/** Format an input for an address: field, distribution, and the given parameters in SI units. */
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
