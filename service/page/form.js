// The form of a case: every field in its unit, checked against the contract as it is filled in.

import { valueAt, withValue } from "./case.js";
import { exampleOf, nodeAt } from "./contract.js";
import { element } from "./elements.js";
import { GROUPS, boundsOf, isThere, shownValue } from "./fields.js";
import { digits } from "./words.js";

/**
 * Build the form.
 *
 * @param {HTMLElement} root
 * @param {{case: object, onChange: (values: object, path: string) => void, include?: string[],
 *   without?: string[], open?: string[]}} options
 *   `onChange` is told of a case only if all its fields are in their bounds; `include` names the groups of fields.js,
 *   all if none, `without` fields to leave out by their paths; `open` the groups that are not folded at first
 * @returns {{setCase: (values: object) => void, showProblems: (problem: Problem) => void, currentCase: () => object}}
 *   `showProblems` puts what the service says of a case at the fields it points to
 */
export function buildForm(root, { case: given, onChange, include, without = [], open = include }) {
  let values = given;
  let rows = [];
  const wrong = new Set();

  const change = (row, value) => {
    const { field } = row;
    tell(row, "");
    if (field.variant) {
      const holder = field.path.slice(0, field.path.lastIndexOf("."));
      values = withValue(values, holder, exampleOf(holder, value));
      rebuild(field.path);
    } else values = withValue(values, field.path, value);
    for (const each of rows) if (each.wasServer) tell(each, "");
    if (!wrong.size) onChange(values, field.path);
  };

  const tell = (row, problem, isServer = false) => {
    showProblem(row, problem);
    row.wasServer = Boolean(problem) && isServer;
    if (problem && !isServer) wrong.add(row.field.path);
    else wrong.delete(row.field.path);
  };

  const rebuild = (focusPath) => {
    const folded = [...root.querySelectorAll("details")].filter((group) => !group.open).map((group) => group.dataset.name);
    const isFirst = !root.childElementCount;
    rows = [];
    wrong.clear();
    const groups = GROUPS.filter(({ name }) => !include || include.includes(name));
    root.replaceChildren(
      ...groups.map(({ name, fields }) => {
        const made = fields
          .filter((field) => !without.includes(field.path) && isThere(field, values))
          .map((field) => buildRow(field, values, change, tell));
        rows.push(...made);
        const isOpen = isFirst ? !open || open.includes(name) : !folded.includes(name);
        return element(
          "details",
          { open: isOpen, "data-name": name },
          element("summary", {}, name),
          ...made.map(({ root: line }) => line),
        );
      }),
    );
    rows.find(({ field }) => field.path === focusPath)?.input.focus();
  };

  rebuild();
  return {
    currentCase: () => values,
    setCase(next) {
      values = next;
      rebuild();
    },
    showProblems({ errors, detail }) {
      const unplaced = errors.filter((error) => {
        const path = error.pointer.slice(1).replaceAll("/", ".");
        const row = rows.find(({ field }) => path === field.path || path.startsWith(`${field.path}.`));
        if (row) tell(row, error.detail, true);
        return !row;
      });
      return errors.length ? unplaced.map((error) => error.detail).join(" ") : detail;
    },
  };
}

function buildRow(field, values, change, tell) {
  const id = `field-${field.path.replaceAll(".", "-")}`;
  const problem = element("p.problem", { id: `${id}-problem`, hidden: true });
  const row = { field, problem };
  const read = (text) => {
    const { value, wrong } = parse(field, text, values);
    if (wrong) tell(row, wrong);
    else change(row, value);
  };
  row.input = INPUTS[field.kind](field, values, id, read);
  const described = [field.unit && `${id}-unit`, field.note && `${id}-note`].filter(Boolean).join(" ");
  if (described) row.input.setAttribute("aria-describedby", described);
  row.described = described;
  const slider = field.slider && buildSlider(field, values, row.input, read);
  row.root = element(
    `div.field${field.kind === "flag" ? ".flag" : ""}`,
    {},
    element("label", { for: id }, field.label),
    row.input,
    ...(field.unit ? [element("span.unit", { id: `${id}-unit` }, field.unit)] : []),
    ...(slider ? [slider] : []),
    ...(field.note ? [element("span.note", { id: `${id}-note` }, field.note)] : []),
    problem,
  );
  return row;
}

function showProblem({ input, problem, described, root }, text) {
  problem.hidden = !text;
  problem.textContent = text;
  const ids = [described, text && problem.id].filter(Boolean).join(" ");
  if (ids) input.setAttribute("aria-describedby", ids);
  else input.removeAttribute("aria-describedby");
  if (text) {
    input.setAttribute("aria-invalid", "true");
    root.closest("details").open = true;
  } else input.removeAttribute("aria-invalid");
}

const INPUTS = {
  number(field, values, id, read) {
    const node = nodeAt(field.path, values);
    const usual = node.default === undefined ? "" : String(Number((node.default / field.factor).toPrecision(12)));
    return element("input", {
      id,
      type: "text",
      inputmode: "decimal",
      autocomplete: "off",
      spellcheck: "false",
      required: !field.optional,
      placeholder: field.optional ? usual || "auto" : undefined,
      title: node.description,
      value: shownValue(field, values) ?? "",
      oninput: ({ target }) => read(target.value),
    });
  },
  choice(field, values, id, read) {
    const chosen = valueAt(values, field.path);
    const options = Object.entries(field.choices).map(([value, text]) =>
      element("option", { value, selected: value === chosen }, text),
    );
    return element("select", { id, onchange: ({ target }) => read(target.value) }, ...options);
  },
  flag(field, values, id, read) {
    const checked = Boolean(valueAt(values, field.path));
    return element("input", { id, type: "checkbox", checked, onchange: ({ target }) => read(target.checked) });
  },
  numbers(field, values, id, read) {
    const shown = (number) => Number((number / field.factor).toPrecision(12));
    const lines = (valueAt(values, field.path) ?? []).map((item) =>
      Array.isArray(item) ? item.map(shown).join(", ") : String(shown(item)),
    );
    return element(
      "textarea",
      { id, rows: field.pairs ? 4 : 2, spellcheck: "false", placeholder: "auto", oninput: ({ target }) => read(target.value) },
      lines.join(field.pairs ? "\n" : ", "),
    );
  },
};

function buildSlider(field, values, input, read) {
  const [min, max, step] = field.slider;
  const slider = element("input", {
    type: "range",
    min,
    max,
    step,
    value: shownValue(field, values),
    "aria-label": `${field.label}, slider`,
    oninput() {
      input.value = slider.value;
      read(slider.value);
    },
  });
  input.addEventListener("input", () => {
    slider.value = input.value;
  });
  return slider;
}

/** Return the value that a text stands for, in SI, or what is wrong with it. */
function parse(field, text, values) {
  if (field.kind === "flag" || field.kind === "choice") return { value: text };
  const trimmed = text.trim();
  if (!trimmed) return field.optional ? { value: undefined } : { wrong: "A number is needed." };
  if (field.kind === "number") return parseNumber(trimmed, field, boundsOf(field, values));
  return field.pairs ? parsePairs(trimmed, field) : parseNumbers(trimmed, field);
}

function parsePairs(text, { factor }) {
  const pairs = text.split("\n").map(numbersOf);
  const isRight = pairs.every((pair) => pair.length === 2 && pair.every(Number.isFinite));
  if (!isRight) return { wrong: "Each line is a pair of numbers, as in 60, 30." };
  return { value: pairs.map((pair) => pair.map((number) => toSi(number, factor))) };
}

function parseNumbers(text, { factor }) {
  const numbers = numbersOf(text);
  if (!numbers.every(Number.isFinite)) return { wrong: "Numbers are needed, with commas between." };
  return { value: numbers.map((number) => toSi(number, factor)) };
}

/** The factor without what floating point adds to it: 39 MPa is 39000000 Pa, 530 mm is 0.53 m. */
function toSi(number, factor) {
  return Number((number * factor).toPrecision(15));
}

function parseNumber(text, { factor, unit }, { least, most, above, below }) {
  const value = Number(text.replace("−", "-"));
  if (!Number.isFinite(value)) return { wrong: `${JSON.stringify(text)} is no number.` };
  const said = unit && unit !== "1" ? ` ${unit}` : "";
  const bound = (number) => `${Math.abs(number) < 1e-3 && number ? digits(number) : number}${said}`;
  if (least !== undefined && value < least) return { wrong: `At least ${bound(least)}.` };
  if (most !== undefined && value > most) return { wrong: `At most ${bound(most)}.` };
  if (above !== undefined && value <= above) return { wrong: `More than ${bound(above)}.` };
  if (below !== undefined && value >= below) return { wrong: `Less than ${bound(below)}.` };
  return { value: toSi(value, factor) };
}

function numbersOf(line) {
  return line
    .split(/[\s,;]+/)
    .filter(Boolean)
    .map(Number);
}
