// What the side view names: the angles at first contact, the critical one, the hole, the exit, the faces.

import { closedOutline, placed } from "./outline.js";
import { colour } from "./plots.js";
import { degreesShown, digits } from "./words.js";

const RADIAN = Math.PI / 180;
const CRITICAL = "critical"; // name of the trace of the critical angle
const SWEPT = 48; // instants whose outlines together are the hole
const THINNED = 20; // points of an outline, above which the hole takes every fourth of its nose
const ARC_POINTS = 16;
const NAME_SHARE = 0.08; // of the height of the picture: the room for the name of a face
const LEAST_DEG = 0.05; // smaller angles of attack have no mark of their own
/** Distances from the point of contact, in lengths of the projectile. */
const RADII = { theta: 0.6, delta: 0.82, phi: 0.42, normal: 0.95, critical: 1.12, criticalBeside: 0.68, exit: 0.3 };

/** Return the traces of what is marked, to go over the outlines; in a narrow picture in fewer words. */
export function markTraces(run, critical, isNarrow) {
  return [...angleTraces(run, isNarrow), criticalTrace(run, critical, isNarrow), ...exitTraces(run, isNarrow)];
}

/** Return a restyling of the mark of the critical angle, for `Plotly.restyle`, with the place of its trace. */
export function criticalChange(plot, run, critical, isNarrow) {
  const { x, y, text, textposition } = criticalTrace(run, critical, isNarrow);
  return [{ x: [x], y: [y], text: [text], textposition }, [plot.data.findIndex(({ name }) => name === CRITICAL)]];
}

/** Return the concrete that the projectile went through, as a trace to go below the outlines. */
export function holeTrace({ path, projectile, target }) {
  const whole = closedOutline(projectile);
  const radius = projectile.diameter_m / 2;
  const isKept = ([, off], i) => whole.length < THINNED || i % 4 === 0 || Math.abs(off) >= radius * (1 - 1e-9);
  const outline = whole.filter(isKept);
  const last = path.depth.length - 1;
  const rows = Array.from({ length: SWEPT }, (_, i) => Math.round((i * last) / (SWEPT - 1)));
  const parts = rows.map((row) => {
    const { x, y } = placed(outline, { lateral: path.lateral[row], depth: path.depth[row], angle: path.angle[row] });
    const below = cut(x.map((across, i) => [across, y[i]]), (depth) => depth);
    return cut(below, (depth) => (target.thickness_m ?? Infinity) - depth);
  });
  const swept = parts.filter((part) => part.length > 2).flatMap((part) => [...part, part[0], [null, null]]);
  return {
    x: swept.map(([x]) => x),
    y: swept.map(([, y]) => y),
    mode: "lines",
    fill: "toself",
    fillcolor: colour("panel"),
    line: { width: 0 },
    hoverinfo: "skip",
    showlegend: false,
  };
}

/**
 * Return the names of the faces, for the layout; that of the rear face is below it, but where the picture ends there.
 *
 * @param {number|undefined} thickness of a wall [m]
 * @param {number} top of the picture, as a depth [m]
 * @param {number} bottom of the picture [m]
 */
export function faceNames(thickness, top, bottom) {
  const name = (text, y, yanchor) => {
    const font = { color: colour("quiet"), size: 11 };
    return { text, x: 1, y, xref: "paper", yref: "y", xanchor: "right", yanchor, showarrow: false, font, borderpad: 2 };
  };
  if (thickness === undefined) return [name("face", 0, "bottom")];
  const isLast = thickness > bottom - NAME_SHARE * (bottom - top);
  return [name("face", 0, "bottom"), name("rear face", thickness, isLast ? "bottom" : "top")];
}

/**
 * The normal, and arcs from it: θ to the velocity, φ to the axis, and δ between them where there is an angle of attack. All
 * lines are one trace and all words another: each trace costs milliseconds.
 */
function angleTraces({ values, history, projectile: { length_m: length } }, isNarrow) {
  const theta = values.impact.oblique_angle_deg;
  const phi = history.axis_angle_deg[0];
  const ray = (angle) => [[0, 0], from(angle, RADII.normal * length)];
  const arc = (begin, end, radius) =>
    Array.from({ length: ARC_POINTS + 1 }, (_, i) => from(begin + (i / ARC_POINTS) * (end - begin), radius * length));
  const beside = (radius) => besideNormal(radius * length);
  const top = isNarrow ? RADII.normal : RADII.theta; // above the words on the exit
  const [toTheta, toPhi] = [arc(0, theta, RADII.theta), arc(0, phi, RADII.phi)];
  if (Math.abs(phi - theta) < LEAST_DEG) {
    return [linesTrace([ray(0), toTheta]), labelsTrace([[beside(top), `θ = φ = ${shown(theta)}`, "right"]])];
  }
  return [
    linesTrace([ray(0), ray(theta), toTheta, toPhi, arc(theta, phi, RADII.delta)]),
    labelsTrace([
      [beside(top), `θ = ${shown(theta)}`, "right"],
      [beside(RADII.phi), `φ = ${shown(phi)}`, "right"],
      [from((theta + phi) / 2, (RADII.delta + 0.03) * length), `δ = ${shown(phi - theta)}`, "left"],
    ]),
  ];
}

/** The critical angle: named at its outer end, away from the projectile; in a narrow picture beside the normal. */
function criticalTrace({ values, projectile: { length_m: length } }, critical, isNarrow) {
  const points = critical === undefined ? [] : [0.12, RADII.critical].map((radius) => from(critical, radius * length));
  const text = points.length ? ["", `critical ${degreesShown(critical)}`] : [];
  if (points.length && isNarrow) {
    points.push([null, null], besideNormal(RADII.criticalBeside * length));
    text.splice(1, 0, "", "");
  }
  const away = critical > values.impact.oblique_angle_deg ? "middle left" : "top center";
  return {
    ...lineTrace(points, { dash: "dashdot", color: colour("path"), width: 1.5 }),
    name: CRITICAL,
    mode: "lines+text",
    text,
    textposition: isNarrow ? "middle right" : away,
    cliponaxis: false,
    textfont: { color: colour("path") },
  };
}

/** An arrow in the direction in which a projectile leaves. */
function exitTraces({ exit, final, path, projectile: { length_m: length } }, isNarrow) {
  if (!exit) return [];
  const tip = [path.lateral.at(-1), path.depth.at(-1)];
  const reach = (RADII.exit * length) / exit.speed_m_s;
  const end = [tip[0] + reach * final.lateral_velocity_m_s, tip[1] + reach * final.depth_velocity_m_s];
  return [
    {
      ...lineTrace([tip, end], { color: colour("accent"), width: 2 }),
      mode: "lines+markers+text",
      marker: { symbol: "arrow", angleref: "previous", size: 12, opacity: [0, 1], color: colour("accent") },
      text: ["", `exit ${digits(exit.speed_m_s)} m/s${isNarrow ? "" : `<br>${digits(exit.elevation_deg)}° from the face`}`],
      textposition: final.depth_velocity_m_s < 0 ? "top left" : isNarrow ? "middle left" : "top right",
      cliponaxis: false,
    },
  ];
}

function lineTrace(points, line = {}) {
  return {
    x: points.map(([x]) => x),
    y: points.map(([, y]) => y),
    mode: "lines",
    line: { color: colour("quiet"), width: 1, ...line },
    hoverinfo: "skip",
    showlegend: false,
  };
}

/** Return lines as one trace, with gaps between them. */
function linesTrace(lines) {
  return lineTrace(lines.flatMap((points) => [...points, [null, null]]));
}

function labelsTrace(labels) {
  return {
    x: labels.map(([[x]]) => x),
    y: labels.map(([[, y]]) => y),
    text: labels.map(([, text]) => text),
    textposition: labels.map(([, , side]) => `middle ${side}`),
    mode: "text",
    hoverinfo: "skip",
    showlegend: false,
  };
}

/** A place beside the normal at a distance from the contact, on the side where no outline is. */
function besideNormal(distance) {
  return [0.05 * distance, from(0, distance)[1]];
}

/** Where a body comes from at an angle from the normal: along the face and depth, at a distance from the contact. */
function from(angle, distance) {
  return [-distance * Math.sin(angle * RADIAN), -distance * Math.cos(angle * RADIAN)];
}

function shown(angle) {
  return `${Number(angle.toFixed(2))}°`;
}

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
