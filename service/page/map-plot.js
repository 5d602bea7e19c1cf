// The picture of a map: colours for the quantity, contour lines over them, and marks where the colour does not show the ending.

import { labelWithUnit, withUnit } from "./fields.js";
import { unitOf } from "./units.js";
import { cellWords, ENDINGS, endingShown, PLAIN, QUANTITIES, rareWarnings } from "./map-cells.js";
import { drawCurve } from "./map-curve.js";
import { nice } from "./run.js";
import { warningShown } from "./words.js";

// Viridis without its darkest quarter, so that dark lines and labels can be read on every colour.
const COLOURS = ["#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];
const NO_ANGLE = "#a9a9a9";
const OUTCOMES = { embedded: "#5b7fb5", embedded_out: "#a58fc9", perforated: "#e08e5a", in_motion: "#b5b5b5", ricochet: "#fde725", failed: "#8c6d6d" };
const FRAMES = ["square-open", "hexagon-open", "star-square-open", "octagon-open"];
const INK = "#111111";
const BENDS = "#c2185b";
const PAPER = "#e8eaed"; // background of the legend in either theme

/**
 * Return the traces of a map for Plotly.
 *
 * @param {keyof QUANTITIES|"trajectory"} operation
 * @param {{label: string, unit: string, shown: number[]}[]} axes across and up, values as shown
 * @param {object[]} cells row by row; those without a result are missing
 * @param {object[]} rough the nearest cell of a coarse grid for each cell, whose colour is shown where there is no result yet
 * @param {number} room for the mark of a cell [px]
 * @param {number[]} here values of the case itself on both axes, as shown
 * @param {(index: number) => number} yieldOf returns the stress above which the surface of the projectile of a cell yields [Pa]
 * @param {object} [curve] the critical curve (map-curve.js)
 * @param {boolean} hasLines whether contours are drawn, which takes longer than all the rest
 */
export function mapTraces(operation, [x, y], cells, rough, room, here, yieldOf, curve, hasLines = true) {
  const grid = (value) => y.shown.map((up, row) => x.shown.map((across, column) => value(row * x.shown.length + column, across, up)));
  const rows = (value) => grid((index) => value(cells[index] ?? rough[index]));
  const finished = (value) => grid((index) => (hasLines ? value(cells[index]) : null)); // for contours
  const place = { x: x.shown, y: y.shown };
  const rare = rareWarnings(cells);
  const words = grid((index, across, up) => {
    const warnings = (cells[index]?.warnings ?? []).filter((code) => rare.has(code)).map((code) => `<br>${warningShown(code)}`);
    return `${valueShown(across, x)}, ${valueShown(up, y)}<br>${cellWords(cells[index])}${warnings.join("")}`;
  });
  const hover = { text: words, hovertemplate: "%{text}<extra></extra>", hoverongaps: true };
  const quantity = QUANTITIES[operation];
  const { endings = [], areas = [], lines = [] } = curve ? drawCurve(curve, [x, y], cells, { ink: INK, ricochet: OUTCOMES.ricochet }) : {};
  const ended = grid((index) => endings[index] ?? (cells[index] ?? rough[index])?.ending);
  const surface = quantity ? amounts(place, rows, finished, hover, quantity) : outcomes(place, ended, areas, finished, hover);
  if (!quantity && hasLines) surface.push(...bends(place, grid((index) => (cells[index]?.stress === undefined ? null : cells[index].stress / yieldOf(index)))));
  return [...surface, ...lines, ...marks(operation, [x, y], cells, room), ...warned([x, y], cells, room, rare), youAreHere(here)];
}

/** Return the layout of a map for Plotly. */
export function mapLayout([x, y]) {
  const axis = (side) => ({ title: { text: labelWithUnit(side) }, range: ends(side.shown), showgrid: false, zeroline: false });
  return {
    xaxis: axis(x),
    yaxis: axis(y),
    legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", itemsizing: "constant", bgcolor: PAPER, font: { color: INK } },
    hovermode: "closest",
  };
}

/** Return where the cells along an axis begin and end; undefined if there is only one. */
function ends(shown) {
  if (shown.length === 1) return undefined;
  const [low, high] = [Math.min(...shown), Math.max(...shown)];
  const half = (high - low) / (shown.length - 1) / 2;
  return [low - half, high + half];
}

function amounts(place, rows, finished, hover, { label, si, of, range: [zmin, zmax] = [] }) {
  const { unit, factor } = unitOf(si);
  const amountOf = (cell) => (cell && of(cell) !== undefined ? of(cell) / factor : null);
  const bar = { title: { text: labelWithUnit({ label, unit }), side: "right" }, thickness: 12 };
  return [
    { ...place, type: "heatmap", z: rows((cell) => (cell && amountOf(cell) === null ? 0 : null)), colorscale: scale([NO_ANGLE, NO_ANGLE]), showscale: false, hoverinfo: "skip" },
    { ...place, type: "heatmap", z: rows(amountOf), zmin, zmax, colorscale: scale(COLOURS), colorbar: bar, ...hover },
    contours(place, finished(amountOf)),
  ];
}

function outcomes(place, endings, areas, finished, hover) {
  const names = Object.keys(OUTCOMES);
  const z = endings.map((row) => row.map((ending) => (ending ? names.indexOf(ending) : null)));
  const steps = names.flatMap((name, i) => [i, i + 1].map((end) => [end / names.length, OUTCOMES[name]]));
  const isDeep = (cell) => cell?.depth !== undefined && cell.ending !== "perforated";
  const depth = finished((cell) => (isDeep(cell) ? cell.depth / unitOf("mm").factor : null));
  return [
    { ...place, type: "heatmap", z, zmin: -0.5, zmax: names.length - 0.5, colorscale: steps, showscale: false, ...hover },
    ...areas,
    contours(place, depth),
  ];
}

function contours(place, z) {
  return {
    ...place,
    type: "contour",
    z,
    contours: { coloring: "none", showlabels: true, labelfont: { size: 11, color: INK }, ...levels(z.flat().filter((value) => value !== null)) },
    line: { color: INK, width: 1 },
    showscale: false,
    showlegend: false,
    hoverinfo: "skip",
  };
}

/** Return round levels for contour lines through some values; Plotly itself would keep the levels of the map drawn before. */
function levels(values) {
  const [least, most] = [Math.min(...values), Math.max(...values)];
  const size = nice((most - least) / 6); // 0 or not a number if there is nothing to draw
  return size > 0 ? { start: Math.ceil(least / size) * size, end: most, size } : {};
}

/** Return the line beyond which the surface of the projectile yields in bending; none if all cells yield, or none does. */
function bends(place, shares) {
  const known = shares.flat().filter((share) => share !== null);
  if (!known.some((share) => share > 1) || !known.some((share) => share <= 1)) return [];
  return [
    {
      ...contours(place, shares),
      contours: { coloring: "none", start: 1, end: 1, size: 1 },
      line: { color: BENDS, width: 3, dash: "dash" },
      name: "its surface yields in bending from here on",
      showlegend: true,
    },
  ];
}

/** Return marks for the cells whose colour does not show their ending; the legend counts the cells of each ending. */
function marks(operation, axes, cells, room) {
  const size = Math.min(6, room / 2);
  return Object.entries(ENDINGS[operation]).flatMap(([ending, symbol]) => {
    const color = operation === "trajectory" ? OUTCOMES[ending] : NO_ANGLE;
    return markers(axes, cells, { label: endingShown(ending), symbol, size, color, isMarked: (cell) => cell.ending === ending });
  });
}

/** Return a mark at the case from which the map starts. */
function youAreHere([across, up]) {
  const marker = { symbol: "star", size: 15, color: "#ffffff", line: { width: 1.5, color: INK } };
  return { type: "scatter", mode: "markers", name: "you are here", x: [across], y: [up], marker, hoverinfo: "skip", showlegend: true };
}

/** Return frames around cells with a warning that few others have, with a shape for each warning. */
function warned(axes, cells, room, rare) {
  return [...rare].flatMap((code, i) => {
    const isMarked = ({ warnings }) => warnings.includes(code);
    return markers(axes, cells, { label: `warning: ${warningShown(code)}`, symbol: FRAMES[i % FRAMES.length], size: room, isMarked });
  });
}

function markers([x, y], cells, { label, symbol, size, color = INK, isMarked }) {
  const found = [...cells.keys()].filter((index) => cells[index] && isMarked(cells[index]));
  if (!found.length) return [];
  const at = (axis, place) => (symbol === PLAIN ? [null] : found.map((index) => axis.shown[place(index)])); // null shows it only in the legend
  const trace = {
    type: "scatter",
    mode: "markers",
    name: `${label} (${found.length})`.replace(/(?=.{41})(.{20,38}) /, "$1<br>"), // breaks names that are wider than a phone
    x: at(x, (index) => index % x.shown.length),
    y: at(y, (index) => Math.floor(index / x.shown.length)),
    marker: { symbol, size, color, line: { width: 1, color: INK } },
    hoverinfo: "skip",
    showlegend: true,
  };
  return [trace];
}

function scale(colours) {
  return colours.map((colour, i) => [i / (colours.length - 1), colour]);
}

/** Format a value of an axis with at most five digits and its unit. */
export function valueShown(value, { unit }) {
  return withUnit(Number(value.toPrecision(5)), unit);
}
