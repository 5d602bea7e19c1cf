// One run: its request, and columns that the pictures need besides those of the answer.

import { trajectoryRequest } from "./case.js";
import { centreOfGravity } from "./outline.js";
import { request } from "./service.js";

const INSTANTS = 100; // at least, mostly
const [FEWEST, MOST] = [60, 600];
const MOST_ROWS = 20_000; // of a history, over the termination time
const TERMINATION_S = 0.05; // when the case leaves it open
const RADIAN = Math.PI / 180;

let duration; // of the latest run, which the next is taken to be like. [s]

/**
 * Compute a trajectory with a history of 100 to 250 instants.
 *
 * @returns {Promise<object>} the answer, with `path`, columns of the nose tip and the speed, and what was given of
 *   `projectile`, `target` and all `values`
 */
export async function computeRun(values, signal) {
  const requestRun = async (time) => {
    const least = (values.numerics?.termination_time_s ?? TERMINATION_S) / MOST_ROWS;
    const interval = Math.max(nice(time / INSTANTS), least);
    return (await request("trajectory", { body: trajectoryRequest(values, interval), signal })).data;
  };
  let run = await requestRun(duration ?? (3 * values.projectile.length_m) / values.impact.velocity_m_s);
  duration = run.final.time_s;
  const rows = run.history.time_s.length;
  if (rows < FEWEST || rows > MOST) run = await requestRun(duration);
  return { ...run, path: pathOf(run.history, values.projectile), projectile: values.projectile, target: values.target, values };
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

/** The next 1, 2 or 5 times a power of ten at or below: few intervals, so that results are found again. */
function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return Number(([5, 2, 1].find((step) => step * power <= value * (1 + 1e-9)) * power).toPrecision(3));
}
