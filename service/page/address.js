// Addresses that can be shared: `#/<view>?<query>`, where the query holds the differences from the paper's case.

import { valueAt, withValue } from "./case.js";
import { isVariant, nodeAt, paperCase, requiredOf, tagOf } from "./contract.js";
import { withSphere } from "./fields.js";
import { areUs } from "./units.js";

const PARTS = ["projectile", "target", "impact", "resistance", "numerics", "search", "strength_scatter"];
const LEAST_MS = 250;

let pending;
let replaced = -LEAST_MS;

/** Return the case that a query describes, ignoring parameters that cannot be read. */
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
  return withSphere(values, values);
}

/** Parse one parameter of a case; undefined if the case has no such field, or the text is not valid for it. */
export function readParameter(path, text, values) {
  const node = PARTS.includes(path.split(".")[0]) ? nodeAt(path, values) : undefined;
  return node && parse(text, node);
}

/** Return the query that describes a case by its differences from the paper's case. */
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

/** Return the address of a view, with the units shown if they are not SI. */
export function address(view, query) {
  const text = new URLSearchParams([...query].filter(([name]) => name !== "units").concat(areUs() ? [["units", "us"]] : [])).toString();
  return text ? `#/${view}?${text}` : `#/${view}`;
}

/**
 * Put the address of a view into the address bar without showing the view again.
 *
 * Quick changes are throttled, because browsers refuse more than about 200 changes in 30 s.
 */
export function replaceAddress(view, query) {
  clearTimeout(pending);
  const replace = () => {
    if (readAddress(location.hash).view !== view) return; // the user has left the view
    replaced = performance.now();
    history.replaceState(null, "", address(view, query));
  };
  const wait = replaced + LEAST_MS - performance.now();
  if (wait > 0) pending = setTimeout(replace, wait);
  else replace();
}

/** Return the parameters of a query that describe the case; links between views keep them. */
export const caseOf = (query) => new URLSearchParams([...query].filter(([path]) => PARTS.includes(path.split(".")[0])));

/** Split an address (`location.hash`) into its view and its query. */
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

const format = (value) => typeof value === "string" ? value : JSON.stringify(value);

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
