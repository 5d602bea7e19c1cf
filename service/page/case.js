// A case is a plain object with the structure of a request; its fields are named by dotted paths.

/** Return the value at a path; undefined if there is none. */
export function valueAt(values, path) {
  return path.split(".").reduce((part, name) => part?.[name], values);
}

/** Return a copy with the value at a path replaced; `undefined` removes it, and the objects that this leaves empty. */
export function withValue(values, path, value) {
  const [name, ...rest] = path.split(".");
  const inner = rest.length ? withValue(values?.[name] ?? {}, rest.join("."), value) : value;
  const copy = { ...values, [name]: inner };
  const isEmpty = rest.length && value === undefined && Object.keys(inner).length === 0;
  if (inner === undefined || isEmpty) delete copy[name];
  return copy;
}

/** Return the body for `/trajectory`; with `interval` [s] it requests a history sampled at this interval. */
export function trajectoryRequest(values, interval) {
  const { search, ...rest } = values;
  return interval ? { ...rest, output: { history: true, sample_interval_s: interval } } : rest;
}

/** Return the body for `/cra`; `search` replaces the search of the case. */
export function angleRequest(values, search) {
  const { oblique_angle_deg, ...impact } = values.impact;
  return { ...values, impact, search: search ?? values.search };
}
