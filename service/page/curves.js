// Small multiples of the critical angle over the speed and over the strength, each from a sweep around the case.

import { angleRequest, valueAt } from "./case.js";
import { boundsOf, fieldAt, labelWithUnit, shownNumber, withUnit } from "./fields.js";
import { axis, colour, csvOf, draw } from "./plots.js";
import { request } from "./service.js";

const FIELDS = ["impact.velocity_m_s", "target.compressive_strength_pa"];
const RATIOS = Array.from({ length: 13 }, (_, i) => 0.4 + 0.1 * i); // multiples of the value in the case
const NARROW = 640; // px

/**
 * Compute the curves of a case.
 *
 * @returns {Promise<{field: object, values: number[], angles: (number|null)[], status: string[]}[]>} `values` in SI, and
 *   `angles` in degrees, null where there is no critical angle
 */
export function requestCurves(values, signal) {
  return Promise.all(
    FIELDS.map(async (path) => {
      const field = fieldAt(path);
      const { least = 0, most = Infinity } = boundsOf({ path, factor: 1 }, values);
      const around = RATIOS.map((ratio) => Number((ratio * valueAt(values, path)).toPrecision(6)));
      const inside = around.filter((value) => value >= least && value <= most);
      const body = { base: angleRequest(values), axes: [{ field: path, values: inside }] };
      const { results } = (await request("cra/sweep", { body, signal })).data;
      const angles = results.map(({ result }) => result?.critical_angle_deg ?? null);
      return { field, values: inside, angles, status: results.map(({ result }) => result?.status ?? "failed") };
    }),
  );
}

/** Draw the curves of a case, each with a mark at the critical angle that `/cra` found for the case. */
export function drawCurves(root, curves, values, { critical_angle_deg: angle, key }) {
  const isNarrow = root.clientWidth < NARROW;
  root.classList.toggle("tall", isNarrow);
  const traces = curves.flatMap((curve, panel) => tracesOf(curve, values, angle, panel));
  return draw(root, traces, layoutOf(curves, isNarrow), {
    title: "Critical angle over speed and over strength",
    values,
    key,
    part: "curves",
    again: () => drawCurves(root, curves, values, { critical_angle_deg: angle, key }),
    csv: () => csvOf(curves.flatMap(rowsOf)),
    label: `Critical angle over speed and over strength. ${curves.map(inWords).join(" ")}`,
  });
}

function tracesOf({ field, values: along, angles }, values, angle, panel) {
  const axes = { xaxis: axis("x", panel), yaxis: axis("y", panel), showlegend: false };
  const shown = along.map((value) => shownNumber(field, value));
  const hovertemplate = `%{x} ${field.unit}: %{y:.2f}°<extra></extra>`;
  const line = { color: colour("accent"), width: 2 };
  const here = { symbol: "circle", size: 10, color: colour("path") };
  return [
    { ...axes, x: shown, y: angles, mode: "lines+markers", line, marker: { size: 4 }, hovertemplate },
    {
      ...axes,
      x: [shownNumber(field, valueAt(values, field.path))],
      y: [angle ?? null],
      mode: "markers",
      marker: here,
      hovertemplate: `this case: ${hovertemplate}`,
    },
  ];
}

function layoutOf(curves, isNarrow) {
  const layout = { dragmode: false };
  curves.forEach(({ field }, panel) => {
    const x = isNarrow ? [0, 1] : [panel * 0.54, panel * 0.54 + 0.46];
    const y = isNarrow ? [0.58 * (1 - panel), 0.58 * (1 - panel) + 0.42] : [0, 1];
    layout[axis("xaxis", panel)] = { domain: x, anchor: axis("y", panel), title: { text: labelWithUnit(field) } };
    layout[axis("yaxis", panel)] = {
      domain: y,
      anchor: axis("x", panel),
      title: { text: "Critical angle [°]" },
      ...(panel ? { matches: "y" } : {}),
    };
  });
  return layout;
}

function rowsOf({ field, values, status, angles }) {
  return values.map((value, i) => ({ field: field.path, value, status: status[i], critical_angle_deg: angles[i] }));
}

function inWords({ field, values, angles }) {
  const found = [...angles.keys()].filter((i) => angles[i] !== null);
  if (!found.length) return `No critical angle over ${field.label.toLowerCase()}.`;
  const at = (i) => `${angles[i].toFixed(2)}° at ${withUnit(shownNumber(field, values[i]), field.unit)}`;
  return `Over ${field.label.toLowerCase()} from ${at(found[0])} to ${at(found.at(-1))}.`;
}
