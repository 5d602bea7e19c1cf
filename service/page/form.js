// The form of a case: every field in its unit, checked against the contract as it is filled in.

import { withValue } from "./case.js";
import { exampleOf } from "./contract.js";
import { element } from "./elements.js";
import { buildRow, showProblem } from "./field-row.js";
import { GROUPS, inUnit, isThere } from "./fields.js";

/**
 * Build the form.
 *
 * @param {HTMLElement} root
 * @param {{case: object, onChange: (values: object, path: string) => void, include?: string[],
 *   onRefuse?: () => void, without?: string[], open?: string[],
 *   beside?: {root: HTMLElement, paths: string[]}}} options
 *   `onChange` is called with a case only if all its fields are in their bounds, `onRefuse` otherwise; `include` names the groups of fields.js,
 *   all if none, `without` fields to leave out by their paths; `open` the groups that are not folded at first; `beside`
 *   where the fields with these paths are shown instead
 * @returns {{setCase: (values: object) => void, setField: (path: string, shown: number) => void, showProblems: (problem: Problem) => string, currentCase: () => object}}
 *   `setField` fills in a field as if it were typed; `showProblems` shows the errors of a problem at the fields they point to, and returns the rest
 */
export function buildForm(root, options) {
  const form = new CaseForm(root, options);
  form.rebuild();
  return {
    currentCase: () => form.values,
    setCase(values) {
      form.values = values;
      form.rebuild();
    },
    setField: (path, value) => form.setField(path, value),
    showProblems: (problem) => form.showProblems(problem),
  };
}

class CaseForm {
  rows = [];
  wrong = new Set(); // paths of fields whose text is not accepted

  constructor(root, { case: values, onChange, onRefuse, include, without = [], open = include, beside }) {
    Object.assign(this, { root, values, onChange, onRefuse, without, open, beside });
    this.help = element("label.describe", {}, element("input", { type: "checkbox" }), " Describe every field");
    this.groups = GROUPS.filter(({ name }) => !include || include.includes(name));
  }

  rebuild() {
    const before = new Map([...this.root.children].map((group) => [group.dataset.name, group.open]));
    this.rows = [];
    this.wrong.clear();
    const isBeside = ({ path }) => this.beside?.paths.includes(path) ?? false;
    const there = this.groups.flatMap(({ fields }) => fields).filter((field) => this.has(field));
    this.beside?.root.replaceChildren(...there.filter(isBeside).map((field) => this.addRow(field)));
    this.root.replaceChildren(
      this.help,
      ...this.groups.map(({ name, fields }) => {
        const inside = fields.filter((field) => there.includes(field) && !isBeside(field));
        const lines = inside.map((field) => this.addRow(field));
        const open = before.get(name) ?? (!this.open || this.open.includes(name));
        return element("details", { open, "data-name": name }, element("summary", {}, name), ...lines);
      }),
    );
  }

  setField(path, shown) {
    const { input } = this.rows.find(({ field }) => field.path === path);
    input.value = shown;
    input.dispatchEvent(new Event("input")); // its slider listens too
  }

  has(field) {
    return !this.without.includes(field.path) && isThere(field, this.values);
  }

  addRow(field) {
    const row = buildRow(field, this.values, {
      accept: (value) => this.accept(row, value),
      refuse: (problem) => {
        this.wrong.add(field.path);
        showProblem(row, problem);
        this.onRefuse?.();
      },
    });
    this.rows.push(row);
    return row.root;
  }

  accept({ field }, value) {
    this.wrong.delete(field.path);
    for (const row of this.rows) if (!this.wrong.has(row.field.path)) showProblem(row, "");
    if (field.variant) this.takeVariant(field, value);
    else this.values = withValue(this.values, field.path, value);
    if (!this.wrong.size) this.onChange(this.values, field.path);
  }

  /** Start from the example of another variant, whose fields are others. */
  takeVariant({ path }, name) {
    const holder = path.slice(0, path.lastIndexOf("."));
    this.values = withValue(this.values, holder, exampleOf(holder, name));
    this.rebuild();
    this.rows.find(({ field }) => field.path === path).input.focus();
  }

  showProblems({ errors, detail }) {
    const unplaced = errors.filter((error) => {
      const path = error.pointer.slice(1).replaceAll("/", ".");
      const row = this.rows.find(({ field }) => `${path}.`.startsWith(`${field.path}.`));
      if (row) showProblem(row, inUnit(row.field, error.detail));
      return !row;
    });
    return errors.length ? unplaced.map((error) => error.detail).join(" ") : detail;
  }
}
