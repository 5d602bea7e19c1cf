// Computes a run, and adds the columns that the pictures need to those of the answer.

import { trajectoryRequest, valueAt, withValue } from "./case.js";
import { nodeAt } from "./contract.js";
import { centreOfGravity } from "./outline.js";
import { request } from "./service.js";
import { inUnits } from "./units.js";

const INSTANTS = 100; // least number of instants in a history whose duration was predicted well
const [FEWEST, MOST] = [60, 600]; // a history outside this range is computed again
const MOST_ROWS = 20_000; // largest number of rows of a history that lasts until the termination time
const TERMINATION_S = 0.05; // used if the case does not set one
const RADIAN = Math.PI / 180;

const CLIP_DEG = 0.1; // step of the slider for the oblique angle
const ANGLE = "impact.oblique_angle_deg";
const STRENGTH = "resistance.strength_factor";
const EQUATION_9 = [8.469, 0.0149, -0.0013]; // of 1, θ, θ² in degrees: the default coefficients of the polynomial
const HELD_FROM_DEG = 60; // S of eq. 9 is held constant from this angle on

let latest = {}; // speed [m/s] and duration [s] of the latest run, from which the duration of the next is predicted

/**
 * Compute a trajectory with a history of 100 to 250 instants, or of 60 to 600 if its duration was not predicted well.
 *
 * @returns {Promise<object>} the answer, with `path` (columns of the nose tip and the speed) and with the `projectile`,
 *   the `target` and all `values` of the case
 */
export async function computeRun(values, signal) {
  const given = clipped(values);
  const most = given.numerics?.termination_time_s ?? TERMINATION_S;
  const requestRun = async (time) => {
    const interval = Math.min(Math.max(nice(time / INSTANTS), most / MOST_ROWS), most); // rounded intervals let similar runs share cached results
    return requestStrike(trajectoryRequest(given, interval), signal);
  };
  const speed = given.impact.velocity_m_s;
  const isLike = latest.speed > speed / 2 && latest.speed < speed * 2;
  let run = await requestRun(isLike ? latest.duration : (3 * given.projectile.length_m) / speed);
  latest = { speed, duration: run.final.time_s };
  const rows = run.history.time_s.length;
  if (rows < FEWEST || rows > MOST) run = await requestRun(latest.duration);
  const warnings = given === values ? run.warnings : [clipWarning(given), ...run.warnings];
  const { projectile, target } = given;
  return { ...run, warnings, path: pathOf(run.history, projectile), projectile, target, values };
}

/** Compute a strike without its history; `more` is added to the request. */
export function requestEnd(values, signal, more = {}) {
  return requestStrike({ ...trajectoryRequest(clipped(values)), ...more, output: { history: false } }, signal);
}

/**
 * Request a trajectory. If the sampling interval is refused as too short for the termination time, the service chooses one;
 * if the step limit is reached, the trajectory is computed up to there, and ends in motion.
 */
async function requestStrike(body, signal) {
  const send = async (given) => (await request("trajectory", { body: inUnits(given), signal })).data;
  try {
    return await send(body);
  } catch (error) {
    const { sample_interval_s: interval, ...output } = body.output;
    if (interval && error.errors?.some(({ pointer }) => pointer === "/output/sample_interval_s")) return send({ ...body, output });
    if (!error.stoppedAt) throw error;
    const time = Number((0.95 * error.stoppedAt).toPrecision(3));
    return send({ ...body, output: { ...body.output, sample_interval_s: interval && Math.min(interval, time) }, numerics: { ...body.numerics, termination_time_s: time } });
  }
}

/**
 * Return a case with its oblique angle lowered to where the strength factor is positive, just as searches clip their range.
 *
 * Only the polynomial can fall to zero. A case that the service would refuse at any angle is returned unchanged.
 */
export function clipped(values) {
  const { model, coefficients = EQUATION_9, held_from_deg: given, obliquity_shape: shape } = valueAt(values, STRENGTH) ?? {};
  const isPolynomial = model === "obliquity_polynomial" || (shape ?? nodeAt(`${STRENGTH}.obliquity_shape`, values)?.default) === "equation_9";
  if (!isPolynomial) return values;
  const isHeld = model !== "obliquity_polynomial" || coefficients.every((each, i) => each === EQUATION_9[i]);
  const held = given ?? (isHeld ? HELD_FROM_DEG : 90);
  const factor = (angle) => coefficients.reduceRight((sum, each) => sum * Math.min(angle, held) + each, 0);
  let angle = valueAt(values, ANGLE);
  while (angle > 0 && factor(angle) <= 0) angle = Math.round((angle - CLIP_DEG) / CLIP_DEG) * CLIP_DEG;
  return angle > 0 && angle < valueAt(values, ANGLE) ? withValue(values, ANGLE, Number(angle.toFixed(1))) : values;
}

function clipWarning({ impact }) {
  const detail = `the strength factor falls to zero above ${impact.oblique_angle_deg}°: this strike is computed at ${impact.oblique_angle_deg}°`;
  return { code: "range_clipped", detail };
}

/** Return the row of a history that is nearest to an instant [s]. */
export function rowAt({ history: { time_s: time } }, instant) {
  const later = time.findIndex((each) => each >= instant);
  if (later < 0) return time.length - 1;
  return later > 0 && instant - time[later - 1] < time[later] - instant ? later - 1 : later;
}

function pathOf(history, projectile) {
  const ahead = centreOfGravity(projectile);
  const angle = history.axis_angle_deg.map((degrees) => degrees * RADIAN);
  const start = ahead * Math.sin(angle[0]);
  return {
    lateral: history.center_of_gravity_lateral_m.map((lateral, row) => lateral + ahead * Math.sin(angle[row]) - start),
    depth: history.nose_tip_depth_m,
    angle,
    speed: history.depth_velocity_m_s.map((speed, row) => Math.hypot(speed, history.lateral_velocity_m_s[row])),
  };
}

/** Round down to 1, 2 or 5 times a power of ten. */
export function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return Number(([5, 2, 1].find((step) => step * power <= value * (1 + 1e-9)) * power).toPrecision(3));
}
