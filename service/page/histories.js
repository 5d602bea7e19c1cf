// Time histories of runs, with a line at the instant that the side view shows.

import { aboutRuns } from "./exports.js";
import { axis, colour, csvOf, draw, heading, relayout } from "./plots.js";
import { unitOf } from "./units.js";

const NARROW = 640; // px
const [NOISE, DIGITS] = [1e-6, 9]; // histories with smaller values are drawn as zero [unit shown]; significant digits of values drawn
const DASHES = ["solid", "dash"];
/** Margins for labels of seven digits and a title [px]. They are fixed because Plotly draws all labels twice to fit its margins. */
const MARGIN = { l: 58, r: 8, t: 8, b: 42 };
const PANELS = [
  { title: "Depth", si: "mm", columns: { center_of_gravity_depth_m: "centre of gravity", nose_tip_depth_m: "tip" } },
  { title: "Axis angle", si: "°", columns: { axis_angle_deg: "axis" } },
  { title: "Velocity", si: "m/s", columns: { depth_velocity_m_s: "inward", lateral_velocity_m_s: "along face" } },
  { title: "Resistance", si: "kN", columns: { depth_force_n: "inward", lateral_force_n: "along face" } },
  { title: "Acceleration", si: "g₀", columns: { axial_acceleration_g: "along axis", transverse_acceleration_g: "across" } },
  { title: "Kinetic energy", si: "kJ", columns: { kinetic_energy_j: "energy" } },
  { title: "Largest bending stress", si: "MPa", columns: { stress_pa: "stress" }, of: ({ bending }) => bending?.history ?? { time_s: [], stress_pa: [] } },
];

/**
 * Draw the histories of one or more runs.
 *
 * @param {HTMLElement} root
 * @param {{run: object, name: string}[]} runs as `computeRun` returns them
 * @param {number} row index into the first run's history, where the line is
 */
export function drawHistories(root, runs, row) {
  const traces = runs.flatMap((each, index) => tracesOf(each, index, runs.length > 1));
  const [{ run }] = runs;
  const isNarrow = root.clientWidth < NARROW;
  root.classList.toggle("tall", isNarrow);
  root.classList.toggle("compared", runs.length > 1);
  const names = runs.length > 1 ? ` of ${runs.map(({ name }) => name).join(", ")}` : "";
  return draw(root, traces, layoutOf(run, row, isNarrow, runs.length > 1), {
    title: "Time histories",
    ...aboutRuns(runs),
    part: "histories",
    again: () => drawHistories(root, runs, row),
    csv: () => csvOf(runs.length > 1 ? runs.flatMap(rowsOf) : run.history),
    label: `Time histories${names}: ${PANELS.map(({ title }) => title.toLowerCase()).join(", ")}. The CSV below has the motion and the loads as numbers.`,
  });
}

/** Return the lines of a run: in two colours if it is the only run, else in one. */
function tracesOf({ run, name }, index, isCompared) {
  return PANELS.flatMap(({ columns, si, of = () => run.history }, panel) => {
    const history = of(run);
    return Object.entries(columns).map(([column, quantity], i) => ({
      x: history.time_s.map((seconds) => seconds * 1e3),
      y: withoutNoise(history[column].map((value) => value / unitOf(si).factor)),
      name: isCompared ? name : quantity,
      meta: index,
      mode: "lines",
      line: { color: colour(index ? `run-${index}` : ["accent", isCompared ? "accent" : "path"][i]), dash: DASHES[i], width: 1.8 },
      xaxis: axis("x", panel),
      yaxis: axis("y", panel),
      showlegend: isCompared && panel === 0 && i === 0,
      hovertemplate: isCompared ? `${name}: %{y:.4~g}<extra></extra>` : "%{y:.4~g}",
    }));
  });
}

/** Round values for drawing: otherwise rounding errors in a constant would stretch its axis over 1e-11°. */
function withoutNoise(values) {
  const isNothing = values.every((value) => Math.abs(value) < NOISE);
  return values.map((value) => (isNothing ? 0 : Number(value.toPrecision(DIGITS))));
}

function rowsOf({ run: { history }, name }) {
  const at = (row) => Object.fromEntries(Object.entries(history).map(([column, values]) => [column, values[row]]));
  return history.time_s.map((_, row) => ({ run: name, ...at(row) }));
}

/** Move the line to another row of the histories. */
export function moveInstant(root, run, row) {
  return relayout(root, { shapes: linesAt(run, row) });
}

function layoutOf(run, row, isNarrow, isCompared) {
  const columns = isNarrow ? 1 : 2;
  const rows = Math.ceil(PANELS.length / columns);
  const layout = { margin: MARGIN, shapes: linesAt(run, row), annotations: [], showlegend: isCompared, hovermode: "x", dragmode: false };
  if (isCompared) layout.legend = { orientation: "h", y: isNarrow ? -0.045 : -0.09, yanchor: "top" };
  PANELS.forEach(({ title, si, columns: lines }, panel) => {
    const [across, down] = [panel % columns, Math.floor(panel / columns)];
    const isAlone = panel === PANELS.length - 1 && !across; // in its row, whose whole width it takes
    const x = [across / columns + (across ? 0.05 : 0), isAlone ? 1 : (across + 1) / columns - (across + 1 < columns ? 0.03 : 0)];
    const y = [1 - (down + 1) / rows + 0.12 / rows, 1 - down / rows - 0.14 / rows];
    const isLast = down === rows - 1;
    layout[axis("xaxis", panel)] = { automargin: false, domain: x, anchor: axis("y", panel), title: { text: isLast ? "Time [ms]" : "", standoff: 4 } };
    layout[axis("yaxis", panel)] = { automargin: false, domain: y, anchor: axis("x", panel) };
    layout.annotations.push(heading(titleOf(`${title} [${unitOf(si).unit}]`, Object.values(lines)), x[0], y[1]));
  });
  return layout;
}

function titleOf(title, names) {
  const strokes = names.length > 1 ? ` ${names.map((name, i) => `${"── ╌╌".split(" ")[i]} ${name}`).join(", ")}` : "";
  return `<b>${title}</b>${strokes}`;
}

function linesAt({ history }, row) {
  const time = history.time_s[row] * 1e3;
  const stroke = { type: "line", x0: time, x1: time, y0: 0, y1: 1, line: { color: colour("quiet"), width: 1.2, dash: "dot" } };
  return PANELS.map((_, panel) => ({ ...stroke, xref: axis("x", panel), yref: `${axis("y", panel)} domain` }));
}
