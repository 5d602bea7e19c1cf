// The critical curve of a phase diagram: the critical angle at each value of the other axis, with its 90 % range.

import { angleRequest } from "./case.js";
import { untilAnswered } from "./lost.js";
import { QUICK, usualAround } from "./scatter.js";
import { request } from "./service.js";
import { between, quantileOf } from "./study.js";
import { AT_ONCE, evenly, isOfAngle, numbers } from "./sweep.js";

const STUDIES = 9; // largest number of studies for a band; few are enough, because it changes slowly along the curve
const RICOCHET = "ricochet";
const CLICK_MS = 500; // time in which a click that was meant for the greyed entry of the legend may still come
const BAND = "#ffffff66"; // translucent, so that the colours of the outcomes remain visible

/**
 * Compute the critical curve of a map: `angles` at the values of the axis `side`, undefined where there is not exactly one critical angle.
 *
 * @returns {Promise<{side: "x"|"y", angles: (number|undefined)[]}|undefined>} undefined if the map has none
 */
export async function computeCurve(map, signal) {
  const side = isOfAngle(map.x) ? "y" : "x";
  const hasAngle = map.operation === "trajectory" && [map.x, map.y].some(isOfAngle);
  if (!hasAngle || Math.min(map.x.count, map.y.count) < 2 || map[side].count > AT_ONCE) return undefined;
  const results = await sweep("cra/sweep", map, side, numbers(map[side]), {}, signal);
  const angles = results.map(({ result }) => (result?.other_crossings_deg.length ? undefined : result?.critical_angle_deg));
  return angles.some(Boolean) ? { side, angles } : undefined;
}

/** Return a curve with its `band`: the 90 % range from the usual scatter of the case of its map. */
export async function withBand(map, { side, angles }, signal) {
  // The service accepts so few samples only without sensitivities, which are not shown.
  const study = { uncertain: await usualAround(map.values, signal), sensitivity: false, sampling: { ...QUICK, half_width: 0.05 } };
  const known = [...angles.keys()].filter((place) => angles[place] !== undefined);
  const places = evenly(known.length, STUDIES).map((i) => known[i]);
  const results = []; // one study at a time, so that a worker is free for a case that is dragged meanwhile
  for (const place of places) results.push(...(await sweep("cra/uncertainty/sweep", map, side, [numbers(map[side])[place]], study, signal)));
  const [lower, upper] = [0.05, 0.95].map((level) => {
    const ends = results.map(({ result }) => result && quantileOf(result, level));
    return angles.map((angle, place) => (angle === undefined ? undefined : between(places, ends, place)));
  });
  return { side, angles, band: { lower, upper, arrival: performance.now() } };
}

async function sweep(path, map, side, values, study, signal) {
  const body = { base: { ...angleRequest(map.values), ...study }, axes: [{ field: map[side].field, values }] };
  return (await untilAnswered(() => request(path, { body, signal }), signal)).data.results;
}

/** Return whether a trace is a band that has not arrived, or so late that a click on its entry in the legend may have been meant for the greyed entry. */
export const isInert = ({ meta }) => performance.now() < meta + CLICK_MS;

/**
 * Return the traces of a critical curve: its line, and areas that are drawn below other lines.
 *
 * A cell has one colour, but the colours should meet at the curve. Where a column of cells changes to ricochet once, and next to the curve,
 * its cells from there on are coloured like the cell before (`endings`), and an area in the colour of ricochet covers them above the curve.
 */
export function drawCurve({ side, angles, band }, [x, y], cells, { ink, ricochet }) {
  const isUp = side === "x"; // whether the angle is on the vertical axis
  const [along, up] = (isUp ? [x, y] : [y, x]).map(({ shown }) => shown);
  const [places, heights] = [along, up].map(withEdges);
  const ends = [heights[0], heights.at(-1)];
  const endings = [];
  const refined = angles.map((angle, place) => {
    const column = up.map((_, row) => (isUp ? row * along.length + place : place * up.length + row));
    const own = column.map((index) => cells[index]?.ending);
    const first = [...own, RICOCHET].indexOf(RICOCHET);
    const turnsOnce = first > 0 && own.every((ending, row) => ending && (row < first || ending === RICOCHET));
    if (!turnsOnce || !(angle >= heights[2 * first - 2]) || angle > heights[2 * first + 2]) return undefined;
    for (const index of column.slice(first)) endings[index] = own[first - 1];
    return angle;
  });
  const placed = (across, height) => (isUp ? { x: across, y: height } : { x: height, y: across });
  const area = (lower, upper, more) => {
    const [low, high] = [lower, upper].map(withEdges);
    const z = ends.map((end) => low.map((each, i) => (each === null ? null : (end - each) / (high[i] - each))));
    const contours = { type: "constraint", operation: "][", value: [0, 1] }; // the area that satisfies the constraint is left empty
    return { ...placed(places, ends), type: "contour", z, transpose: !isUp, contours, hoverinfo: "skip", ...more };
  };
  const top = angles.map(() => 180); // beyond the picture
  // The band is in the legend from the beginning, so that the picture keeps its size when the band arrives.
  const line = { color: ink, width: 1, dash: "dot", smoothing: 0 };
  const ofBand = { name: "90 % range of the usual scatter", fillcolor: BAND, line, showlegend: true, visible: band ? true : "legendonly", meta: band?.arrival ?? Infinity };
  const areas = [
    area(refined, top, { fillcolor: ricochet, line: { width: 0 }, showlegend: false }),
    area(band?.lower ?? angles, band?.upper ?? top, ofBand),
  ];
  const curve = { type: "scatter", mode: "lines", name: "critical angle", line: { color: ink, width: 3 }, hoverinfo: "skip", showlegend: true };
  return { endings, areas, lines: [{ ...placed(places, withEdges(angles)), ...curve }] };
}

/** Return values at the edges and the middles of cells, alternately; null where neither of the adjacent cells has a value. */
function withEdges(middles) {
  const beyond = (near, far = near) => (near === undefined ? null : near + (near - far) / 2);
  const edge = (i) => {
    if (middles[i - 1] === undefined) return beyond(middles[i], middles[i + 1]);
    return middles[i] === undefined ? beyond(middles[i - 1], middles[i - 2]) : (middles[i - 1] + middles[i]) / 2;
  };
  return [...middles.flatMap((middle, i) => [edge(i), middle ?? null]), edge(middles.length)];
}
