// A case is a plain object like a request; fields are named by dotted paths.

/** Return the value at a path; undefined if it is not there. */
export function valueAt(values, path) {
  return path.split(".").reduce((part, name) => part?.[name], values);
}

/** Return a copy with this value there; `undefined` takes it away, and what holds nothing else with it. */
export function withValue(values, path, value) {
  const [name, ...rest] = path.split(".");
  const inner = rest.length ? withValue(values?.[name] ?? {}, rest.join("."), value) : value;
  const copy = { ...values, [name]: inner };
  const isEmpty = rest.length && value === undefined && Object.keys(inner).length === 0;
  if (inner === undefined || isEmpty) delete copy[name];
  return copy;
}

/** Return the body of `/trajectory`, with a history at this interval if one is given. [s] */
export function trajectoryRequest(values, interval) {
  const { search, ...rest } = values;
  return interval ? { ...rest, output: { history: true, sample_interval_s: interval } } : rest;
}

/** Return the body of `/cra`, with another search if one is given. */
export function angleRequest(values, search) {
  const { oblique_angle_deg, ...impact } = values.impact;
  return { ...values, impact, search: search ?? values.search };
}
