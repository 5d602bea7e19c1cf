// Outcomes, statuses and warnings in words.

import { element } from "./elements.js";

const ENDS = {
  ricochet: "The projectile is turned away.",
  embedded: "The projectile digs in and stays.",
  in_motion: "The projectile still moves when the run is given up.",
  perforated: "The projectile goes through: the wall is perforated.",
};
const SHORT = { ricochet: "turned away", embedded: "embedded", in_motion: "in motion", perforated: "perforated" };
const STATUSES = {
  no_ricochet: "Nothing in the range searched is turned away: there is no critical angle.",
  always_ricochet: "Everything in the range searched is turned away: the critical angle lies below.",
  not_converged: "The search did not converge.",
};

/** Codes of warnings of every case: the note in the footer. */
export const STANDING = new Set(["no_measured_angle"]);

/** Return a number as text with so many significant digits, without a trailing exponent where it can be. */
export function digits(value, count = 3) {
  if (value === 0) return "0";
  const size = Math.floor(Math.log10(Math.abs(value)));
  if (size < -4 || size > 6) return value.toExponential(count - 1);
  return value.toFixed(Math.max(0, Math.min(12, count - 1 - size)));
}

/** Return a critical angle as text, with two decimals. */
export function degreesShown(value) {
  return `${value.toFixed(2)}°`;
}

/** Return the outcome of a run in a word or two. */
export function outcomeShown(outcome) {
  return SHORT[outcome];
}

/** Return how a search without an angle ended in a word or two. */
export function statusShown(status) {
  return status.replace("_", " ");
}

/** Return paragraphs on how a run ended. */
export function describeRun(run) {
  const { final, target } = run;
  const speed = Math.hypot(final.depth_velocity_m_s, final.lateral_velocity_m_s);
  const rest = run.outcome === "embedded" ? "" : ` It goes on at ${digits(speed)} m/s.`;
  const isThrough = run.outcome === "perforated";
  const depth = isThrough ? "" : ` The nose tip went ${digits(run.maximum_depth_m * 1e3)} mm deep.`;
  return [
    element("p.outcome", { "data-outcome": run.outcome }, element("strong", {}, ENDS[run.outcome])),
    element(
      "p",
      {},
      `After ${digits(final.time_s * 1e3)} ms, with its nose tip ${place(final.nose_tip_depth_m, target.thickness_m)} and its axis at ` +
        `${digits(final.axis_angle_deg)}° from the normal.${rest}${depth} ` +
        `Strength factor ${digits(run.strength_factor)}.`,
    ),
  ];
}

/** Return a paragraph on what a search found. */
export function describeAngle(found) {
  const range = rangeShown(found);
  const outcomes = found.outcomes ? ` ${outcomesShown(found.outcomes)}` : "";
  if (found.critical_angle_deg === undefined) {
    return element("p", {}, STATUSES[found.status], range && ` Under other laws: ${range}.`, outcomes);
  }
  const error = found.critical_angle_standard_error_deg;
  const spread = error === undefined ? "" : ` ± ${degreesShown(error)} (standard error)`;
  const others = found.other_crossings_deg.map(degreesShown).join(", ");
  return element(
    "p",
    {},
    "Critical angle ",
    element("strong.angle", {}, degreesShown(found.critical_angle_deg)),
    `${spread}${range && ` (${range} under other laws)`} from the normal: the smallest that is turned away.`,
    ` Strength factor there ${digits(found.strength_factor)}.`,
    others && !outcomes ? ` The outcome changes again at ${others}.` : "",
    outcomes,
    found.status === "not_converged" ? ` ${STATUSES.not_converged}` : "",
  );
}

/** Return the outcomes of a wall by oblique angle, as in "Perforated 5.00° to 41.02°, turned away 41.02° to 85.00°." */
function outcomesShown(outcomes) {
  const intervals = outcomes.map(
    ({ outcome, lower_deg: lower, upper_deg: upper }) =>
      `${SHORT[outcome]} ${degreesShown(lower)} to ${degreesShown(upper)}`,
  );
  return sentence(intervals.join(", "));
}

/** Return the range of the critical angle under other laws, if that is known. */
function rangeShown({ alternatives = [] }) {
  const angles = alternatives.map((each) => each.critical_angle_deg).filter((angle) => angle !== undefined);
  if (!angles.length) return "";
  const none = alternatives.length - angles.length;
  const range = `${degreesShown(Math.min(...angles))} to ${degreesShown(Math.max(...angles))}`;
  return none ? `${range}, none in ${none} of ${alternatives.length}` : range;
}

/** Return warnings as a list, each once; nothing if there are none but those that hold for every case. */
export function warningList(...lists) {
  const own = lists.flat().filter(({ code }) => !STANDING.has(code));
  const details = new Map(own.map(({ code, detail }) => [`${code} ${detail}`, { code, detail }]));
  if (!details.size) return [];
  const items = [...details.values()].map(({ code, detail }) =>
    element("li.warning", { "data-code": code }, unbroken(sentence(detail))),
  );
  return [element("h2", {}, "Warnings"), element("ul.warnings", {}, ...items)];
}

/** Return text whose numbers keep to a line with their units. */
export function unbroken(text) {
  return text.replace(/(\d) (?=%|°|[kmM]?m\b|m\/s|kg|[MG]?Pa\b|k?N\b)/g, "$1\u00a0");
}

function sentence(text) {
  return text.charAt(0).toUpperCase() + text.slice(1) + (/[.!?]$/.test(text) ? "" : ".");
}

function place(depth, thickness = Infinity) {
  if (depth > thickness) return `${digits((depth - thickness) * 1e3)} mm beyond the rear face`;
  const distance = `${digits(Math.abs(depth) * 1e3)} mm`;
  return depth >= 0 ? `${distance} inside` : `${distance} outside`;
}
