// The side view: the path of the nose tip through the face, to scale, with the projectile's outline at some instants.

import { VIRIDIS, viridis } from "./colours.js";
import { aboutRuns } from "./exports.js";
import { closedOutline, placed } from "./outline.js";
import { colour, csvOf, draw, restyle } from "./plots.js";
import { criticalChange, faceNames, holeTrace, markTraces } from "./side-view-marks.js";
import { digits, outcomeShown } from "./words.js";

const OUTLINES = [6, 3]; // of a run by itself, and of each that is compared
const BEADS = 36; // coloured points of the first path: each costs a third of a millisecond
const NARROW = 640; // px
const FAR_M = 1e3; // deeper than any view
const NEAR = 2; // a rear face is in view up to this many times the depth that is reached
const MOVING = "moving"; // name of the trace of the outline that is moved
const GRID_M = 0.1; // ends of the axes, so that the view does not tremble while a slider moves
const EDGE_M = 0.02; // between what is drawn and the ends of the axis along the face

const marked = new WeakMap(); // critical angles by the element they are drawn into

/**
 * Draw one or more runs.
 *
 * @param {HTMLElement} root
 * @param {{run: object, name: string}[]} runs as `computeRun` returns them; the first has a movable outline and the colours of
 *   its speed, the others a colour each
 * @param {number} row of the first run's history at which its outline is emphasised
 * @param {{critical?: number, turns?: boolean, isHeld?: boolean}} options `critical` is the critical angle to mark [°];
 *   with `turns` there is room for every oblique angle, so that the scale stays while it changes; `isHeld` keeps the
 *   ranges of the axes as they are
 */
export async function drawSideView(root, runs, row, { critical, turns = false, isHeld = false } = {}) {
  const [{ run: own }, ...others] = runs;
  const range = [0, Math.max(...own.path.speed)];
  const count = OUTLINES[Math.min(others.length, 1)];
  const compared = others.map(({ run }, i) => comparedTrace(run, evenRows(run, count), i + 1));
  const outlines = evenRows(own, count).map((each) => outlineTrace(own, each, range));
  const paths = runs.map((each, i) => pathTrace(each, i, others.length > 0));
  const beads = beadTrace(own, evenRows(own, BEADS), range);
  const isNarrow = root.clientWidth < NARROW;
  const marks = markTraces(own, critical, isNarrow);
  marked.set(root, critical);
  const traces = [holeTrace(own), ...compared, ...outlines, movingTrace(own, row, range), ...paths, beads, ...marks];
  const held = isHeld ? root.querySelector(".drawing")?.layout : undefined;
  const room = turns ? [own.projectile.length_m] : [];
  return draw(root, traces, layoutOf(traces, others.length > 0 && (isNarrow ? -0.25 : -0.14), own.target.thickness_m, room, held), {
    title: `Side view: ${runs.map(({ run }) => outcomeShown(run.outcome)).join(", ")}`,
    ...aboutRuns(runs),
    again: () => drawSideView(root, runs, row, { critical: marked.get(root), turns }),
    csv: () => csvOf(tableOf(runs)),
    label: `Side view to scale. ${runs.map(inWords).join(" ")}`,
  });
}

/** Move the emphasised outline to another row of the history. */
export function moveOutline(root, run, row) {
  const { x, y, fillcolor } = movingTrace(run, row, [0, Math.max(...run.path.speed)]);
  const place = root.querySelector(".drawing")?.data?.findIndex(({ name }) => name === MOVING);
  return place >= 0 && restyle(root, { x: [x], y: [y], fillcolor: [fillcolor] }, [place]);
}

/** Mark another critical angle, or none. */
export function markCritical(root, run, critical) {
  const plot = root.querySelector(".drawing");
  marked.set(root, critical);
  return plot?.data && restyle(root, ...criticalChange(plot, run, critical, root.clientWidth < NARROW));
}

function evenRows({ history: { time_s: time } }, count) {
  return Array.from({ length: count }, (_, i) => Math.round((i * (time.length - 1)) / (count - 1)));
}

function outlineTrace(run, row, range) {
  const { path, projectile } = run;
  const tip = { lateral: path.lateral[row], depth: path.depth[row], angle: path.angle[row] };
  return {
    ...placed(closedOutline(projectile), tip),
    mode: "lines",
    fill: "toself",
    fillcolor: viridis(path.speed[row], range, 0.35),
    line: { color: colour("edge"), width: 1 },
    hoverinfo: "skip",
    showlegend: false,
  };
}

/** Outlines of a run that is compared, all in one trace. */
function comparedTrace({ path, projectile }, rows, index) {
  const outline = closedOutline(projectile);
  const all = rows.map((row) => placed(outline, { lateral: path.lateral[row], depth: path.depth[row], angle: path.angle[row] }));
  return {
    x: all.flatMap(({ x }) => [...x, null]),
    y: all.flatMap(({ y }) => [...y, null]),
    mode: "lines",
    line: { color: colour(`run-${index}`), width: 1.2, dash: "dot" },
    hoverinfo: "skip",
    showlegend: false,
  };
}

function movingTrace(run, row, range) {
  const trace = outlineTrace(run, row, range);
  const fillcolor = viridis(run.path.speed[row], range, 0.6);
  return { ...trace, name: MOVING, fillcolor, line: { color: colour("text"), width: 2.5 } };
}

/** The path as a line through every instant. */
function pathTrace({ run: { history, path }, name }, index, isCompared) {
  return {
    x: path.lateral,
    y: path.depth,
    customdata: history.time_s.map((time, row) => [time * 1e3, path.speed[row], history.axis_angle_deg[row]]),
    mode: "lines",
    name,
    meta: index,
    line: { color: colour(index ? `run-${index}` : isCompared ? "accent" : "text"), width: isCompared ? 2 : 1 },
    hovertemplate:
      "%{customdata[0]:.3f} ms<br>%{customdata[1]:.1f} m/s<br>axis %{customdata[2]:.1f}°" +
      "<br>depth %{y:.4f} m<br>along %{x:.4f} m<extra></extra>",
  };
}

/** Points of the path in the colour of the speed. */
function beadTrace({ path }, rows, range) {
  return {
    x: rows.map((row) => path.lateral[row]),
    y: rows.map((row) => path.depth[row]),
    mode: "markers",
    hoverinfo: "skip",
    showlegend: false,
    marker: {
      size: 6,
      color: rows.map((row) => path.speed[row]),
      cmin: range[0],
      cmax: range[1],
      colorscale: VIRIDIS,
      showscale: true,
      colorbar: {
        title: { text: "Speed [m/s]", side: "top" },
        orientation: "h",
        y: 1,
        yanchor: "bottom",
        thickness: 8,
        ypad: 2,
        outlinewidth: 0,
        nticks: 5,
      },
    },
  };
}

function layoutOf(traces, legend, wall, room, held) {
  const thickness = wall ?? FAR_M;
  const ends = (given, edge = 0) => {
    const values = given.filter((value) => value !== null); // between outlines
    return [
      Math.floor((values.reduce((a, b) => Math.min(a, b)) - edge) / GRID_M) * GRID_M,
      Math.ceil((values.reduce((a, b) => Math.max(a, b)) + edge) / GRID_M) * GRID_M,
    ];
  };
  const [left, right] = ends([...traces.flatMap(({ x }) => x), ...room.map((reach) => -reach)], EDGE_M);
  const [top, deepest] = ends([...traces.flatMap(({ y }) => y), ...room.map((reach) => -reach)]);
  const bottom = thickness < NEAR * deepest ? Math.max(deepest, thickness + GRID_M) : deepest;
  const across = { xref: "paper", x0: 0, x1: 1, y0: 0, layer: "below" };
  const face = { color: colour("edge"), width: 1.5 };
  return {
    xaxis: { title: { text: "Along the face [m]" }, range: held?.xaxis.range ?? [left, right], zeroline: false },
    yaxis: { title: { text: "Depth [m]" }, range: held?.yaxis.range ?? [Math.max(bottom, GRID_M), top], scaleanchor: "x", zeroline: false },
    shapes: [
      { ...across, type: "rect", y1: thickness, fillcolor: colour("concrete"), line: { width: 0 } },
      ...[0, thickness].map((y) => ({ ...across, type: "line", y0: y, y1: y, line: face })),
    ],
    annotations: faceNames(wall, top, Math.max(bottom, GRID_M)),
    showlegend: legend !== false,
    legend: { orientation: "h", y: legend || 0 },
    hovermode: "closest",
    dragmode: "pan",
  };
}

function tableOf(runs) {
  const column = (make) => runs.flatMap(({ run, name }) => run.history.time_s.map((_, row) => make(run, row, name)));
  return {
    run: column((_, __, name) => name),
    time_s: column(({ history }, row) => history.time_s[row]),
    nose_tip_lateral_m: column(({ path }, row) => path.lateral[row]),
    nose_tip_depth_m: column(({ path }, row) => path.depth[row]),
    axis_angle_deg: column(({ history }, row) => history.axis_angle_deg[row]),
    speed_m_s: column(({ path }, row) => path.speed[row]),
  };
}

function inWords({ run, name }) {
  const { outcome, final, maximum_depth_m: depth, target } = run;
  const isThrough = outcome === "perforated";
  const reach = isThrough ? `wall of ${digits(target.thickness_m * 1e3)} mm` : `${digits(depth * 1e3)} mm deep at most`;
  return `${name}: ${outcomeShown(outcome)} after ${digits(final.time_s * 1e3)} ms, ${reach}.`;
}
