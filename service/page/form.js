// The form of a case, with every field in the unit shown and checked against the contract while the user types.

import { valueAt, withValue } from "./case.js";
import { exampleOf, paperCase } from "./contract.js";
import { announce, element, showText } from "./elements.js";
import { buildRow, fillIn, showProblem } from "./field-row.js";
import { GROUPS, MASS, isThere, shownValue, withSphere } from "./fields.js";
import { clearParts, markStale } from "./stale.js";
import { keep, kept } from "./storage.js";

const MOST_UNDONE = 100;
const DESCRIBES = "ricochet-describe"; // key of the setting whether every field is described

/** The form of a case. */
export class CaseForm {
  rows = [];
  wrong = new Set(); // paths of fields whose text is not accepted
  isHeld = false; // whether a field is not accepted by the form or the service
  undone = []; // cases before each edit, with the field that was edited

  /**
   * @param {HTMLElement} root
   * @param {{case: object, onChange: (values: object, path: string) => void, onHold?: () => void, problem: HTMLElement, parts?: () => HTMLElement[],
   *   panels?: object[], actions?: HTMLFieldSetElement[], include?: string[], groups?: object[], open?: string[]}} options
   *   `onChange` is called with a case whenever all its fields are accepted, `onHold` while one is not; `problem` shows errors that
   *   belong to no field; `parts` are marked as results of previous inputs while the user may still be typing, and emptied, except
   *   for pictures, once a value is refused; `hold` and `clear` of the `panels` are called at the same times; `actions` hold the
   *   buttons that act on the case, which are disabled while a field is not accepted; `include` names the groups of fields.js to show
   *   (all by default), `groups` are shown in their place; `open` names the groups that are expanded at first
   */
  constructor(root, { case: values, onChange, onHold, problem, parts = () => [], panels = [], actions = [], include, groups, open = include }) {
    Object.assign(this, { root, values, onChange, onHold, problem, parts, panels, actions, open });
    const describes = element("input", { type: "checkbox", checked: kept(DESCRIBES) === "yes" });
    describes.addEventListener("change", () => keep(DESCRIBES, describes.checked ? "yes" : "no"));
    this.help = element("label.describe", {}, describes, " Describe every field");
    this.undoButton = element("button", { type: "button", disabled: true, onclick: () => this.undo() }, "Undo");
    this.groups = groups ?? include?.map((given) => GROUPS.find(({ name }) => name === given)) ?? GROUPS;
    this.tools = groups ? [] : [element("p.actions", {}, this.help, this.undoButton)];
    this.rebuild();
  }

  /** Return the case in the fields; while a field is not accepted, the previous case. */
  currentCase = () => this.values;

  rebuild() {
    const before = new Map([...this.root.children].map((group) => [group.dataset.name, group.open]));
    for (const row of this.rows) row.later();
    this.rows = [];
    this.wrong.clear();
    this.root.replaceChildren(
      ...this.tools,
      ...this.groups.map(({ name, fields, isFolded }) => {
        const lines = fields.filter((field) => isThere(field, this.values)).map((field) => this.addRow(field));
        const open = before.get(name) ?? (isFolded ? fields.some((field) => this.isOther(field)) : !this.open || this.open.includes(name));
        return element("details", { open, "data-name": name }, element("summary", {}, name), ...lines);
      }),
    );
  }

  /** Fill in a field as if a value in SI were typed. */
  setField(path, value) {
    const { input, field } = this.rows.find((row) => row.field.path === path);
    fillIn(input, Number((value / field.factor).toPrecision(12)));
  }

  /** Open the place of the user's own shots, without which the law that uses them computes nothing. */
  enterShots() {
    const { input } = this.rows.find(({ field }) => field.path === "resistance.strength_factor.model");
    if (input.value !== "own_tests") {
      input.value = "own_tests";
      input.dispatchEvent(new Event("change"));
      this.clear("");
    }
    const shots = this.rows.find(({ field }) => field.kind === "shots");
    shots.root.closest("details").open = true;
    shots.input.focus();
  }

  /** Return whether the case has a value of a field that differs from the paper's. */
  isOther({ path }) {
    const [own, usual] = [this.values, paperCase()].map((values) => JSON.stringify(valueAt(values, path)));
    return own !== undefined && own !== usual;
  }

  addRow(field) {
    const row = buildRow(field, this.values, {
      currentOf: () => this.values,
      accept: (value) => this.accept(row, value),
      hold: () => {
        this.wrong.add(field.path);
        this.hold();
      },
      refuse: (problem) => {
        showProblem(row, problem);
        this.clear("");
      },
    });
    this.rows.push(row);
    if (field.kind === "shots" && !valueAt(this.values, field.path)) this.wrong.add(field.path); // the user has yet to enter them
    return row.root;
  }

  accept({ field }, value) {
    this.wrong.delete(field.path);
    this.remember(field.path);
    if (field.variant) this.takeVariant(field, value);
    else this.take(withValue(this.values, field.path, value));
    for (const row of this.rows) if (!this.wrong.has(row.field.path)) showProblem(row, "");
    if (field.takes) {
      this.values = field.takes(this.values, value);
      this.rebuild();
      this.rows.find((row) => row.field.path === field.path).input.focus();
    }
    if (this.wrong.size) return;
    this.problem.textContent = "";
    this.change(field.path);
  }

  /** Take a changed case, and show the mass that followed the diameter of a sphere. */
  take(values) {
    this.values = withSphere(values, this.values);
    if (valueAt(values, MASS) === valueAt(this.values, MASS)) return;
    const row = this.rows.find(({ field }) => field.path === MASS);
    row.input.value = shownValue(row.field, this.values);
    this.wrong.delete(MASS);
  }

  change(path) {
    this.setHeld(false);
    this.onChange(this.values, path);
  }

  setHeld(isHeld) {
    this.isHeld = isHeld;
    for (const each of this.actions) each.disabled = isHeld;
  }

  /** Mark the results as those of previous inputs while the user types a value that is not valid yet. */
  hold() {
    this.setHeld(true);
    this.onHold?.();
    for (const panel of this.panels) panel.hold();
    markStale(...this.parts());
    this.announceMissing();
  }

  /** Say that the user's own shots are missing, unless they are there or not used. */
  announceMissing() {
    const missing = this.rows.find(({ field, input }) => field.kind === "shots" && !input.value);
    if (missing) announce(`${missing.field.label}: none yet.`);
  }

  /** Remove the results, because a field is not accepted. */
  clear(text) {
    this.hold();
    for (const panel of this.panels) panel.clear();
    clearParts(...this.parts());
    this.announceMissing();
    showText(this.problem, text);
  }

  /** Show an error at the fields to which it points or, if it points to none, beside the form. */
  fail(error) {
    if (error.errors?.length) this.refuse(error);
    else showText(this.problem, error.message);
  }

  /** Store the case before an edit; further keystrokes in the same field belong to the same edit. */
  remember(path) {
    if (this.undone.at(-1)?.path !== path) this.undone = [...this.undone, { values: this.values, path }].slice(-MOST_UNDONE);
    this.undoButton.disabled = false;
  }

  undo() {
    const { values, path } = this.undone.pop();
    this.undoButton.disabled = !this.undone.length;
    this.values = values;
    this.rebuild();
    if (this.wrong.size) return this.hold();
    this.change(path);
    return announce(`${this.rows.find(({ field }) => field.path === path)?.field.label ?? "The change"} is as before.`);
  }

  /** Start from the example of another variant, which has other fields, but without its shots, which are not the user's. */
  takeVariant({ path }, name) {
    const holder = path.slice(0, path.lastIndexOf("."));
    const { shots, ...example } = exampleOf(holder, name);
    this.values = withSphere(withValue(this.values, holder, example), this.values);
    this.rebuild();
    if (this.wrong.size) this.hold();
    this.rows.find(({ field }) => field.path === path).input.focus();
  }

  /** Show the errors of the service, but not while the user still types in the field. */
  refuse({ errors }) {
    const values = this.values;
    const rowOf = ({ pointer }) => {
      const path = pointer.slice(1).replaceAll("/", ".");
      return this.rows.find(({ field }) => `${path}.`.startsWith(`${field.path}.`));
    };
    const wordsOf = ({ label }, { detail }) => (detail.startsWith("must ") ? `${label} ${detail}` : detail);
    const show = () => {
      if (values !== this.values) return;
      const unplaced = errors.filter((error) => !rowOf(error));
      for (const error of errors) if (rowOf(error)) showProblem(rowOf(error), wordsOf(rowOf(error).field, error));
      this.clear(unplaced.map((error) => error.detail).join(" "));
    };
    const typed = this.rows.find(({ input }) => input === document.activeElement && input.type === "text");
    if (!typed) return show();
    this.hold();
    return typed.later(show);
  }
}
