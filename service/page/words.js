// Texts for quantities, outcomes, statuses and warnings.

import { names } from "./contract.js";
import { element } from "./elements.js";
import { areUs, unitOf } from "./units.js";

const STATUSES = {
  no_ricochet: "Nothing in the range searched is turned away: there is no critical angle.",
  always_ricochet: "Everything in the range searched is turned away: the critical angle lies below.",
  not_converged: "The search did not converge.",
};

/** Largest number of significant digits of a result in US units, as in the texts of the service. */
const CONVERTED_DIGITS = 4;

/** Smaller values are numerical noise and shown as 0: a tenth of the unit shown in SI. */
const NOISE = { mm: 1e-4, "m/s": 0.1, "°": 0.1, MPa: 1e5 };

const THOUSANDS = new Intl.NumberFormat("en", { useGrouping: "min2" });

/** Format a number with commas between thousands if it has five digits or more before the point, as the service does. */
export function grouped(number) {
  const [whole, ...decimals] = `${number}`.split(".");
  return [THOUSANDS.format(Number(whole)), ...decimals].join(".");
}

/** Format a number with `count` significant digits, without an exponent if possible. */
export function digits(value, count = 3) {
  if (value === 0) return "0";
  const size = Math.floor(Math.log10(Math.abs(value)));
  if (size < -4 || size > 6) return value.toExponential(count - 1);
  return grouped(value.toFixed(Math.max(0, Math.min(12, count - 1 - size))));
}

/** Format a quantity given in SI, such as `238 m/s`; `si` is its unit when SI is shown. With a `count` above 3, trailing zeros are dropped. */
export function quantityShown(value, si, count = 3) {
  const { unit } = unitOf(si);
  return `${numberShown(value, si, count)}${unit === "°" ? "" : " "}${unit}`;
}

/** Return whether a quantity given in SI is shown as 0; `si` is its unit when SI is shown. */
export const isNoise = (value, si) => Math.abs(value) < NOISE[si];

/** Format the number of a quantity given in SI, in the unit shown but without it, for a column whose head names the unit. */
export function numberShown(value, si, count = 3) {
  if (isNoise(value, si)) return "0";
  const shown = value / unitOf(si).factor;
  return count > 3 ? grouped(Number(shown.toPrecision(count))) : digits(areUs() ? Number(shown.toPrecision(CONVERTED_DIGITS)) : shown, count);
}

/** Format a length given in SI, in millimetres or inches. */
export const lengthShown = (value, count = 3) => quantityShown(value, "mm", count);

/** Describe in a few words how a run ended, including how far the body protrudes from the rear face of a wall. */
export function endingShown({ outcome, protrusion }) {
  const out = outcome === "embedded" && protrusion?.final_m;
  return out ? `${outcomeShown(outcome)}, its nose ${lengthShown(out)} out of the rear face` : outcomeShown(outcome);
}

/** Format a value with its interval, as in "0.76 (0.7 to 0.8)"; without it if both ends look like the value. */
export function withInterval(value, lower, upper, shown) {
  const [middle, ...ends] = [value, lower, upper].map((each) => shown(each));
  return ends.every((end) => end === middle) ? middle : `${middle} (${ends.join(" to ")})`;
}

/** Format an angle given in degrees. */
export const degreesShown = (value, decimals = 2) => `${value.toFixed(decimals)}°`;

/** Return the display name of an outcome. */
export const outcomeShown = (outcome) => names.outcomes[outcome];

/** Return the display name of the status of a search. */
export const statusShown = (status) => names.statuses[status];

/** Return the short name of a warning. */
export const warningShown = (code) => names.warnings[code] ?? code.replaceAll("_", " ");

/** Describe in a few sentences how a run ended; its depth and its speed are in the verdict. */
export function describeRun(run) {
  const { final, target } = run;
  return (
    `At the end, after ${digits(final.time_s * 1e3)} ms, its nose tip is ${place(final.nose_tip_depth_m, target.thickness_m)} and its axis at ` +
    `${(Math.round(10 * final.axis_angle_deg) / 10 || 0).toFixed(1)}° from the normal.${wallOf(run)} The strength factor S at this oblique angle is ${digits(run.strength_factor)}.`
  );
}

/** Say what the outcome of a run means for a wall, and where the page judges the wall. */
function wallOf({ outcome, protrusion, target: { thickness_m: thickness } }) {
  if (outcome === "in_motion") return "";
  if (thickness === undefined) return outcome === "embedded" ? " This concrete has no rear face: Walls says how thick a wall must be." : "";
  const word = outcome === "perforated" ? "perforated" : "not perforated";
  const out = protrusion ? ` though the body comes ${lengthShown(protrusion.greatest_m)} out of the rear face,` : "";
  return ` The wall of ${lengthShown(thickness, 6)} is ${word} by this model,${out} which is unconservative: the verdict says whether it is enough.`;
}

/** Describe the results of a search besides its angle or, if there is no angle, how the search ended. */
export function describeAngle(found, decimals) {
  const outcomes = found.outcomes ? outcomesShown(found.outcomes, decimals) : "";
  if (found.critical_angle_deg === undefined) return [STATUSES[found.status], outcomes].filter(Boolean).join(" ");
  const error = found.critical_angle_standard_error_deg;
  const others = found.other_crossings_deg.map((angle) => degreesShown(angle, decimals)).join(", ");
  return [
    `The strength factor S at the critical angle is ${digits(found.strength_factor)}.`,
    error === undefined ? "" : `The standard error of the angle is ${degreesShown(error)}.`,
    others && !outcomes ? `The outcome changes again at ${others}.` : "",
    outcomes,
    found.status === "not_converged" ? STATUSES.not_converged : "",
  ].filter(Boolean).join(" ");
}

/** Describe the outcomes for a wall by oblique angle, as in "Perforated from 5.0° to 41.0°, ricochet from 41.0° to 85.0°." */
function outcomesShown(outcomes, decimals) {
  const shown = (angle) => degreesShown(angle, decimals);
  const intervals = outcomes.map(({ outcome, lower_deg: lower, upper_deg: upper }, i) => {
    const from = i ? shown(lower) : `${shown(lower)} (where the search begins)`;
    const to = i < outcomes.length - 1 ? shown(upper) : `${shown(upper)} (where it ends)`;
    return `${outcomeShown(outcome)} from ${from} to ${to}`;
  });
  return sentence(intervals.join(", "));
}

/** Codes of warnings, the worst first; all others follow, `strength_fit_extrapolated` last. */
const WORST = ["implausible", "base_strikes_first", "velocity_beyond_rigid", "bends", "undecided", "tumbling", "range_clipped", "rear_face_unconservative", "retention_decides", "shallow_penetration"];

/**
 * Return two collapsed lists: the warnings, summarized by their number and the worst one, and the standing notes. A warning whose text
 * begins another, longer one is left out; the last of identical warnings counts.
 */
export function warningList(...lists) {
  const all = [...new Map(lists.flat().map((each) => [each.detail, each])).values()];
  const found = all.filter((each) => !all.some((other) => other !== each && other.detail.startsWith(each.detail)));
  const rank = ({ code }) => (WORST.includes(code) ? WORST.indexOf(code) : WORST.length + (code === "strength_fit_extrapolated"));
  const special = found.filter(({ standing }) => !standing).sort((one, other) => rank(one) - rank(other));
  const standing = found.filter((each) => each.standing);
  const words = ({ detail }) => sentence(detail);
  const folded = (name, kind, some, ...summary) => {
    const items = some.map((each) => element(`li.${kind}`, { "data-code": each.code }, words(each)));
    return some.length ? [element(`details.${name}`, {}, element("summary", {}, ...summary), element("ul", {}, ...items))] : [];
  };
  const count = element("strong", {}, special.length === 1 ? "1 warning" : `${special.length} warnings`);
  const worst = element("span.worst", {}, ` ${special.slice(0, 1).map(words).join("")}`);
  const briefly = [...new Set(standing.map(({ code }) => warningShown(code)))].join(", ");
  return [...folded("warnings", "warning", special, count, worst), ...folded("standing.quiet", "note", standing, `Standing notes: ${briefly}`)];
}

/** Return text with a capital first letter. */
export const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

const sentence = (text) => capital(text) + (/[.!?]$/.test(text) ? "" : ".");

function place(depth, thickness = Infinity) {
  if (depth > thickness) return `${lengthShown(depth - thickness)} beyond the rear face`;
  const distance = lengthShown(Math.abs(depth));
  return depth >= 0 ? `${distance} inside` : `${distance} outside`;
}
