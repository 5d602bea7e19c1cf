// One run: its request, and columns that the pictures need besides those of the answer.

import { trajectoryRequest, valueAt, withValue } from "./case.js";
import { nodeAt } from "./contract.js";
import { centreOfGravity } from "./outline.js";
import { request } from "./service.js";
import { inUnits } from "./units.js";

const INSTANTS = 100; // at least, mostly
const [FEWEST, MOST] = [60, 600];
const MOST_ROWS = 20_000; // of a history, over the termination time
const TERMINATION_S = 0.05; // when the case leaves it open
const RADIAN = Math.PI / 180;

const CLIP_DEG = 0.1; // as the slider of the oblique angle moves
const ANGLE = "impact.oblique_angle_deg";
const STRENGTH = "resistance.strength_factor";
const EQUATION_9 = [8.469, 0.0149, -0.0013]; // of 1, θ, θ² in degrees: what a polynomial without coefficients has

const HELD_FROM_DEG = 60; // from where S of eq. 9 stays what it is there

let latest = {}; // speed and duration of the latest run, which the next is taken to be like. [m/s, s]

/**
 * Compute a trajectory with a history of 100 to 250 instants.
 *
 * @returns {Promise<object>} the answer, with `path`, columns of the nose tip and the speed, and what was given of
 *   `projectile`, `target` and all `values`
 */
export async function computeRun(values, signal) {
  const given = clipped(values);
  const most = given.numerics?.termination_time_s ?? TERMINATION_S;
  const requestRun = async (time) => {
    const interval = Math.min(Math.max(nice(time / INSTANTS), most / MOST_ROWS), most); // few intervals, so that results are found again
    return requestStrike(trajectoryRequest(given, interval), signal);
  };
  const speed = given.impact.velocity_m_s;
  const isLike = latest.speed > speed / 2 && latest.speed < speed * 2;
  let run = await requestRun(isLike ? latest.duration : (3 * given.projectile.length_m) / speed);
  latest = { speed, duration: run.final.time_s };
  const rows = run.history.time_s.length;
  if (rows < FEWEST || rows > MOST) run = await requestRun(latest.duration);
  const warnings = given === values ? run.warnings : [clipWarning(given), ...run.warnings];
  const path = pathOf(run.history, given.projectile);
  return { ...run, warnings, path, projectile: given.projectile, target: given.target, values };
}

/** Return the end of a strike, without its history. */
export function requestEnd(values, signal) {
  return requestStrike({ ...trajectoryRequest(clipped(values)), output: { history: false } }, signal);
}

/**
 * Request a trajectory: with fewer instants if its termination time is long, as a slow one's is, and up to where its steps end if
 * it takes too many; it is in motion then.
 */
export async function requestStrike(body, signal) {
  const send = async (given) => (await request("trajectory", { body: inUnits(given), signal })).data;
  try {
    return await send(body);
  } catch (error) {
    const interval = body.output.sample_interval_s;
    const [, least] = error.errors?.find(({ pointer }) => pointer === "/output/sample_interval_s")?.detail.match(/([\d.e-]+) s, got/) ?? [];
    if (least > interval) return send({ ...body, output: { ...body.output, sample_interval_s: 1.001 * Number(least) } });
    const [, stopped] = (error.type?.endsWith(":step-limit") && error.detail.match(/stopped at ([\d.e-]+) s/)) || [];
    if (!stopped) throw error;
    const time = Number((0.95 * Number(stopped)).toPrecision(3));
    const shorter = interval && Math.min(interval, time);
    return send({ ...body, output: { ...body.output, sample_interval_s: shorter }, numerics: { ...body.numerics, termination_time_s: time } });
  }
}

/**
 * Return a case at the nearest oblique angle below at which its strength factor is positive, as searches clip their range.
 *
 * Only the polynomial falls to zero; a case that the service would refuse whatever the angle is returned as it is.
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

/** Return the row of a history that is nearest to an instant. [s] */
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

/** Return the next 1, 2 or 5 times a power of ten at or below. */
export function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return Number(([5, 2, 1].find((step) => step * power <= value * (1 + 1e-9)) * power).toPrecision(3));
}
