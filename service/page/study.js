// A study of how sure a critical angle is: its request, with more samples step by step, and what is known of a case.

import { angleRequest } from "./case.js";
import { nodeAt } from "./contract.js";
import { uncertainInput } from "./scatter.js";
import { ask } from "./service.js";

const GROWTH = 4; // of the samples from request to request: those before are found in the cache
const known = new Map(); // the latest answer by case, while the page is open

/**
 * Ask for a study with ever more samples, until it has converged or its samples are used up.
 *
 * @param {{values: object, inputs: object[], sampling: object}} study
 * @param {AbortSignal} signal
 * @yields {object} answers of `/cra/uncertainty`
 */
export async function* askStudy({ values, inputs, sampling }, signal) {
  const { minimum, default: usual } = nodeAt("sampling.max_samples", {});
  const most = sampling.max_samples ?? usual;
  const uncertain = inputs.map((input) => uncertainInput(input, values));
  for (let samples = Math.min(minimum, most); ; samples = Math.min(samples * GROWTH, most)) {
    const body = { ...angleRequest(values), uncertain, sampling: { ...sampling, max_samples: samples } };
    const { data } = await ask("cra/uncertainty", { body, signal });
    known.set(keyOf(values), data);
    yield data;
    if (data.converged || samples === most) return;
  }
}

/** Return the latest answer for a case at any oblique angle; undefined if there was none. */
export function knownStudy(values) {
  return known.get(keyOf(values));
}

/** Return a quantile of the critical angle. [°] */
export function quantileOf({ critical_angle: { quantiles } }, level) {
  return quantiles.find((each) => each.level === level)?.value;
}

/** Return the median with the range of nine in ten, as in "49° (45° to 53°)"; empty if there is no angle. */
export function headline(study) {
  const [low, middle, high] = [0.05, 0.5, 0.95].map((level) => quantileOf(study, level));
  if (middle === undefined) return "";
  const shown = (angle) => `${angle.toFixed(high - low < 3 ? 1 : 0)}°`;
  return `${shown(middle)} (${shown(low)} to ${shown(high)})`;
}

function keyOf(values) {
  return JSON.stringify(angleRequest(values));
}
