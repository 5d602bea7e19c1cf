// Names the parameters of an address that the page cannot read, so that nobody mistakes the case for another.

import { readCase, readParameter } from "./address.js";
import { MOST_PINS } from "./compare.js";
import { element } from "./elements.js";
import { readInputs } from "./scatter.js";
import { OPERATIONS, readAxis } from "./sweep.js";
import { SYSTEMS } from "./units.js";

const isNumber = (text) => text !== "" && Number.isFinite(Number(text));
/** Return whether a pinned strike, which is a query within the query, can be read and is within the limit. */
const isPin = (text, query) => {
  const pinned = [...new URLSearchParams(text)];
  const values = readCase(new URLSearchParams(text));
  const isTaken = query.getAll("pin").indexOf(text) < MOST_PINS;
  return isTaken && pinned.every(([name, given]) => readParameter(name, given, values) !== undefined);
};
const isAxis = (text) => readAxis(text) !== undefined;
/** Parameters of each view besides those of the case, with functions that return whether a text can be read. */
const OWN = {
  explore: { time_ms: isNumber, pin: isPin, enter: (text) => text === "shots" },
  "critical-angle": { offset_deg: isNumber },
  "how-sure": {
    scatter: (text) => readInputs(new URLSearchParams({ scatter: text })) !== undefined,
    "sampling.half_width": isNumber,
    "sampling.max_samples": isNumber,
    "sampling.seed": isNumber,
  },
  walls: {},
  map: { operation: (text) => text in OPERATIONS, x: isAxis, y: isAxis, job: (text) => /^[0-9a-f]+$/.test(text) },
  jobs: {},
};

/** Return a note that names the parameters of an address that cannot be read; undefined if there are none. */
export function unreadNote(view, query) {
  const values = readCase(query);
  const own = { ...OWN[view], units: (text) => SYSTEMS.includes(text) };
  const isRead = ([name, text]) => (name in own ? own[name](text, query) : readParameter(name, text, values) !== undefined);
  const unread = [...query].filter((each) => !isRead(each)).map(([name, text]) => `${name}=${text}`);
  if (!unread.length) return undefined;
  return element("p.warning.unread", { role: "alert" }, `Not understood in the address, and left out: ${unread.join(", ")}.`);
}
