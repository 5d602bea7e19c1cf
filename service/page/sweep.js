// Maps, which are sweeps over two fields. The address of a map holds its case, its axes and its job.

import { caseQuery, readCase } from "./address.js";
import { angleRequest, trajectoryRequest, valueAt, withValue } from "./case.js";
import { paperCase } from "./contract.js";
import { DIAMETER, boundsOf, fieldAt, isSphere } from "./fields.js";

/**
 * Operations that a map can show, with the `path` and the `base` of their sweeps. `most` limits the values of an axis; the default is 100,
 * because a picture could not show more. If an operation `isSlow`, not even a few of its cases are answered at once.
 */
export const OPERATIONS = {
  cra: { label: "Critical angle", path: "cra/sweep", base: angleRequest },
  trajectory: { label: "Outcome (phase diagram)", path: "trajectory/sweep", base: trajectoryRequest },
  thickness: { label: "Least thickness at an angle", path: "thickness/sweep", base: ({ search, ...values }) => withValue(values, THICKNESS), isSlow: true },
  probability: { label: "Probability of ricochet at an angle", path: "trajectory/uncertainty/sweep", base: trajectoryRequest, most: 12, isSlow: true },
};

export const AT_ONCE = 100; // cases that the service answers without a job
const THICKNESS = "target.thickness_m";
const ANGLE = "impact.oblique_angle_deg";
const MOST_READ = 1000; // limit on the values of an axis in an address: far more than a map accepts, and few enough for memory
const COUNT = 9; // default number of values of an axis
const [SPEED, STRENGTH] = ["impact.velocity_m_s", "target.compressive_strength_pa"];

/**
 * Return the map that a query describes.
 *
 * @param {URLSearchParams} query
 * @returns {{values: object, operation: keyof OPERATIONS, x: Axis, y: Axis, job: string}} `values` is the case of
 *   every point except for its two fields; an axis has `field`, `start` and `stop` in SI units, and `count`
 */
export function readMap(query) {
  const values = readCase(query);
  const operation = query.get("operation") in OPERATIONS ? query.get("operation") : "cra";
  const [x, y] = usualAxes(operation, values);
  return { values, operation, x: readAxis(query.get("x")) ?? x, y: readAxis(query.get("y")) ?? y, job: query.get("job") ?? "" };
}

/** Return the default axes of a map: speed and angle for a phase diagram, else speed and strength. */
export function usualAxes(operation, values) {
  return [SPEED, operation === "trajectory" ? ANGLE : STRENGTH].map((field) => around(field, values));
}

/** Return an axis around the value of a case. */
export function around(field, values) {
  if (field === ANGLE) return { field, start: 5, stop: 85, count: COUNT };
  const { least = -Infinity, above = least, most = Infinity, below = most } = boundsOf({ path: field, factor: 1 }, values);
  const value = valueAt(values, field);
  const [low, high] = value ? [0.6 * value, 1.4 * value].sort((a, b) => a - b) : [0, 1];
  const end = (wanted) => Math.min(Math.max(Number(wanted.toPrecision(2)), above), below);
  return { field, start: end(low), stop: end(high), count: COUNT };
}

/** Return whether the value of a case is between the ends of an axis. */
export function isOn({ field, start, stop }, values) {
  const value = valueAt(values, field);
  return value === undefined || (value >= start && value <= stop);
}

/** Return whether two maps show the same, apart from their jobs and the values of the case in the fields that vary. */
export function isSame(one, other) {
  const bare = (map) => {
    const values = [map.x.field, map.y.field].reduce((rest, path) => withValue(rest, path), map.values);
    return mapQuery({ ...map, values, job: "" }).toString();
  };
  return bare(one) === bare(other);
}

/** Return the name in `OPERATIONS` of the map that can show the results of a job; undefined unless the job is a sweep over two fields. */
export function mapNameOf({ operation, axes }) {
  const path = `${operation.replace("_", "/")}/sweep`;
  return axes?.length === 2 ? Object.keys(OPERATIONS).find((name) => OPERATIONS[name].path === path) : undefined;
}

/** Return the map that a job computes; undefined if its results cannot be shown as a map. */
export function mapOfJob({ id, request, ...job }) {
  const operation = mapNameOf(job);
  if (!request || !operation) return undefined;
  const { output, uncertain, sampling, ...parts } = request.base;
  const values = { ...paperCase() };
  for (const [part, content] of Object.entries(parts)) values[part] = typeof content === "object" ? { ...values[part], ...content } : content;
  const [y, x] = request.axes.map(({ values: list, ...axis }) => (list ? { ...axis, start: list[0], stop: list.at(-1), count: list.length, list } : axis));
  return { values, operation, x, y, job: id, study: uncertain && { uncertain, sampling } };
}

/** Return the query that describes a map. */
export function mapQuery({ values, operation, x, y, job }) {
  const written = ({ field, start, stop, count }) => [field, start, stop, count].join(",");
  const query = new URLSearchParams({ operation, x: written(x), y: written(y) });
  if (job) query.set("job", job);
  for (const [path, value] of caseQuery(values)) query.set(path, value);
  return query;
}

/** Return the path and the body of the sweep for a map, row by row from left to right; `study` has the inputs and samples of probabilities. */
export function sweepRequest({ values, operation, x, y, study }) {
  const { path, base } = OPERATIONS[operation];
  return { path, body: { base: { ...base(values), ...study }, axes: [y, x] } };
}

/** Return whether a map has so few cases that they are answered at once. */
export function isSmall({ operation, x, y }) {
  return !OPERATIONS[operation].isSlow && x.count * y.count <= AT_ONCE;
}

/** Return at most `most` places, evenly spaced from end to end. */
export function evenly(count, most) {
  if (count <= most) return Array.from({ length: count }, (_, i) => i);
  return Array.from({ length: most }, (_, i) => Math.round((i * (count - 1)) / (most - 1)));
}

/** Return whether an axis is the oblique angle. */
export const isOfAngle = ({ field }) => field === ANGLE;

/** Return whether the cases of a map have an oblique angle. */
export const hasAngle = ({ operation }) => operation !== "cra";

/** Return whether a field can be on an axis of a map: a search for the critical angle has no oblique angle to vary. */
export function isVariable(map, field) {
  const fixed = [map.operation === "thickness" && THICKNESS, isSphere(map.values) && DIAMETER]; // the result; a sphere's length would have to vary too
  return !fixed.includes(field) && (hasAngle(map) ? !field.startsWith("search.") : field !== ANGLE);
}

/** Return the values of an axis, both ends included. */
export function numbers({ start, stop, count, list }) {
  if (list) return list;
  if (count === 1) return [start];
  const step = (stop - start) / (count - 1);
  return Array.from({ length: count }, (_, i) => (i === count - 1 ? stop : start + step * i));
}

/** Return the case of a cell; `angle` is its critical angle, if there is one [°]. */
export function caseAt({ values, x, y }, { column, row }, angle) {
  let found = withValue(values, x.field, numbers(x)[column]);
  found = withValue(found, y.field, numbers(y)[row]);
  return angle === undefined ? found : withValue(found, ANGLE, Number(angle.toFixed(2)));
}

/** Parse the axis in an address; undefined if it cannot be read. */
export function readAxis(text) {
  const [field, ...rest] = (text ?? "").split(",");
  const [start, stop, count] = rest.map(Number);
  const isRight = fieldAt(field)?.kind === "number" && Number.isInteger(count) && count >= 1 && count <= MOST_READ;
  return isRight && Number.isFinite(start) && Number.isFinite(stop) ? { field, start, stop, count } : undefined;
}
