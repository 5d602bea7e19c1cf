// Marks of the side view: angles at first contact, critical angle, hole, exit, forces and faces. A mark has `points` of a line, or a `text` at
// a position `at` or, without one, in the lower left corner, where no body goes. Positions are along the face and depth [m].

import { closedOutline, centreOfGravity, placed } from "./outline.js";
import { colour } from "./plots.js";
import { rowAt } from "./run.js";
import { degreesShown, isNoise, lengthShown, quantityShown } from "./words.js";

const RADIAN = Math.PI / 180;
const SWEPT = 48; // instants whose outlines together form the hole
const THINNED = 20; // least number of outline points with which the hole uses only every fourth point of the nose
const ARC_POINTS = 16;
const LEAST_DEG = 0.05; // smaller angles of attack have no mark of their own
/** Distances of marks from the point of contact, and lengths of the arrows `exit` and `force`, in projectile lengths. */
const RADII = { theta: 0.6, delta: 0.82, phi: 0.42, normal: 0.95, critical: 1.12, exit: 0.3, force: 0.45 };

/** Return the concrete that the projectile passed through, as polygons separated by `null`. */
export function hole({ path, projectile, target }) {
  const whole = closedOutline(projectile);
  const radius = projectile.diameter_m / 2;
  const isKept = ([, off], i) => whole.length < THINNED || i % 4 === 0 || Math.abs(off) >= radius * (1 - 1e-9);
  const outline = whole.filter(isKept);
  const last = path.depth.length - 1;
  const rows = Array.from({ length: SWEPT }, (_, i) => Math.round((i * last) / (SWEPT - 1)));
  return rows.flatMap((row) => {
    const { x, y } = placed(outline, { lateral: path.lateral[row], depth: path.depth[row], angle: path.angle[row] });
    const below = cut(x.map((across, i) => [across, y[i]]), (depth) => depth);
    const part = cut(below, (depth) => (target.thickness_m ?? Infinity) - depth);
    return part.length > 2 ? [...part, null] : [];
  });
}

/** Return the names of the faces; the name of the rear face is below it, unless the picture ends there. */
export function faceNames(thickness, { box, origin, scale }) {
  const right = (box.x + box.width - origin[0]) / scale;
  const name = (text, depth, below) => ({ at: [right, depth + (below ? 11 : -7) / scale], text, side: "left" });
  if (!(origin[1] + thickness * scale < box.y + box.height)) return [name("face", 0)]; // there is no rear face in the picture
  const isLast = origin[1] + thickness * scale > box.y + box.height - 24;
  return [name("face", 0), name("rear face", thickness, !isLast)];
}

/** Return the normal, the arcs of θ to the velocity and φ to the axis and, if there is an angle of attack, δ between them. */
export function arcMarks({ values, history, projectile: { length_m: length } }, isNarrow) {
  const theta = values.impact.oblique_angle_deg;
  const phi = history.axis_angle_deg[0];
  const ray = (angle) => line([[0, 0], from(angle, RADII.normal * length)]);
  const arc = (begin, end, radius) =>
    line(Array.from({ length: ARC_POINTS + 1 }, (_, i) => from(begin + (i / ARC_POINTS) * (end - begin), radius * length)));
  const word = (text, radius) => ({ at: besideNormal(radius * length), text });
  const top = isNarrow ? RADII.normal : RADII.theta; // farther out in a narrow picture, clear of the label of the exit
  if (Math.abs(phi - theta) < LEAST_DEG) return [ray(0), arc(0, theta, RADII.theta), word(`θ = φ = ${shown(theta)}`, top)];
  return [
    ...[ray(0), ray(theta), arc(0, theta, RADII.theta), arc(0, phi, RADII.phi), arc(theta, phi, RADII.delta)],
    word(`θ = ${shown(theta)}`, top),
    word(`φ = ${shown(phi)}`, RADII.phi),
    { at: from((theta + phi) / 2, (RADII.delta + 0.03) * length), text: `δ = ${shown(phi - theta)}`, side: "left" },
  ];
}

/** Return a line at the critical angle, with its label at the outer end, away from the projectile or, in a narrow picture, above it. */
export function criticalMark({ values, projectile: { length_m: length } }, critical, isNarrow) {
  if (critical === undefined) return [];
  const color = colour("path");
  const end = from(critical, RADII.critical * length);
  const side = critical > values.impact.oblique_angle_deg && !isNarrow ? "left" : "above";
  const text = `critical ${degreesShown(critical, 1)}`;
  return [
    line([from(critical, 0.12 * length), end], { class: "critical", stroke: color, "stroke-width": 1.5, "stroke-dasharray": "6 3 1 3" }),
    { at: end, text, side, color },
  ];
}

/** Return an arrow in the direction in which the projectile leaves, with its label. */
export function exitMark({ exit, final, path, projectile: { length_m: length } }, isNarrow) {
  if (!exit) return [];
  const tip = [path.lateral.at(-1), path.depth.at(-1)];
  const reach = (RADII.exit * length) / exit.speed_m_s;
  const direction = [reach * final.lateral_velocity_m_s, reach * final.depth_velocity_m_s];
  const text = `exit ${quantityShown(exit.speed_m_s, "m/s")}${isNarrow ? "" : `\n${quantityShown(exit.elevation_deg, "°")} from the face`}`;
  const side = final.depth_velocity_m_s < 0 ? "above" : isNarrow ? "left" : "right";
  const end = tip.map((value, i) => value + direction[i] - (i && side === "above" ? 0.05 * length : 0)); // position of the label
  return [arrow(tip, direction, colour("accent"), "exit"), { at: end, text, side, color: colour("accent") }];
}

/** Return a label beside the nose tip with how far a body at rest protrudes from the rear face of a wall. */
export function protrusionMark({ outcome, protrusion, path, projectile: { diameter_m: diameter } }) {
  if (outcome !== "embedded" || !protrusion?.final_m) return [];
  const at = [path.lateral.at(-1) + diameter, path.depth.at(-1)];
  return [{ at, text: `nose ${lengthShown(protrusion.final_m)} out`, color: colour("bad") }];
}

/** Return a line across the body at the largest bending stress, at the instant when it occurs, with its label. */
export function bendingMark({ bending, history, path, projectile: { diameter_m: diameter } }) {
  if (!bending || isNoise(bending.peak_stress_pa, "MPa")) return [];
  const row = rowAt({ history }, bending.time_s);
  const angle = path.angle[row];
  const behind = bending.distance_behind_tip_m;
  const place = [path.lateral[row] - behind * Math.sin(angle), path.depth[row] - behind * Math.cos(angle)];
  const across = [Math.cos(angle), -Math.sin(angle)].map((each) => 0.6 * diameter * each);
  const ends = [-1, 1].map((sign) => place.map((value, i) => value + sign * across[i]));
  return [
    line(ends, { class: "bending", stroke: colour("bad"), "stroke-width": 2, "stroke-dasharray": "3 2" }),
    { text: `bends most: ${quantityShown(bending.peak_stress_pa, "MPa")}`, color: colour("bad") },
  ];
}

/** Return an arrow for the force on the projectile at an instant, where it acts on the axis; its length is relative to the greatest force of the run. */
export function forceMarks({ history, path, projectile }, row) {
  const force = [history.lateral_force_n[row], history.depth_force_n[row]];
  const size = Math.hypot(...force);
  const most = Math.max(...history.depth_force_n.map((each, i) => Math.hypot(each, history.lateral_force_n[i])));
  if (!(size > 0.01 * most)) return []; // also if there is no force at all
  const angle = path.angle[row];
  const across = force[0] * Math.cos(angle) - force[1] * Math.sin(angle);
  const ahead = across ? history.moment_n_m[row] / across : 0; // distance ahead of the centre of gravity, along the axis
  const behind = Math.min(Math.max(centreOfGravity(projectile) - ahead, 0), projectile.length_m);
  const place = [path.lateral[row] - behind * Math.sin(angle), path.depth[row] - behind * Math.cos(angle)];
  const reach = (RADII.force * projectile.length_m) / most;
  const direction = force.map((each) => each * reach);
  return [arrow(place, direction, colour("bad"), "force"), { text: `force ${quantityShown(size, "kN")}`, color: colour("bad") }];
}

function line(points, attributes = {}) {
  return { points, stroke: colour("quiet"), "stroke-width": 1, ...attributes };
}

/** Return an arrow whose head is proportional to its length. */
function arrow(start, direction, color, name) {
  const end = start.map((value, i) => value + direction[i]);
  const wing = (sign) => [0, 1].map((i) => end[i] - 0.22 * direction[i] + (i ? -sign : sign) * 0.1 * direction[1 - i]);
  return line([start, end, null, wing(1), end, wing(-1)], { class: name, stroke: color, "stroke-width": 2.5 });
}

/** Return a position beside the normal at a distance from the point of contact, on the side without outlines. */
const besideNormal = (distance) => [0.05 * distance, from(0, distance)[1]];

/** Return the position outside the face at an angle from the normal, at a distance from the point of contact. */
const from = (angle, distance) => [-distance * Math.sin(angle * RADIAN), -distance * Math.cos(angle * RADIAN)];

const shown = (angle) => `${Number(angle.toFixed(2))}°`;

/** Return the part of a convex polygon where a linear function of the depth is positive. */
function cut(polygon, inside) {
  return polygon.flatMap((point, i) => {
    const before = polygon.at(i - 1);
    const [a, b] = [inside(before[1]), inside(point[1])];
    const crossing = before.map((value, k) => value + (a / (a - b)) * (point[k] - value));
    if (a > 0 !== b > 0) return b > 0 ? [crossing, point] : [crossing];
    return b > 0 ? [point] : [];
  });
}
