// Computes a study of the uncertainty of a critical angle as jobs.

import { angleRequest } from "./case.js";
import { nodeAt } from "./contract.js";
import { statesOf, submit } from "./job-progress.js";
import { untilAnswered } from "./lost.js";
import { uncertainInput } from "./scatter.js";
import { Problem, request } from "./service.js";
import { inUnits } from "./units.js";
import { degreesShown, withInterval } from "./words.js";

/**
 * Compute a study as a job with few samples and, if these do not suffice, as another job with all samples.
 *
 * @param {{values: object, inputs: object[], sampling: object, key?: string}} study `key` names a stored result with few samples
 * @param {AbortSignal} signal cancels the job too
 * @yields {object} answers of `/cra/uncertainty`, each after the progress of its job: `samples`, and sometimes the curve so far
 */
export async function* computeStudy({ values, inputs, sampling, key }, signal) {
  const { minimum, default: usual } = nodeAt("sampling.max_samples", {});
  const few = 2 * minimum; // the minimum leaves no samples for changing each input alone
  const most = sampling.max_samples ?? usual;
  const uncertain = inputs.map(uncertainInput);
  if (key) {
    const { data } = await request(`results/${key}`, { signal });
    yield data;
    if (data.convergence.half_width.at(-1) <= nodeAt("sampling.half_width", {}).default) return;
  }
  for (const samples of few < most && !key ? [few, most] : [most]) {
    const body = inUnits({ ...angleRequest(values), uncertain, sampling: { ...sampling, max_samples: samples } });
    const { id } = await submit("cra/uncertainty", body, signal);
    const cancel = () => request(`jobs/${id}/cancel`, { method: "POST" }).then(() => request(`jobs/${id}`, { method: "DELETE" })).catch(() => {});
    signal.addEventListener("abort", cancel, { once: true });
    for await (const { progress, partial } of statesOf(id, signal)) {
      if (progress) yield { samples: progress.samples, ...partial };
    }
    signal.removeEventListener("abort", cancel);
    const answer = await answerOf(id, signal);
    yield answer;
    if (answer.converged) return;
  }
}

/** Return the answer of a job that has ended, and delete the job, so that the list of jobs does not grow with each change of an input. */
async function answerOf(id, signal) {
  const [item] = (await untilAnswered(() => request(`jobs/${id}/results`, { signal }), signal)).data.results;
  if (!item) throw new Error("The job of the study was cancelled.");
  request(`jobs/${id}`, { method: "DELETE" }).catch(() => {}); // its result stays in the cache
  if (item.problem) throw new Problem(item.problem);
  return item.result;
}

/** Return a quantile of the critical angle [°]; undefined if it is not known. */
export function quantileOf({ critical_angle: angle }, level) {
  return angle?.quantiles.find((each) => each.level === level)?.value;
}

/** Return the probability of ricochet at an angle [°], and half the width of its interval, which is the sampling error. */
export function probabilityAt({ probability }, angle) {
  const { oblique_angle_deg: angles, ricochet_probability: values, lower, upper } = probability;
  const at = (list) => between(angles, list, angle);
  return { value: at(values), error: (at(upper) - at(lower)) / 2 };
}

/** Interpolate linearly between values at some places; beyond these, return the nearest value. */
export function between(places, values, place) {
  const next = places.findIndex((each) => each >= place);
  if (next < 1) return values.at(next); // the first or the last value
  const share = (place - places[next - 1]) / (places[next] - places[next - 1]);
  return values[next - 1] + share * (values[next] - values[next - 1]);
}

/** Return the median with the 90 % range, as in "49° (45° to 53°)"; empty if there is no angle. */
export function headline(study) {
  const [low, middle, high] = [0.05, 0.5, 0.95].map((level) => quantileOf(study, level));
  if (middle === undefined) return "";
  return withInterval(middle, low, high, (angle) => degreesShown(angle, [3, 0.3].filter((width) => high - low < width).length));
}
