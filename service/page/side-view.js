// The side view: the path of the nose tip through the face, to scale, with the projectile's outline at some instants. It is
// plain SVG, so that it appears before Plotly has loaded.

import { VIRIDIS, viridis } from "./colours.js";
import { svg } from "./elements.js";
import { aboutRuns } from "./exports.js";
import { closedOutline, placed } from "./outline.js";
import { colour, csvOf, drawingOf, place } from "./plots.js";
import { arcMarks, bendingMark, criticalMark, exitMark, faceNames, forceMarks, hole, protrusionMark } from "./side-view-marks.js";
import { nice, rowAt } from "./run.js";
import { unitOf } from "./units.js";
import { digits, endingShown, lengthShown, quantityShown } from "./words.js";

const OUTLINES = [6, 3]; // number for a single run, and for each run in a comparison
const SEGMENTS = 36; // parts of the first path, each in the colour of its speed
const [NARROW, CAPTIONED] = [640, 490]; // px
const NEAR = 2; // a rear face is in view if it is at less than this many times the greatest depth
const GRID_M = 0.1; // the picture ends at multiples of this, so that it does not jitter while a slider moves
const MARGIN = { left: 54, right: 12, top: 10, bottom: 38 }; // px
const MOST_TICK_PX = 225; // largest distance between grid lines; the least is 90, or less in a narrow picture
const LINE_PX = 14;
const LETTER_PX = 7;

const scenes = new WeakMap(); // scenes by the elements in which they are drawn

/**
 * Draw one or more runs.
 *
 * @param {HTMLElement} root
 * @param {{run: object, name: string}[]} runs as `computeRun` returns them; the first has a movable outline, and is coloured by
 *   its speed; the others have one colour each
 * @param {number} row index into the first run's history, at which its outline is emphasised
 * @param {{critical?: number, turns?: boolean, isHeld?: boolean, beside?: object[], caption?: string}} options `critical` is the critical angle to mark
 *   [°]; `turns` leaves room for every oblique angle, so that the scale is the same for all of them; `isHeld` keeps the previous frame;
 *   `caption` is shown above the picture; `beside` are the runs of an adjacent picture, for which there is room too, so that both have the same scale
 */
export function drawSideView(root, runs, row, options = {}) {
  if (!root.isConnected) return;
  const before = scenes.get(root);
  const scene = { runs, row, options, frame: options.isHeld ? before?.frame : undefined };
  scenes.set(root, scene);
  render(root, scene);
}

/** Move the emphasised outline to another row of the history, and those of compared runs to the same time. */
export function moveOutline(root, row) {
  const scene = scenes.get(root);
  scene.row = row;
  render(root, scene);
}

/** Mark another critical angle or, with undefined, none. */
export function markCritical(root, critical) {
  const scene = scenes.get(root);
  if (!scene) return;
  scene.options.critical = critical;
  render(root, scene);
}

/** Return the position of the point of contact in a drawing [px], and the scale [px/m]. */
export function contactOf(root) {
  const { origin, scale } = scenes.get(root).frame;
  return [origin, scale];
}

/** Return the row of the history whose point on the path is nearest to a position in the drawing [px]; undefined if none is near. */
export function rowNear(root, [x, y], most = 40) {
  const { runs, frame } = scenes.get(root);
  const { lateral, depth } = runs[0].run.path;
  const away = lateral.map((along, row) => Math.hypot(frame.at([along, depth[row]])[0] - x, frame.at([along, depth[row]])[1] - y));
  const least = Math.min(...away);
  return least < most ? away.indexOf(least) : undefined;
}

function render(root, scene) {
  const { runs, row, options } = scene;
  const [{ run: own }, ...others] = runs;
  const size = sizeOf(root, others.length ? NARROW : options.caption ? CAPTIONED : 0);
  const isNarrow = size.width < NARROW;
  const range = [0, Math.max(...own.path.speed)];
  const count = OUTLINES[Math.min(others.length, 1)];
  const marksOf = (run) => [...arcMarks(run, isNarrow), ...criticalMark(run, options.critical, isNarrow), ...exitMark(run, isNarrow), ...protrusionMark(run), ...bendingMark(run)];
  const marks = marksOf(own);
  const outlinesOf = (run) => evenRows(run, count).map((each) => outlineAt(run, each));
  const outlines = outlinesOf(own);
  const compared = others.map(({ run }) => outlinesOf(run));
  const moving = outlineAt(own, row);
  const time = own.history.time_s[row];
  const besides = others.map(({ run }) => outlineAt(run, rowAt(run, time))); // all strikes are shown at the same instant
  const beside = (options.beside ?? []).flatMap((run) => [pathOf(run), ...outlinesOf(run), ...marksOf(run).map(({ points }) => points ?? [])]);
  const lines = [...outlines, ...compared.flat(), ...runs.map(({ run }) => pathOf(run)), ...marks.map(({ points }) => points ?? []), ...beside];
  scene.frame ??= frameOf(size, lines.flat(), own, options.turns ? own.projectile.length_m : 0);
  const { frame } = scene;
  const parts = [
    ...solid(own, frame),
    shape(hole(own), { class: "hole", fill: colour("panel") }),
    ...compared.flatMap((all, i) => all.map((points) => shape(points, { stroke: colour(`run-${i + 1}`), "stroke-width": 1.2, "stroke-dasharray": "2 2" }))),
    ...outlines.map((points, i) =>
      shape(points, { fill: viridis(own.path.speed[evenRows(own, count)[i]], range, 0.35), stroke: colour("edge") }),
    ),
    shape(moving, { class: "moving", fill: viridis(own.path.speed[row], range, 0.6), stroke: colour("text"), "stroke-width": 2.5 }),
    ...besides.map((points, i) => shape(points, { class: "beside", stroke: colour(`run-${i + 1}`), "stroke-width": 2.5 })),
    ...runs.map(({ run, name }, i) => {
      const stroke = colour(i ? `run-${i}` : "accent");
      return shape(pathOf(run), { class: "path", "data-name": name, stroke, "stroke-width": 2 }, "");
    }),
    ...speedSegments(own, range),
    ...[...marks, ...forceMarks(own, row)].filter(({ points }) => points).map(({ points, ...rest }) => shape(points, rest, "")),
  ];
  const drawing = svg("g", { class: "metres", transform: `translate(${frame.origin}) scale(${frame.scale})` }, ...parts);
  const words = labels([...faceNames(own.target.thickness_m, frame), ...marks, ...forceMarks(own, row)].filter(({ text }) => text), frame);
  const picture = svg(
    "svg",
    { viewBox: `0 0 ${size.width} ${size.height}`, width: size.width, height: size.height, "font-size": 12, fill: colour("text"), stroke: "none" },
    svg("clipPath", { id: "frame" }, svg("rect", frame.box)),
    ...axes(frame),
    svg("g", { "clip-path": "url(#frame)" }, drawing),
    ...words,
    ...legend(runs, range, size, options.caption),
  );
  place(root, picture, {
    title: `Side view: ${runs.map(({ run }) => endingShown(run)).join(", ")}`,
    ...aboutRuns(runs),
    again: () => render(root, scene),
    csv: () => csvOf(runs.flatMap(rowsOf)),
    label: `Side view to scale. ${runs.map(inWords).join(" ")}`,
  });
}

/** Return the size of a picture, and the baseline of its colour key: beside the legend or, if there is no room, below it. */
function sizeOf(root, roomy) {
  const { clientWidth: width, clientHeight: height } = drawingOf(root);
  return { width: Math.max(width, 240), height: Math.max(height, 200), key: width < roomy ? 16 + LINE_PX : 16 };
}

function evenRows({ history: { time_s: time } }, count) {
  return Array.from({ length: count }, (_, i) => Math.round((i * (time.length - 1)) / (count - 1)));
}

function outlineAt({ path, projectile }, row) {
  const { x, y } = placed(closedOutline(projectile), { lateral: path.lateral[row], depth: path.depth[row], angle: path.angle[row] });
  return x.map((along, i) => [along, y[i]]);
}

function pathOf({ path }) {
  return path.lateral.map((along, row) => [along, path.depth[row]]);
}

/** Return a path in metres whose strokes keep their width in pixels. `null` points separate its parts; `end` closes each part. */
function shape(points, attributes, end = "Z") {
  let d = "";
  let isOpen = false;
  for (const point of points) {
    if (point) d += `${isOpen ? "L" : "M"}${point.map((value) => Number(value.toPrecision(6))).join(" ")}`;
    else if (isOpen) d += end;
    isOpen = Boolean(point);
  }
  return svg("path", { d: isOpen ? d + end : d, fill: "none", "vector-effect": "non-scaling-stroke", ...attributes });
}

/** Return the path as segments coloured by the speed. */
function speedSegments(run, range) {
  const points = pathOf(run);
  const rows = evenRows(run, Math.min(SEGMENTS, points.length));
  return rows.slice(1).map((row, i) =>
    shape(points.slice(rows[i], row + 1), { stroke: viridis(run.path.speed[row], range, 1), "stroke-width": 4, "stroke-linecap": "round" }, ""),
  );
}

/** Return the frame that shows every point to scale, in the middle of the picture. */
function frameOf({ width, height, key }, points, { target: { thickness_m: wall = Infinity } }, room) {
  const ends = (axis) => {
    const values = points.filter(Boolean).map((point) => point[axis]);
    const [least, most] = [Math.min(...values, -room), Math.max(...values, GRID_M / 2)];
    return [Math.floor(least / GRID_M) * GRID_M, Math.ceil(most / GRID_M) * GRID_M];
  };
  const [[left, right], [top, deepest]] = [ends(0), ends(1)];
  const bottom = wall < NEAR * deepest ? Math.max(deepest, wall + GRID_M / 2) : deepest;
  const box = { x: MARGIN.left, y: key + MARGIN.top, width: width - MARGIN.left - MARGIN.right, height: height - key - MARGIN.top - MARGIN.bottom };
  const scale = Math.min(box.width / (right - left), box.height / (bottom - top));
  const origin = [box.x + box.width / 2 - ((left + right) / 2) * scale, box.y + box.height / 2 - ((top + bottom) / 2) * scale];
  const at = ([along, depth]) => [origin[0] + along * scale, origin[1] + depth * scale];
  return { box, scale, origin, at };
}

/** Return the concrete and its faces. */
function solid({ target: { thickness_m: wall } }, { box, origin, scale }) {
  const [left, right] = [(box.x - origin[0]) / scale, (box.x + box.width - origin[0]) / scale];
  const end = wall ?? (box.y + box.height - origin[1]) / scale;
  const face = (depth) => shape([[left, depth], [right, depth]], { class: "face", stroke: colour("edge"), "stroke-width": 1.5 }, "");
  const concrete = shape([[left, 0], [right, 0], [right, end], [left, end]], { class: "concrete", fill: colour("concrete") });
  return [concrete, face(0), ...(wall === undefined ? [] : [face(wall)])];
}

function axes({ box, origin, scale }) {
  const { unit, factor } = unitOf("m");
  const step = nice(Math.min(MOST_TICK_PX, box.width / 2.5) / scale / factor) * factor; // at least two lines
  const ticks = (from, to) => {
    const first = Math.ceil(from / step);
    return Array.from({ length: Math.max(Math.floor(to / step) - first + 1, 0) }, (_, i) => (first + i) * step);
  };
  const line = (x1, y1, x2, y2) => svg("line", { x1, y1, x2, y2, stroke: colour("grid") });
  const word = (x, y, text, anchor, rest = {}) => svg("text", { x, y, "text-anchor": anchor, ...rest }, text);
  const shown = (value) => `${Number((value / factor).toFixed(3))}`.replace("-", "−");
  const [right, bottom] = [box.x + box.width, box.y + box.height];
  return [
    ...ticks((box.x - origin[0]) / scale, (right - origin[0]) / scale).flatMap((along) => {
      const x = origin[0] + along * scale;
      return [line(x, box.y, x, bottom), word(x, bottom + LINE_PX, shown(along), "middle")];
    }),
    ...ticks((box.y - origin[1]) / scale, (bottom - origin[1]) / scale).flatMap((depth) => {
      const y = origin[1] + depth * scale;
      return [line(box.x, y, right, y), word(box.x - 5, y + 4, shown(depth), "end")];
    }),
    word(box.x + box.width / 2, bottom + 2.2 * LINE_PX, `Along the face [${unit}]`, "middle"),
    word(0, 0, `Depth [${unit}]`, "middle", { transform: `translate(12 ${box.y + box.height / 2}) rotate(-90)` }),
  ];
}

/** Return the colour key of the speed, and the names of the compared runs. */
function legend(runs, range, { width, key }, caption) {
  const stops = VIRIDIS.map(([offset, stop]) => svg("stop", { offset, "stop-color": stop }));
  const x = width - MARGIN.right - 150;
  const names = runs.length > 1 ? runs.map(({ name }) => name) : [];
  return [
    svg("linearGradient", { id: "speeds" }, ...stops),
    svg("rect", { x, y: key - 8, width: 100, height: 8, fill: "url(#speeds)" }),
    svg("text", { class: "key", x: x - 5, y: key, "text-anchor": "end" }, "Speed 0"),
    svg("text", { class: "key", x: x + 105, y: key }, quantityShown(range[1], "m/s")),
    ...(caption ? [svg("text", { class: "caption", x: MARGIN.left, y: 16, "font-weight": "bold" }, caption)] : []),
    ...names.flatMap((name, i) => [
      svg("line", { x1: MARGIN.left + i * 92, x2: MARGIN.left + 16 + i * 92, y1: 12, y2: 12, stroke: colour(i ? `run-${i}` : "accent"), "stroke-width": 3 }),
      svg("text", { class: "legend", x: MARGIN.left + 20 + i * 92, y: 16 }, name),
    ]),
  ];
}

/** Return the labels at their positions; one that would overlap another is moved below it or, in the corner, above it. */
function labels(marks, { at, box }) {
  const taken = [];
  return marks.map(({ at: point, text, side = "right", color = colour("quiet") }) => {
    const rows = text.split("\n");
    const length = Math.max(...rows.map((row) => row.length)) * LETTER_PX;
    let [x, y] = point === undefined ? [box.x, box.y + box.height - 18] : at(point); // the corner, above a rear face
    x += { right: 5, left: -5, above: 0 }[side] - { right: 0, left: length, above: length / 2 }[side];
    x = Math.min(Math.max(x, box.x), box.x + box.width - length);
    y = Math.min(Math.max(y + (side === "above" ? -6 : 4), box.y + LINE_PX), box.y + box.height - 4 - (rows.length - 1) * LINE_PX);
    const hits = (other) => x < other.x + other.length && other.x < x + length && y - LINE_PX < other.y + other.height - LINE_PX && other.y - LINE_PX < y + (rows.length - 1) * LINE_PX;
    for (let tries = 0; tries < 8 && taken.some(hits); tries += 1) y += point === undefined ? -LINE_PX : LINE_PX;
    taken.push({ x, y, length, height: rows.length * LINE_PX });
    const lines = rows.map((row, i) => svg("tspan", { x, dy: i ? LINE_PX : 0 }, row));
    const halo = { stroke: colour("panel"), "stroke-width": 3, "paint-order": "stroke", "stroke-linejoin": "round" };
    return svg("text", { class: "mark", x, y, fill: color, ...halo }, ...lines);
  });
}

function rowsOf({ run: { history, path }, name }) {
  return history.time_s.map((time, row) => ({
    ...{ run: name, time_s: time, nose_tip_lateral_m: path.lateral[row], nose_tip_depth_m: path.depth[row] },
    ...{ axis_angle_deg: history.axis_angle_deg[row], speed_m_s: path.speed[row] },
  }));
}

function inWords({ run, name }) {
  const { outcome, final, maximum_depth_m: depth, target } = run;
  const reach = outcome === "perforated" ? `wall of ${lengthShown(target.thickness_m)}` : `${lengthShown(depth)} deep at most`;
  return `${name}: ${endingShown(run)} after ${digits(final.time_s * 1e3)} ms, ${reach}.`;
}
