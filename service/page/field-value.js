// Converts the text of a field to its value in SI.

import { boundsOf, withUnit } from "./fields.js";
import { readQuantity, unitOf } from "./units.js";

const WORDS = ["∞", "none", "auto"]; // shown in empty fields, and accepted as input

/**
 * Read the content of a field.
 *
 * @returns {{value?: any, wrong?: string, note?: string}} the value, undefined if the field is left empty, or a message on
 *   what is wrong; `note` says how an ambiguous text was understood
 */
export function readValue(field, given, values) {
  if (field.kind === "flag" || field.kind === "choice") return { value: given };
  const text = given.trim();
  if (field.optional && WORDS.includes(text.toLowerCase())) return { value: undefined };
  if (!text && field.kind !== "shots") return field.optional ? { value: undefined } : { wrong: `${field.label} must be a number.` };
  if (field.kind === "number") return readNumber(text, field, values);
  if (field.kind === "shots") return readShots(text, field);
  return field.pairs ? readPairs(text, field) : readList(text, field);
}

function readNumber(text, field, values) {
  const { value, wrong, note } = readQuantity(text, field.si);
  if (wrong) return { wrong: `${field.label}: ${wrong}.` };
  const broken = outside(value / field.factor, boundsOf(field, values));
  return broken ? { wrong: `${field.label} must be ${broken[0]} ${withUnit(broken[1], field.unit)}.` } : { value, note };
}

/** Return the bound (of `boundsOf`) that a value in the unit shown violates, as in ["at least", 5]; undefined if it violates none. */
export function outside(value, { least, most, above, below }) {
  const isBeyond = (bound) => Math.abs(value - bound) > 1e-9 * Math.abs(bound); // ignores rounding errors of unit conversions
  if (value < least && isBeyond(least)) return ["at least", least];
  if (value > most && isBeyond(most)) return ["at most", most];
  if (value <= above) return ["more than", above];
  return value >= below ? ["less than", below] : undefined;
}

/** Read lines of speed and depth, in the units shown or, below the CSV header `velocity_m_s,depth_m`, in SI. */
function readShots(text, { label }) {
  const lines = text.split("\n").filter((line) => line.trim() && !line.startsWith("#"));
  const hasHead = /^\s*"?[a-z]/i.test(lines[0]);
  const [speedUnit, depthUnit] = [/velocity_m_s/, /depth_m\b/].map((name, i) => (hasHead && name.test(lines[0]) ? ["m/s", "m"] : [unitOf("m/s").unit, unitOf("mm").unit])[i]);
  const read = (given = "", si, unit) => readQuantity(/[a-z]/i.test(given) ? given : `${given} ${unit}`, si).value;
  const shots = lines.slice(hasHead ? 1 : 0);
  const value = shots.map((line) => {
    const [speed, depth] = line.split(/[;\t]|,\s+|,(?=[^,]*$)/).map((each) => each.trim());
    return { velocity_m_s: read(speed, "m/s", speedUnit), depth_m: read(depth, "mm", depthUnit) };
  });
  const wrong = shots.find((_, i) => !(value[i].velocity_m_s > 0 && value[i].depth_m > 0));
  if (shots.length && wrong === undefined) return { value };
  const found = wrong === undefined ? "" : `"${wrong.trim()}" is not valid; `;
  return { wrong: `${label}: ${found}each line must be a speed [${unitOf("m/s").unit}] and a depth [${unitOf("mm").unit}], separated by a comma, as in 250, 310.` };
}

function readPairs(text, field) {
  const pairs = text.split("\n").map((line) => numbersOf(line, field));
  const isRight = pairs.every((pair) => pair.length === 2 && pair.every(Number.isFinite));
  return isRight ? { value: pairs } : { wrong: `${field.label}: each line must be a pair of numbers, as in 60, 30.` };
}

function readList(text, field) {
  const value = numbersOf(text, field);
  return value.every(Number.isFinite) ? { value } : { wrong: `${field.label} must be numbers separated by commas.` };
}

function numbersOf(line, { factor }) {
  return line.replaceAll("−", "-").split(/[\s,;]+/).filter(Boolean).map((text) => Number((Number(text) * factor).toPrecision(15)));
}
