// Compares the current strike with pinned strikes, which are kept in the address.

import { address, caseQuery, readCase } from "./address.js";
import { angleRequest } from "./case.js";
import { announce, element, table } from "./elements.js";
import { GROUPS, fieldShown, labelWithUnit } from "./fields.js";
import { computeRun } from "./run.js";
import { isAbort, isLost, request } from "./service.js";
import { markFresh, markStale } from "./stale.js";
import { inUnits, unitOf } from "./units.js";
import { outcomeShown, statusShown } from "./words.js";

/** Largest number of pinned strikes; with the current one, four are compared. */
export const MOST_PINS = 3;
const OWN = "This strike";
const ABOUT =
  "Change a field, or choose another preset, to compare this strike with the pinned ones. Differences from this strike are in brackets.";
const LETTERS = ["A", "B", "C"];
/** Rows of results in the table: label, value (a number or a word) and, for a number, its decimals and its unit in SI. */
const RESULTS = [
  ["Outcome", ({ run }) => outcomeShown(run.outcome)],
  ["Critical angle", ({ found }) => found.critical_angle_deg ?? statusShown(found.status), 2, "°"],
  ["Greatest depth", ({ run }) => (run.outcome === "perforated" ? "through" : run.maximum_depth_m), 1, "mm"],
  ["End of motion", ({ run }) => 1e3 * run.final.time_s, 2, "ms"],
  ["Axis angle at the end", ({ run }) => run.final.axis_angle_deg, 1, "°"],
  ["Speed at the exit", ({ run }) => run.exit?.speed_m_s ?? "none", 1, "m/s"],
  ["Direction at the exit, from the face", ({ run }) => run.exit?.elevation_deg ?? "none", 1, "°"],
  ["Strength factor S at its oblique angle", ({ run }) => run.strength_factor, 2],
];

/** Return the pinned strikes of a query. */
export const readPins = (query) => query.getAll("pin").slice(0, MOST_PINS).map((text) => readCase(new URLSearchParams(text)));

/** Set the pinned strikes of a query. */
export function writePins(query, pins) {
  query.delete("pin");
  for (const values of pins) query.append("pin", caseQuery(values));
  return query;
}

/** The pinned strikes, the button that pins another, and the table of differences. */
export class Compare {
  /**
   * @param {object[]} pins cases
   * @param {{currentCase: () => object, onChange: () => void}} listeners `onChange` is called when the pinned strikes change
   */
  constructor(pins, { currentCase, onChange }) {
    Object.assign(this, { currentCase, onChange });
    this.pinned = pins.map((values) => ({ values }));
    this.button = element("button", { type: "button", onclick: () => this.#pin() }, "Pin to compare");
    this.problem = element("p.problem", { role: "alert" });
    this.table = element("div", {}, element("p.quiet", {}, "Computing ..."));
    this.root = element("section.panel.across.compare", { "aria-label": "Comparison" }, element("h2", {}, "Comparison"), element("p.quiet", {}, ABOUT), this.problem, this.table);
    this.#refresh();
  }

  /** The cases of the pinned strikes. */
  get cases() {
    return this.pinned.map(({ values }) => values);
  }

  /** Compute the pinned strikes; one that the service does not accept is unpinned. */
  async load(signal) {
    const load = async (pin) => {
      try {
        pin.run ??= await computeRun(pin.values, signal);
        pin.found ??= (await request("cra", { body: inUnits(angleRequest(pin.values)), signal })).data;
      } catch (error) {
        if (isAbort(error) || isLost(error)) throw error;
        this.#unpin(pin);
        this.problem.textContent = `A pinned strike was not accepted, and is left out: ${error.message}`;
      }
    };
    await Promise.all(this.pinned.map(load));
  }

  /** Return the runs to draw: the current strike and the pinned ones. */
  withRuns(run) {
    const others = this.pinned.filter((pin) => pin.run).map((pin, i) => ({ run: pin.run, name: LETTERS[i] }));
    return [{ run, name: others.length ? OWN : "Strike" }, ...others];
  }

  /** Show how the pinned strikes differ from the current one; false if not all of them are computed. */
  show(own) {
    const others = this.pinned.filter(({ run, found }) => run && found);
    if (others.length < this.pinned.length) return false;
    this.table.replaceChildren(this.#tableOf([own, ...others]));
    return true;
  }

  #pin() {
    const values = this.currentCase();
    if (this.cases.some((each) => JSON.stringify(each) === JSON.stringify(values))) return announce("This strike is already pinned.");
    this.pinned.push({ values });
    this.#refresh();
    return this.onChange();
  }

  #unpin(pin) {
    this.pinned = this.pinned.filter((each) => each !== pin);
    this.#refresh();
    this.onChange();
  }

  #refresh() {
    this.root.hidden = !this.pinned.length;
    this.button.disabled = this.pinned.length >= MOST_PINS;
    this.button.textContent = this.button.disabled ? `Pinned: ${MOST_PINS}, the most` : "Pin to compare";
    if (this.root.hidden) markFresh(this.table);
    else markStale(this.table);
  }

  #tableOf(strikes) {
    const numbers = RESULTS.map(([label, make, decimals, si]) => resultRow({ label, ...unitOf(si) }, strikes.map(make), decimals));
    const heads = ["", OWN, ...this.pinned.map((pin, i) => this.#head(pin, i))];
    return table("table", { heads, rows: [...fieldRows(strikes), ...numbers], label: "Table of differences", isNamed: true });
  }

  #head(pin, index) {
    const name = LETTERS[index];
    const others = this.cases.filter((each) => each !== pin.values);
    const open = address("explore", writePins(caseQuery(pin.values), [...others, this.currentCase()]));
    const remove = element("button", { type: "button", "aria-label": `Remove ${name}`, onclick: () => this.#unpin(pin) }, "Remove");
    return element("span", {}, `${name} `, element("a", { href: open, "aria-label": `Open ${name}` }, "Open"), " ", remove);
  }
}

function fieldRows(strikes) {
  return GROUPS.flatMap(({ fields }) => fields).flatMap((field) => {
    const texts = strikes.map(({ values }) => fieldShown(field, values));
    if (texts.every((text) => text === texts[0])) return [];
    return [[labelWithUnit(field), ...texts]];
  });
}

function resultRow(quantity, values, decimals) {
  const [own, ...others] = values.map((value) => (typeof value === "number" ? value / quantity.factor : value));
  const text = (value) => (typeof value === "number" ? (Number(value.toFixed(decimals)) || 0).toFixed(decimals) : value); // no -0.0
  const withDifference = (value) => {
    if (typeof value !== "number" || typeof own !== "number") return text(value);
    const difference = text(value - own);
    return `${text(value)} (${difference < 0 ? "−" : "+"}${difference.replace("-", "")})`;
  };
  return [labelWithUnit(quantity), text(own), ...others.map(withDifference)];
}
