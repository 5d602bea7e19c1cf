// The base case of a sweep job: the fields that its cases share, and the ranges of those that vary.

import { valueAt } from "./case.js";
import { element } from "./elements.js";
import { GROUPS, fieldAt, fieldShown, shownNumber, withUnit } from "./fields.js";
import { request } from "./service.js";
import { grouped } from "./words.js";

/**
 * Return a collapsed list of the base case of a sweep, which is fetched when the list is opened.
 *
 * @param {object} job
 * @param {(error: Error) => void} onError
 */
export function baseCase(job, onError) {
  const list = element("dl", {}, element("dd", {}, "Loading ..."));
  const ontoggle = async () => {
    if (!root.open) return;
    try {
      const { data } = await request(`jobs/${job.id}`);
      list.replaceChildren(...[...data.request.axes.map(axisWords), ...caseWords(data.request)].flatMap(line));
    } catch (error) {
      root.open = false;
      onError(error);
    }
  };
  const root = element("details", { ontoggle }, element("summary", {}, "Base case"), list);
  return root;
}

function axisWords({ field, start, stop, count, values = [start, stop] }) {
  const known = fieldAt(field) ?? { label: field, factor: 1, unit: "" };
  const [least, most] = [values[0], values.at(-1)].map((value) => grouped(shownNumber(known, value)));
  return [known.label, `${least} to ${most} ${known.unit}, ${grouped(count ?? values.length)} values`];
}

function caseWords({ base, axes }) {
  const varied = new Set(axes.map(({ field }) => field));
  const fields = GROUPS.flatMap((group) => group.fields).filter(({ path }) => !varied.has(path));
  return fields.filter(({ path }) => valueAt(base, path) !== undefined).map((field) => [field.label, withUnit(fieldShown(field, base), field.unit)]);
}

const line = ([name, text]) => [element("dt", {}, name), element("dd", {}, text.trim())];
