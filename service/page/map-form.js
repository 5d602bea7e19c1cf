// The form of a map: the quantity to show, and the two fields it varies.

import { element } from "./elements.js";
import { outside } from "./field-value.js";
import { boundsOf, fieldAt, labelWithUnit, numericFields, shownNumber, withUnit } from "./fields.js";
import { around, isOn, isVariable, OPERATIONS, usualAxes } from "./sweep.js";

const SIDES = { x: "Horizontal axis", y: "Vertical axis" };

/**
 * Build the form of a map.
 *
 * @param {HTMLElement} root
 * @param {object} map as `readMap` returns it
 * @param {(map: object|undefined) => void} onChange called with the map, or with undefined while a field is out of bounds
 * @returns {{setCase: (values: object) => void, showProblem: (problem: Problem) => void}}
 */
export function buildMapForm(root, map, onChange) {
  let current = map;
  const change = (part) => {
    current = { ...current, ...part };
    const isRight = [sides.x, sides.y].map((side) => side.check(current)).every(Boolean);
    onChange(isRight ? current : undefined);
  };
  const operation = operationField(map.operation, (name) => {
    const isOther = name === "trajectory" || current.operation === "trajectory"; // which has other usual axes
    if (isOther) [sides.x, sides.y].forEach((side, i) => side.lay(usualAxes(name, current.values)[i]));
    current = { ...current, operation: name };
    change({ x: sides.x.offer(current), y: sides.y.offer(current) });
  });
  const sides = {
    x: axisFields("x", map, (x) => change({ x })),
    y: axisFields("y", map, (y) => change({ y })),
  };
  root.append(operation, sides.x.root, sides.y.root);
  change({ x: sides.x.offer(map), y: sides.y.offer(map) });
  return {
    setCase(values) {
      current = { ...current, values };
      change({ x: sides.x.offer(current), y: sides.y.offer(current) });
    },
    showProblem(problem) {
      for (const { pointer, detail } of problem.errors) {
        const side = { 0: sides.y, 1: sides.x }[pointer.match(/^\/axes\/(\d)/)?.[1]];
        side?.showError(detail);
      }
    },
  };
}

function operationField(chosen, onChoice) {
  const options = Object.entries(OPERATIONS).map(([value, { label }]) => element("option", { value, selected: value === chosen }, label));
  const select = element("select", { id: "map-operation", onchange: () => onChoice(select.value) }, ...options);
  return element("div.field.whole", {}, element("label", { for: select.id }, "Show"), select);
}

/** Build the inputs of one axis: its field, its ends in the unit shown, and its number of values. */
function axisFields(side, map, onChange) {
  const problem = element("p.problem", { id: `map-${side}-problem`, hidden: true });
  const field = element("select", { id: `map-${side}-field` });
  const [start, stop] = ["From", "To"].map((label) => numberField(`map-${side}-${label.toLowerCase()}`, label));
  const count = numberField(`map-${side}-count`, "Values", { step: 1, min: 1 });
  const inputs = [start, stop, count].map(({ input }) => input);

  const showError = (text) => {
    problem.textContent = text;
    problem.hidden = !text;
  };
  const axis = () => {
    const { path, factor } = fieldAt(field.value);
    const [from, to] = inputs.map(({ valueAsNumber }) => Number((valueAsNumber * factor).toPrecision(12)));
    return { field: path, start: from, stop: to, count: count.input.valueAsNumber };
  };
  const lay = (wanted) => {
    field.value = wanted.field;
    const own = fieldAt(wanted.field);
    [start.input.value, stop.input.value] = [wanted.start, wanted.stop].map((end) => shownNumber(own, end));
    for (const { unit } of [start, stop]) unit.textContent = own.unit;
  };
  const offer = (current, isOther = false) => {
    const before = field.value || current[side].field;
    const fields = numericFields(current.values).filter(({ path }) => isVariable(current, path));
    field.replaceChildren(...fields.map((each) => element("option", { value: each.path }, labelWithUnit(each))));
    const isThere = fields.some(({ path }) => path === before);
    field.value = isThere ? before : fields[0].path;
    if (!isThere || (isOther && !isOn(axis(), current.values))) lay(around(field.value, current.values)); // the map always includes the case
    return axis();
  };
  const check = (current) => {
    const other = current[side === "x" ? "y" : "x"];
    const found = problemOf(current[side], other, current);
    showError(found?.text ?? "");
    inputs.forEach((input, i) => {
      input.setAttribute("aria-invalid", found?.parts.includes(i) ?? false);
      input.setAttribute("aria-describedby", problem.id);
    });
    return !found;
  };

  let { values } = map;
  field.addEventListener("change", () => {
    lay(around(field.value, values));
    onChange(axis());
  });
  for (const input of inputs) input.addEventListener("input", () => onChange(axis()));
  offer(map);
  if (field.value === map[side].field) lay(map[side]);
  count.input.value = map[side].count;
  const label = element("label", { for: field.id }, "Field");
  const root = element(
    "fieldset",
    {},
    element("legend", {}, SIDES[side]),
    element("div.field.whole", {}, label, field),
    ...[start, stop, count].map(({ root: row }) => row),
    problem,
  );
  return {
    root,
    check,
    lay(wanted) {
      if (![...field.options].some(({ value }) => value === wanted.field)) field.append(element("option", { value: wanted.field }));
      lay(wanted);
    },
    showError,
    offer(current) {
      const isOther = values !== current.values;
      values = current.values;
      return offer(current, isOther);
    },
  };
}

function numberField(id, label, attributes = {}) {
  const input = element("input", { id, type: "number", step: "any", required: true, ...attributes });
  const unit = element("span.unit");
  return { input, unit, root: element("div.field", {}, element("label", { for: id }, label), input, unit) };
}

/** Return the error message of an axis, and the inputs (from, to, count) that it concerns; undefined if there is no error. */
function problemOf({ field, start, stop, count }, other, map) {
  if (field === other.field) return { text: "Both axes have the same field.", parts: [] };
  const { factor, unit, path } = fieldAt(field);
  const bounds = boundsOf({ path, factor }, map.values);
  for (const [part, end] of [start, stop].entries()) {
    if (Number.isNaN(end)) return { text: "Both ends must be numbers.", parts: [part] };
    const broken = outside(shownNumber({ factor }, end), bounds);
    if (broken) return { text: `Must be ${broken[0]} ${withUnit(broken[1], unit)}.`, parts: [part] };
  }
  if (start > stop) return { text: "From must not be above To.", parts: [0, 1] };
  if (start === stop && count > 1) return { text: "The ends are the same.", parts: [0, 1] };
  const { most = 100 } = OPERATIONS[map.operation];
  const isCount = Number.isInteger(count) && count >= 1 && count <= most;
  return isCount ? undefined : { text: `Must be 1 to ${most} values.`, parts: [2] };
}
