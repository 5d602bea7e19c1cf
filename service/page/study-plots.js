// Results of a study: the probability with its band, the swing of each input, and a table of sensitivities.

import { element, table } from "./elements.js";
import { colour, csvOf, draw, drawingOf } from "./plots.js";
import { inputField } from "./scatter.js";
import { headline, probabilityAt } from "./study.js";
import { degreesShown, digits, grouped, withInterval } from "./words.js";

const MARGIN_DEG = 4; // shown on both sides of the range in which the probability changes
const ABOUT_MEAN = "Mean and median are those of the samples, whose distribution is skewed; the verdict has the angle with the inputs as given.";
const [ROW_PX, AXIS_PX] = [38, 70];

/** Draw the probability of ricochet over the oblique angle with its band. */
export function drawCurve(root, study, values) {
  const { oblique_angle_deg: x, ricochet_probability: y, lower, upper } = study.probability;
  const edge = { x, mode: "lines", line: { width: 0, simplify: false }, hoverinfo: "skip" };
  const traces = [
    { ...edge, y: lower, name: "lower" },
    { ...edge, y: upper, name: "upper", fill: "tonexty", fillcolor: colour("band") },
    {
      x,
      y,
      name: "probability",
      mode: "lines",
      line: { color: colour("accent"), width: 2, simplify: false },
      customdata: x.map((_, i) => withInterval(y[i], lower[i], upper[i], (share) => share.toFixed(3))),
      hovertemplate: "%{x:.1f}°: %{customdata}<extra></extra>",
    },
  ];
  const angle = headline(study);
  const mine = values.impact.oblique_angle_deg;
  const here = probabilityAt(study, mine);
  const words = `${mine}°: ${here.value.toFixed(3)}, sampling error ± ${here.error.toFixed(3)}`;
  traces.push({
    ...{ x: [mine], y: [here.value], name: "your angle", mode: "markers", hoverinfo: "skip", cliponaxis: false },
    marker: { size: 11, color: colour("path") },
  });
  // Above the axes, where no curve can run through it.
  const note = { text: `<b>${words}</b>`, font: { color: colour("path") }, x: 0.5, y: 1, xref: "paper", yref: "paper", yanchor: "bottom", showarrow: false };
  const layout = {
    showlegend: false,
    dragmode: false,
    shapes: [{ type: "line", x0: mine, x1: mine, yref: "paper", y0: 0, y1: 1, line: { color: colour("path"), width: 1.2, dash: "dot" } }],
    margin: { l: 8, r: 16, t: 52, b: 8 },
    title: { text: angle && `Critical angle ${angle}`, font: { size: 14 }, x: 0.5, y: 1, yanchor: "top", pad: { t: 8 } },
    annotations: [note],
    xaxis: { title: { text: "Oblique angle [°]" }, range: rangeOf(x, y, mine) },
    yaxis: { title: { text: "Probability of ricochet" }, range: [-0.02, 1.02] },
  };
  return draw(root, traces, layout, {
    title: `Probability of ricochet, critical angle ${angle || "none"}`,
    values,
    key: study.key,
    part: "probability",
    again: () => drawCurve(root, study, values),
    csv: () => csvOf(study.probability),
    label: `Probability of ricochet over the oblique angle with its sampling error. At ${words}. Critical angle ${angle || "none"}.`,
  });
}

/** Draw how far each input moves the critical angle, the largest swing on top. */
export function drawTornado(root, study, values) {
  const bars = swings(study).reverse(); // Plotly draws the first bar at the bottom
  drawingOf(root).style.height = `${bars.length * ROW_PX + AXIS_PX}px`;
  const trace = {
    type: "bar",
    orientation: "h",
    y: bars.map(({ label }) => label),
    base: bars.map(({ low }) => low.angle),
    x: bars.map(({ low, high }) => high.angle - low.angle),
    marker: { color: colour("accent") },
    customdata: bars.map(({ low, high }) => [low.shown, degreesShown(low.angle), high.shown, degreesShown(high.angle)]),
    hovertemplate: "%{customdata[0]}: %{customdata[1]}<br>%{customdata[2]}: %{customdata[3]}<extra></extra>",
  };
  const layout = {
    showlegend: false,
    dragmode: false,
    bargap: 0.35,
    xaxis: { title: { text: "Critical angle [°]" } },
    yaxis: { type: "category" },
  };
  return draw(root, [trace], layout, {
    title: "Swing of the critical angle by input",
    values,
    key: study.key,
    part: "swings",
    again: () => drawTornado(root, study, values),
    csv: () => csvOf(study.sensitivity.flatMap(({ field, swing }) => swing.map((each) => ({ field, ...each })))),
    label: `Swing of the critical angle by input: ${bars.map(({ label, span }) => `${label} ${degreesShown(span)}`).reverse().join(", ")}.`,
  });
}

/** Return a table of Sobol indices and swings, with a note that explains them. */
export function sensitivityTable(study) {
  const spans = new Map(swings(study).map(({ field, span }) => [field, span]));
  const rows = study.sensitivity.map(({ field, first_order: first, total }) => {
    const span = spans.get(field);
    const shown = ({ value, lower, upper }) => withInterval(value, lower, upper, (share) => share.toFixed(2)).replace(" to ", "\u00a0to\u00a0");
    const indices = [first, total].map((each) => (each ? shown(each) : "not known"));
    return [inputField(field).label, ...indices, span === undefined ? "no angle" : degreesShown(span)];
  });
  const heads = ["Input", "First order", "Total", "Swing"];
  const caption = "Sobol indices of the critical angle";
  const note =
    "First order: the share of the variance of the critical angle that an input explains alone; total: including its " +
    "interactions with other inputs. Their intervals are in brackets, unless they round to the value. Swing: the length of the bar.";
  const indices = table("table.indices", { heads, rows, caption, label: "Table of sensitivities", isNamed: true, isNumber: Boolean });
  return element("div", {}, indices, element("p.quiet", {}, note));
}

/** Return two paragraphs that summarize a study. */
export function describeStudy(study) {
  const { mean_deg: mean, standard_deviation_deg: deviation, share_without_angle: without } = study.critical_angle;
  const angle = headline(study);
  const parts = [
    mean ? `Mean ${degreesShown(mean.value)}, standard deviation ${degreesShown(deviation?.value ?? 0)}. ${ABOUT_MEAN}` : "",
    without.value > 0 ? `${digits(100 * without.value, 2)} % of the samples have no critical angle.` : "",
    `${grouped(study.samples)} samples: sampling error ± ${digits(study.convergence.half_width.at(-1), 2)}` +
      `${study.converged ? "" : ", more than requested"},`,
    `${study.method === "surrogate" ? "by polynomials fitted to them" : "counted directly"}.`,
    study.samples_failed ? `${grouped(study.samples_failed)} samples could not be computed.` : "",
    study.samples_outside ? `${grouped(study.samples_outside)} samples are outside the accepted range.` : "",
  ];
  return [
    angle
      ? element("p", {}, "Critical angle ", element("strong.range", {}, angle), ": median and 90 % range of the samples, rounded.")
      : element("p", {}, "No sample has a critical angle."),
    element("p", {}, parts.filter(Boolean).join(" ")),
  ];
}

function swings({ sensitivity }) {
  return sensitivity
    .map(({ field, swing }) => {
      const { label, unit, factor, choices } = inputField(field);
      const shown = (value) =>
        typeof value === "number" ? `${digits(value / factor, 4)}${unit ? ` ${unit}` : ""}` : choices[value];
      const ends = swing
        .filter((each) => each.critical_angle_deg !== undefined)
        .map(({ value, critical_angle_deg: angle }) => ({ shown: shown(value), angle }))
        .sort((a, b) => a.angle - b.angle);
      return { field, label, low: ends[0], high: ends.at(-1), span: ends.length ? ends.at(-1).angle - ends[0].angle : 0 };
    })
    .filter(({ low }) => low)
    .sort((a, b) => b.span - a.span);
}

function rangeOf(x, y, mine) {
  const changing = [...x.filter((_, i) => y[i] > 0.002 && y[i] < 0.998), mine];
  return [Math.max(Math.min(...changing) - MARGIN_DEG, x[0]), Math.min(Math.max(...changing) + MARGIN_DEG, x.at(-1))];
}
