// Addresses that can be shared: `#/<view>?<query>`, where the query holds what differs from the paper's case.

import { valueAt, withValue } from "./case.js";
import { isVariant, nodeAt, paperCase, requiredOf, tagOf } from "./contract.js";
import { areUs } from "./units.js";

const PARTS = ["projectile", "target", "impact", "resistance", "numerics", "search", "strength_scatter"];
const LEAST_MS = 250;

let pending;
let replaced = -LEAST_MS;

/** Return the case of a query; what cannot be read is left as in the paper's case. */
export function readCase(query) {
  let values = paperCase();
  const given = [...caseOf(query)];
  for (const [path, text] of given) {
    const [, holder, name] = path.match(/^(.+)\.(.+)$/) ?? [];
    const part = holder && valueAt(values, holder);
    if (part && name === tagOf(part) && part[name] !== text && isVariant(holder, text)) {
      values = withValue(values, holder, { ...requiredOf(holder, text), [name]: text });
    }
  }
  for (const [path, text] of given) {
    const value = readParameter(path, text, values);
    if (value !== undefined) values = withValue(values, path, value);
  }
  return values;
}

/** Return the value of a parameter of a case; undefined if the case has none such, or it cannot be read. */
export function readParameter(path, text, values) {
  const node = PARTS.includes(path.split(".")[0]) ? nodeAt(path, values) : undefined;
  return node && parse(text, node);
}

/** Return the query of a case. */
export function caseQuery(values) {
  const query = new URLSearchParams();
  const usual = paperCase();
  for (const [path, value] of leaves(values)) {
    const holder = path.slice(0, Math.max(path.lastIndexOf("."), 0));
    const [part, usualPart] = holder ? [valueAt(values, holder), valueAt(usual, holder)] : [values, usual];
    const tag = tagOf(part);
    const other = tag && usualPart?.[tag] !== part[tag];
    if (other || JSON.stringify(value) !== JSON.stringify(valueAt(usual, path))) query.set(path, format(value));
  }
  return query;
}

/** Return the address of a view, with the units shown unless they are SI. */
export function address(view, query) {
  const text = new URLSearchParams([...query].filter(([name]) => name !== "units").concat(areUs() ? [["units", "us"]] : [])).toString();
  return text ? `#/${view}?${text}` : `#/${view}`;
}

/**
 * Put the address of a view into the address bar; the view is not shown anew.
 *
 * At once, or while it changes quickly after a moment: browsers refuse more than some 200 changes in 30 s.
 */
export function replaceAddress(view, query) {
  clearTimeout(pending);
  const replace = () => {
    if (readAddress(location.hash).view !== view) return; // left meanwhile
    replaced = performance.now();
    history.replaceState(null, "", address(view, query));
  };
  const wait = replaced + LEAST_MS - performance.now();
  if (wait > 0) pending = setTimeout(replace, wait);
  else replace();
}

/** Return the part of a query with the case, which goes along from view to view. */
export function caseOf(query) {
  return new URLSearchParams([...query].filter(([path]) => PARTS.includes(path.split(".")[0])));
}

/** Return the view and the query that an address (`location.hash`) names. */
export function readAddress(hash) {
  const [path, query = ""] = hash.replace(/^#\/?/, "").split("?");
  return { view: path, query: new URLSearchParams(query) };
}

function* leaves(part, before = "") {
  for (const [name, value] of Object.entries(part)) {
    const isObject = typeof value === "object" && !Array.isArray(value);
    if (isObject) yield* leaves(value, `${before}${name}.`);
    else yield [before + name, value];
  }
}

function format(value) {
  return typeof value === "string" ? value : JSON.stringify(value);
}

function parse(text, { type, enum: names, const: only }) {
  if (type === "string") return (names ?? [only ?? text]).includes(text) ? text : undefined;
  try {
    const value = JSON.parse(text);
    const isRight = type === "array" ? Array.isArray(value) && !value.includes(null) : typeof value === (type === "integer" ? "number" : type);
    return isRight ? value : undefined;
  } catch {
    return undefined;
  }
}
