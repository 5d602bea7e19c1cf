// The form of the inputs that scatter: a group each, with the errors of the service at its fields.

import { element } from "./elements.js";
import { shownNumber } from "./fields.js";
import { DISTRIBUTIONS, centreOf, inputField, parametersOf, scatterFields, usualInput, usualInputs, usualNote } from "./scatter.js";

const NUMBER = /-?\d+(?:\.\d+)?(?:e[+-]?\d+)?/g;

/**
 * Build the form.
 *
 * @param {HTMLElement} root
 * @param {{inputs: object[], values: object, onChange: () => void}} options `values` is the case
 * @returns {{inputs: () => object[]|undefined, setCase: (values: object) => void,
 *   showProblems: (errors: object[]) => object[]}} `inputs` are undefined while a field holds no number;
 *   `showProblems` returns the errors that point elsewhere
 */
export function buildScatterForm(root, options) {
  const form = new ScatterForm(root, options);
  form.rebuild();
  return {
    inputs: () => (form.rows.some(({ wrong }) => wrong.size) ? undefined : form.inputs),
    setCase(values) {
      form.values = values;
      form.rebuild();
    },
    showProblems: (errors) => form.showProblems(errors),
  };
}

class ScatterForm {
  rows = [];

  constructor(root, { inputs, values, onChange }) {
    Object.assign(this, { inputs, values, onChange });
    this.list = element("div");
    this.choice = element("select", { id: "scatter-add" });
    this.addButton = element("button", { type: "button", onclick: () => this.add() }, "Add");
    const usual = element("button", { type: "button", onclick: () => this.replace(usualInputs(this.values)) }, "Usual scatter");
    const label = element("label", { for: this.choice.id }, "Another input");
    root.append(this.list, element("div.field.whole", {}, label, this.choice), element("p.actions", {}, this.addButton, usual));
  }

  rebuild() {
    this.rows = this.inputs.map((input, index) => this.buildGroup(input, index));
    this.list.replaceChildren(...this.rows.map(({ root }) => root));
    const taken = new Set(this.inputs.map(({ field }) => field));
    const free = scatterFields(this.values).filter(({ path }) => !taken.has(path));
    this.choice.replaceChildren(...free.map(({ path, label }) => element("option", { value: path }, label)));
    this.addButton.disabled = !free.length;
  }

  replace(inputs) {
    this.inputs = inputs;
    this.rebuild();
    this.onChange();
  }

  add() {
    this.replace([...this.inputs, usualInput(this.choice.value)]);
    this.rows.at(-1).root.querySelector("select, input").focus();
  }

  remove(index) {
    this.replace(this.inputs.filter((_, i) => i !== index));
    this.choice.focus();
  }

  buildGroup(input, index) {
    const id = `scatter-${index}`;
    const { label } = inputField(input.field);
    const problem = element("p.problem", { id: `${id}-problem`, hidden: true });
    const row = { fields: new Map(), wrong: new Set(), problem };
    for (const parameter of parametersOf(input)) row.fields.set(parameter.name, this.buildField(row, index, parameter));
    const remove = element(
      "button",
      { type: "button", "aria-label": `Remove ${label}`, onclick: () => this.remove(index) },
      "Remove",
    );
    row.root = element("fieldset", {}, element("legend", {}, label));
    if (input.type !== "discrete") row.root.append(this.buildType(input, index));
    const note = usualNote(input.field);
    const notes = note ? [element("p.quiet", {}, note)] : [];
    row.root.append(...[...row.fields.values()].map(({ root }) => root), ...notes, problem);
    row.root.append(element("p.actions", {}, remove));
    return row;
  }

  buildType({ field, type }, index) {
    const options = Object.entries(DISTRIBUTIONS).map(([value, each]) =>
      element("option", { value, selected: value === type }, each.label),
    );
    const id = `scatter-${index}-type`;
    const onchange = ({ target }) => {
      const other = { field, type: target.value, given: {} };
      this.replace(this.inputs.map((each, i) => (i === index ? other : each)));
      document.getElementById(id).focus();
    };
    return element(
      "div.field",
      {},
      element("label", { for: id }, "Distribution"),
      element("select", { id, onchange }, ...options),
    );
  }

  buildField(row, index, { name, label, unit, factor, centre }) {
    const { field, type, given } = this.inputs[index];
    const id = `scatter-${index}-${name}`;
    const usual = centre ? centreOf(field, this.values) : undefined;
    const problem = element("p.problem", { id: `${id}-problem`, hidden: true });
    const unitText = element("span.unit", { id: `${id}-unit` }, type === "discrete" ? "weight" : unit);
    const input = element("input", {
      id,
      type: "text",
      inputmode: "decimal",
      autocomplete: "off",
      placeholder: usual === undefined ? undefined : shownNumber({ factor }, usual),
      value: given[name] === undefined ? "" : shownNumber({ factor }, given[name]),
      oninput: () => this.read(row, index, name, factor),
    });
    const root = element("div.field", {}, element("label", { for: id }, label), input, unitText, problem);
    const part = { root, input, problem, described: unitText.id, unit, factor };
    showError(part, "");
    return part;
  }

  read(row, index, name, factor) {
    const part = row.fields.get(name);
    const text = part.input.value.trim().replaceAll("−", "-");
    const value = text ? Number(text) : undefined;
    const isWrong = value !== undefined && !Number.isFinite(value);
    row.wrong[isWrong ? "add" : "delete"](name);
    this.clear();
    if (!isWrong) {
      const { [name]: _, ...others } = this.inputs[index].given;
      const given = value === undefined ? others : { ...others, [name]: Number((value * factor).toPrecision(15)) };
      this.inputs = this.inputs.map((each, i) => (i === index ? { ...each, given } : each));
    }
    this.onChange();
  }

  /** Leave only what is no number marked. */
  clear() {
    for (const { fields, wrong, problem } of this.rows) {
      problem.hidden = true;
      for (const [name, part] of fields) showError(part, wrong.has(name) ? `${JSON.stringify(part.input.value)} is not a number.` : "");
    }
  }

  showProblems(errors) {
    return errors.filter(({ pointer, detail }) => {
      const [, index, ...names] = pointer.slice(1).split("/");
      const row = pointer.startsWith("/uncertain/") && this.rows[index];
      if (!row) return true;
      const part = names.map((name) => row.fields.get(name)).find(Boolean);
      if (part) showError(part, inUnit(detail, part));
      else {
        row.problem.textContent = detail;
        row.problem.hidden = false;
        for (const each of row.fields.values()) mark(each, row.problem.id);
      }
      return false;
    });
  }
}

/** Return an error of the service for a parameter, its numbers in the unit shown. */
function inUnit(detail, { unit, factor }) {
  if (!unit) return detail;
  return detail.replaceAll(NUMBER, (number) => `${shownNumber({ factor }, Number(number))} ${unit}`);
}

function showError(part, text) {
  part.problem.textContent = text;
  part.problem.hidden = !text;
  if (text) mark(part, part.problem.id);
  else {
    part.input.removeAttribute("aria-invalid");
    part.input.setAttribute("aria-describedby", part.described);
  }
}

function mark({ input, described }, problem) {
  input.setAttribute("aria-invalid", "true");
  input.setAttribute("aria-describedby", `${described} ${problem}`);
}
