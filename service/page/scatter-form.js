// The form of the inputs that scatter: a group for each input, with errors of the service at its fields.

import { element, showText } from "./elements.js";
import { buildRow, showProblem } from "./field-row.js";
import { fieldOf, shownNumber } from "./fields.js";
import { DISTRIBUTIONS, NOTES, centreOf, inputField, parametersOf, scatterFields, usualInput, usualInputs } from "./scatter.js";

export class ScatterForm {
  groups = [];
  wrong = new Set(); // rows whose text is not accepted

  /**
   * @param {HTMLElement} root
   * @param {{inputs: object[], values: object, onChange: () => void}} options `values` is the case
   */
  constructor(root, { inputs, values, onChange }) {
    Object.assign(this, { given: inputs, values, onChange });
    this.list = element("div");
    this.choice = element("select", { id: "scatter-add" });
    this.addButton = element("button", { type: "button", onclick: () => this.add() }, "Add");
    const usual = element("button", { type: "button", onclick: () => this.replace(usualInputs(this.values)) }, "Usual scatter");
    const label = element("label", { for: this.choice.id }, "Another input");
    root.append(this.list, element("div.field.whole", {}, label, this.choice), element("p.actions", {}, this.addButton, usual));
    this.rebuild();
  }

  /** The inputs that scatter; undefined while a field holds no number. */
  get inputs() {
    return this.wrong.size ? undefined : this.given;
  }

  setCase(values) {
    this.values = values;
    this.rebuild();
  }

  setInputs(inputs) {
    if (JSON.stringify(inputs) === JSON.stringify(this.given)) return; // so that the focus stays
    this.given = inputs;
    this.rebuild();
  }

  rebuild() {
    this.wrong.clear();
    this.groups = this.given.map((input, index) => this.buildGroup(input, index));
    this.list.replaceChildren(...this.groups.map(({ root }) => root));
    const taken = new Set(this.given.map(({ field }) => field));
    const free = scatterFields(this.values).filter(({ path }) => !taken.has(path));
    this.choice.replaceChildren(...free.map(({ path, label }) => element("option", { value: path }, label)));
    this.addButton.disabled = !free.length;
  }

  replace(inputs) {
    this.given = inputs;
    this.rebuild();
    this.onChange();
  }

  add() {
    this.replace([...this.given, usualInput(this.choice.value)]);
    this.groups.at(-1).root.querySelector("select, input").focus();
  }

  remove(index) {
    this.replace(this.given.filter((_, i) => i !== index));
    this.choice.focus();
  }

  buildGroup(input, index) {
    const { label } = inputField(input.field);
    const problem = element("p.problem", { id: `scatter-${index}-problem`, hidden: true });
    const rows = parametersOf(input).map((parameter) => this.buildParameter(index, parameter));
    const remove = element("button", { type: "button", "aria-label": `Remove ${label}`, onclick: () => this.remove(index) }, "Remove");
    const type = input.type === "discrete" ? [] : [this.buildType(input, index)];
    const note = NOTES[input.field];
    const parts = [...type, ...rows.map((row) => row.root), ...(note ? [element("p.quiet", {}, note)] : []), problem, element("p.actions", {}, remove)];
    return { root: element("fieldset", {}, element("legend", {}, label), ...parts), rows, problem };
  }

  buildType({ field, type }, index) {
    const options = Object.entries(DISTRIBUTIONS).map(([value, each]) =>
      element("option", { value, selected: value === type }, each.label),
    );
    const id = `scatter-${index}-type`;
    const onchange = ({ target }) => {
      const other = { field, type: target.value, given: {} };
      this.replace(this.given.map((each, i) => (i === index ? other : each)));
      document.getElementById(id).focus();
    };
    return element("div.field", {}, element("label", { for: id }, "Distribution"), element("select", { id, onchange }, ...options));
  }

  /** Build the row of a parameter as an optional field; an empty centre stands for the value of the case. */
  buildParameter(index, { name, label, si, centre }) {
    const { field: path, given } = this.given[index];
    const field = fieldOf("number", `uncertain.${index}.${name}`, si, { label, name, optional: true });
    const usual = centre ? centreOf(path, this.values) : undefined;
    field.open = usual === undefined ? "" : String(shownNumber(field, usual));
    const row = buildRow(field, { uncertain: { [index]: given } }, {
      accept: (value) => {
        this.wrong.delete(row);
        this.clear();
        const { [name]: _, ...others } = this.given[index].given;
        const next = value === undefined ? others : { ...others, [name]: value };
        this.given = this.given.map((each, i) => (i === index ? { ...each, given: next } : each));
        this.onChange();
      },
      hold: () => {
        this.wrong.add(row);
        this.clear();
        this.onChange();
      },
      refuse: (problem) => showProblem(row, problem),
    });
    return row;
  }

  /** Remove the error messages of the service. */
  clear() {
    for (const { rows, problem } of this.groups) {
      problem.hidden = true;
      for (const row of rows) if (!this.wrong.has(row)) showProblem(row, "");
    }
  }

  /** Show errors at the fields they point to; return those that point elsewhere. */
  showProblems(errors) {
    return errors.filter(({ pointer, detail }) => {
      const [, index, ...names] = pointer.slice(1).split("/");
      const group = pointer.startsWith("/uncertain/") && this.groups[index];
      if (!group) return true;
      const row = group.rows.find(({ field }) => names.includes(field.name));
      if (row) showProblem(row, detail);
      else {
        showText(group.problem, detail);
        group.problem.hidden = false;
      }
      return false;
    });
  }
}
