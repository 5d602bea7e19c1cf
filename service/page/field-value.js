// From what is typed into a field to its value in SI.

import { boundsOf } from "./fields.js";

/**
 * Read a field.
 *
 * @returns {{value?: any, wrong?: string}} the value, undefined if the field is left open, or what is wrong with it
 */
export function readValue(field, given, values) {
  if (field.kind === "flag" || field.kind === "choice") return { value: given };
  const text = given.trim().replaceAll("−", "-");
  if (!text) return field.optional ? { value: undefined } : { wrong: "A number is needed." };
  if (field.kind === "number") return readNumber(text, field, values);
  return field.pairs ? readPairs(text, field) : readList(text, field);
}

function readNumber(text, field, values) {
  const value = Number(text);
  if (!Number.isFinite(value)) return { wrong: `${JSON.stringify(text)} is no number.` };
  const wrong = outside(value, field, boundsOf(field, values));
  return wrong ? { wrong } : { value: toSi(value, field) };
}

function outside(value, { unit }, { least, most, above, below }) {
  const bound = (number) => `${number}${unit ? ` ${unit}` : ""}`;
  if (value < least) return `At least ${bound(least)}.`;
  if (value > most) return `At most ${bound(most)}.`;
  if (value <= above) return `More than ${bound(above)}.`;
  if (value >= below) return `Less than ${bound(below)}.`;
  return "";
}

function readPairs(text, field) {
  const pairs = text.split("\n").map(numbersOf);
  const isRight = pairs.every((pair) => pair.length === 2 && pair.every(Number.isFinite));
  if (!isRight) return { wrong: "Each line is a pair of numbers, as in 60, 30." };
  return { value: pairs.map((pair) => pair.map((number) => toSi(number, field))) };
}

function readList(text, field) {
  const numbers = numbersOf(text);
  if (!numbers.every(Number.isFinite)) return { wrong: "Numbers are needed, with commas between." };
  return { value: numbers.map((number) => toSi(number, field)) };
}

function numbersOf(line) {
  return line.split(/[\s,;]+/).filter(Boolean).map(Number);
}

/** In SI, without what floating point adds: 39 MPa is 39000000 Pa, 530 mm is 0.53 m. */
function toSi(number, { factor }) {
  return Number((number * factor).toPrecision(15));
}
