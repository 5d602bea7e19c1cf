// How searches converge: the angles tried and the final positions, as in the paper's Figures 13 and 14.

import { table } from "./elements.js";
import { fieldAt } from "./fields.js";
import { axis, colour, csvOf, draw, heading } from "./plots.js";
import { unitOf } from "./units.js";
import { degreesShown, numberShown, outcomeShown, statusShown } from "./words.js";

/** Return the display names of the searches by method, in the order in which they are shown. */
export const searches = () => fieldAt("search.method").choices;

const NARROW = 640; // px
/** Quantities plotted by trial, with a `short` title for narrow plots. Depth increases downwards: outside the face is above. */
export const POSITIONS = { column: "final_position_m", si: "mm", title: "Final depth of the nose tip", short: "Tip depth", part: "final-positions" };
export const ANGLES = { column: "oblique_angle_deg", si: "°", title: "Oblique angle", short: "Angle", part: "trial-angles" };

/** Return a table of the results of the searches. */
export function summary(answers) {
  const rows = Object.entries(answers).map(([method, found]) => [
    searches()[method],
    found.critical_angle_deg === undefined ? statusShown(found.status) : degreesShown(found.critical_angle_deg),
    (found.bracket_deg ?? []).map((angle) => degreesShown(angle)).join(" to "),
    String(found.iterations.length),
  ]);
  return table("table", { caption: "Results", heads: ["Search", "Critical angle", "Final bracket", "Trials"], rows });
}

/** Return a table of the trials of a search. */
export function trialTable(method, { iterations }) {
  const rows = iterations.map((trial, i) => [
    String(i + 1),
    trial.oblique_angle_deg.toFixed(3),
    numberShown(trial.final_position_m, "mm"),
    outcomeShown(trial.outcome) + (trial.fine ? "" : ", roughly"),
  ]);
  return table("table", { caption: searches()[method], heads: ["Trial", "Angle [°]", `Final depth [${unitOf("mm").unit}]`, "Outcome"], rows });
}

/** Draw the trials, with a panel for each search in `answers`. */
export function drawTrials(root, answers, values, what) {
  const methods = Object.keys(searches()).filter((method) => method in answers);
  const isNarrow = root.clientWidth < NARROW;
  root.classList.toggle("tall", isNarrow);
  const traces = methods.map((method, panel) => trace(method, answers[method], what, panel));
  return draw(root, traces, layoutOf(answers, methods, what, isNarrow), {
    title: `${what.title}, trial by trial`,
    values,
    key: methods.map((method) => answers[method].key).join(", "),
    part: what.part,
    again: () => drawTrials(root, answers, values, what),
    csv: () => csvOf(methods.flatMap((method) => trialsOf(answers[method], method))),
    label: `${what.title} by trial: ${methods.map((each) => searches()[each]).join(", ")}; the tables have the numbers.`,
  });
}

function trace(method, { iterations }, { column, si }, panel) {
  const isAway = ({ outcome, final_position_m: depth }) => (method === "outcome" ? outcome === "ricochet" : depth < 0);
  return {
    x: iterations.map((_, i) => i + 1),
    y: iterations.map((trial) => trial[column] / unitOf(si).factor),
    text: iterations.map(({ outcome, fine }) => outcomeShown(outcome) + (fine ? "" : ", computed roughly")),
    mode: "lines+markers",
    line: { color: colour("edge"), width: 1 },
    marker: {
      size: 9,
      color: iterations.map((trial) => colour(isAway(trial) ? "accent" : "panel")),
      line: { color: colour("accent"), width: 2 },
    },
    xaxis: axis("x", panel),
    yaxis: axis("y", panel),
    hovertemplate: "trial %{x}: %{y:.4~g}, %{text}<extra></extra>",
  };
}

function layoutOf(answers, methods, { title, short, si, column }, isNarrow) {
  const layout = { showlegend: false, annotations: [], shapes: [], dragmode: false };
  methods.forEach((method, panel) => {
    const [across, down] = isNarrow ? [0, panel] : [panel, 0];
    const [columns, rows] = isNarrow ? [1, methods.length] : [methods.length, 1];
    const x = [across / columns + (across ? 0.05 : 0), (across + 1) / columns];
    const y = [1 - (down + 1) / rows + 0.15 / rows, 1 - down / rows - 0.1 / rows];
    layout[axis("xaxis", panel)] = {
      domain: x,
      anchor: axis("y", panel),
      title: { text: down === rows - 1 ? "Trial" : "" },
      zeroline: false,
      tickformat: "d",
    };
    layout[axis("yaxis", panel)] = {
      domain: y,
      anchor: axis("x", panel),
      title: { text: isNarrow || panel === 0 ? `${isNarrow ? short : title} [${unitOf(si).unit}]` : "" },
      ...(column === POSITIONS.column ? { autorange: "reversed" } : { zeroline: false }),
    };
    layout.annotations.push(heading(`<b>${searches()[method]}</b>`, x[0], y[1]));
    layout.shapes.push(levelLine(answers[method], column, panel));
  });
  return layout;
}

/** Return a line at the critical angle or, among positions, at the face. */
function levelLine({ critical_angle_deg: angle }, column, panel) {
  const level = column === POSITIONS.column ? 0 : angle;
  const line = { color: colour("path"), width: 1.5, dash: "dash" };
  const place = { xref: `${axis("x", panel)} domain`, yref: axis("y", panel), x0: 0, x1: 1, y0: level, y1: level };
  return { type: "line", ...place, line, visible: level !== undefined };
}

const trialsOf = ({ iterations }, search) => iterations.map(({ exit, ...trial }, i) => ({ search, trial: i + 1, ...trial }));
