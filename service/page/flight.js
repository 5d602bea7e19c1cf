// Where a body lands after a ricochet: side view and plan of its flight over level ground.

import { aboutRuns } from "./exports.js";
import { colour, csvOf, draw, heading } from "./plots.js";
import { requestEnd } from "./run.js";
import { unitOf } from "./units.js";
import { digits, quantityShown } from "./words.js";

const [GRAVITY, STEPS, HALVINGS] = [9.81, 400, 40]; // gravity [m/s²]; time steps of a flight, and bisections for its drag
const ARC_POINTS = 49;
const [HEIGHT_PX, PLAN_SHARE] = [480, 0.58]; // height of the picture, and the share of it that the plan takes

/** Compute the flight after a ricochet from a face level with the ground; undefined if the run is not a ricochet. */
export async function requestFlight(run, signal) {
  if (run.outcome !== "ricochet") return undefined;
  const { exit } = await requestEnd(run.values, signal, { flight: {} });
  return exit.flight && { ...exit.flight, ...pathTo(exit), elevation: exit.elevation_deg, speed: exit.speed_m_s };
}

/** Describe the flight; the verdict gives its distance. */
export function flightWords(flight) {
  return (
    `From a face level with the ground it rises ${quantityShown(flight.apex_m, "m", 2)} and lands after ${digits(flight.flight_time_s, 2)} s at ` +
    `${quantityShown(flight.impact_speed_m_s, "m/s")}, if it tumbles as computed. All distances, even that without drag, are for the exit as computed; the direction of a tumbling body is the least certain of all.`
  );
}

/** Draw the flight from the side and, from above, the distances that it may reach. */
export function drawFlight(root, run, flight) {
  const { unit, factor } = unitOf("m");
  const shown = (values) => values.map((value) => value / factor);
  const farthest = (1.05 * flight.range_without_drag_m) / factor;
  const beside = (farthest * PLAN_SHARE * HEIGHT_PX) / (root.clientWidth || HEIGHT_PX) / 2; // draws the plan to scale in the width available
  const reaches = [
    { name: "as computed", radius: flight.range_m, color: "accent" },
    { name: "any elevation", radius: flight.farthest_range_m, color: "path" },
    { name: "without drag", radius: flight.range_without_drag_m, color: "quiet" },
  ];
  const plan = { xaxis: "x2", yaxis: "y2", mode: "lines", hoverinfo: "skip", showlegend: false };
  const side = { mode: "lines", line: { color: colour("accent"), width: 2 }, hovertemplate: `%{x:.4~g} ${unit}, %{y:.4~g} ${unit} high<extra></extra>` };
  const angles = Array.from({ length: ARC_POINTS }, (_, i) => (i / (ARC_POINTS - 1) - 0.5) * Math.PI);
  const arcs = reaches.map(({ radius, color }) => ({
    ...plan,
    x: shown(angles.map((angle) => radius * Math.cos(angle))),
    y: shown(angles.map((angle) => radius * Math.sin(angle))),
    line: { color: colour(color), width: 2, dash: color === "accent" ? "solid" : "dash" },
  }));
  const landing = { ...plan, mode: "markers", x: [flight.range_m / factor], y: [0], marker: { size: 9, color: colour("accent") } };
  const words = reaches.map(({ name, radius, color }) => ({
    ...{ text: `${name} ${up(radius)}`, xref: "x2", yref: "y2", x: radius / factor, y: 0.5 * beside, xanchor: "left", yanchor: "middle" },
    ...{ textangle: -90, font: { color: colour(color), size: 11 }, showarrow: false },
  }));
  const layout = {
    ...{ showlegend: false, dragmode: false },
    xaxis: { domain: [0, 1], anchor: "y", matches: "x2" },
    yaxis: { domain: [0.74, 0.94], anchor: "x", rangemode: "tozero", nticks: 3 },
    xaxis2: { domain: [0, 1], anchor: "y2", title: { text: `Distance [${unit}]` }, range: [0, farthest] },
    yaxis2: { domain: [0, PLAN_SHARE], anchor: "x2", range: [-beside, beside], nticks: 5 },
    annotations: [
      heading(`<b>From the side: height [${unit}]</b>`, 0, 0.95),
      heading("<b>From above, struck from the left</b>", 0, 0.59),
      ...words,
    ],
  };
  return draw(root, [{ ...side, x: shown(flight.along), y: shown(flight.height) }, ...arcs, landing], layout, {
    title: "Flight after the ricochet",
    ...aboutRuns([{ run }]),
    part: "flight",
    again: () => drawFlight(root, run, flight),
    csv: () => csvOf({ distance_m: flight.along, height_m: flight.height }),
    label: `Flight after the ricochet, from the side and from above. ${flightWords(flight)}`,
  });
}

/** Reconstruct the flight path. The answer has only its end, so the drag is chosen to match the range. */
function pathTo({ speed_m_s: speed, elevation_deg: elevation, flight }) {
  let [least, most] = [0, 10 / flight.range_m];
  for (let i = 0; i < HALVINGS; i += 1) {
    const drag = (least + most) / 2;
    if (fly(speed, elevation, flight.flight_time_s, drag).along.at(-1) > flight.range_m) least = drag;
    else most = drag;
  }
  return fly(speed, elevation, flight.flight_time_s, least);
}

/** Integrate a flight by the midpoint rule; `drag` is the deceleration over the square of the speed [1/m]. */
function fly(speed, elevation, time, drag) {
  const step = time / STEPS;
  const angle = (elevation * Math.PI) / 180;
  let [x, y, u, v] = [0, 0, speed * Math.cos(angle), speed * Math.sin(angle)];
  const [along, height] = [[0], [0]];
  for (let i = 0; i < STEPS; i += 1) {
    const slow = drag * Math.hypot(u, v);
    const [um, vm] = [u - 0.5 * step * slow * u, v - 0.5 * step * (slow * v + GRAVITY)];
    const middle = drag * Math.hypot(um, vm);
    [x, y, u, v] = [x + step * um, y + step * vm, u - step * middle * um, v - step * (middle * vm + GRAVITY)];
    along.push(x);
    height.push(Math.max(y, 0));
  }
  return { along, height };
}

/** Format a distance as in the verdict: rounded up to whole metres, above 100 m to tens of metres. */
function up(distance) {
  const step = distance > 100 ? 10 : 1;
  return quantityShown(Math.ceil(distance / step - 1e-9) * step, "m", 4);
}
