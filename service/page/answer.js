// The answer to a case: its critical angle with the spread, the choice of model beside it, and the warnings to it.

import { address, caseQuery } from "./address.js";
import { angleRequest } from "./case.js";
import { element } from "./elements.js";
import { latest } from "./latest.js";
import { QUICK, inputField, uncertainInput, usualInputs } from "./scatter.js";
import { request } from "./service.js";
import { clearParts, markFresh, markStale } from "./stale.js";
import { knownStudy, quantileOf } from "./study.js";
import { describeAngle, digits, warningList } from "./words.js";

const REST_MS = 300; // without a change before the spread is computed: it is hundreds of searches

/** Fields that are shown beside the answer instead of in the form. */
export const MODEL_FIELDS = ["resistance.free_surface.model", "resistance.strength_factor.model"];

/** The panel with the answer. */
export class Answer {
  #key; // of the case whose angle is shown
  #values;

  /**
   * @param {{onError: (error: Error) => void, onAngle: (found: object, values: object) => void}} listeners `onAngle` is
   *   called with the answer of `/cra` for the inputs shown, whenever these change
   */
  constructor({ onError, onAngle }) {
    this.onAngle = onAngle;
    this.angle = element("div.outcome", {}, element("p.quiet", {}, "Computing ..."));
    this.spread = element("div.spread", { role: "group", "aria-label": "Spread" });
    this.models = element("div.models", { role: "group", "aria-label": "Choice of model" });
    this.warnings = element("div", {});
    this.root = element(
      "section.panel.across.answer",
      { "aria-label": "Answer" },
      element("div", {}, this.angle, this.spread),
      this.models,
      this.warnings,
    );
    this.updateAngle = latest((values, signal) => this.#showAngle(values, signal), onError);
    const showSpread = (wanted, signal) => this.#showSpread(wanted, signal);
    this.updateSpread = latest(showSpread, onError, { supersede: true, restMs: REST_MS });
  }

  /** Show the answer to a case. */
  setCase(values) {
    this.#values = values;
    if (keyOf(values) !== this.#key) {
      markStale(this.angle, this.warnings, this.spread);
      this.updateSpread.cancel();
    }
    this.updateAngle(values);
  }

  /** Return whether the angle that is shown is that of a case. */
  isOf(values) {
    return keyOf(values) === this.#key;
  }

  /** Show none, as a field is not accepted. */
  clear() {
    this.updateAngle.cancel();
    this.updateSpread.cancel();
    this.#key = undefined;
    clearParts(this.angle, this.warnings, this.spread);
  }

  /** Show the range under other laws too, if the answer is of this case. */
  setAlternatives(found, values) {
    if (keyOf(values) === this.#key) this.angle.replaceChildren(describeAngle(found));
  }

  stop() {
    this.updateAngle.stop();
    this.updateSpread.stop();
  }

  async #showAngle(values, signal) {
    const key = keyOf(values);
    if (key === this.#key && !this.angle.hasAttribute("aria-busy")) return this.onAngle(this.found, values); // at another angle
    const found = (await request("cra", { body: angleRequest(values), signal })).data;
    if (signal.aborted) return;
    this.angle.replaceChildren(describeAngle(found));
    this.warnings.replaceChildren(...warningList(found.warnings));
    this.#key = key;
    this.found = found;
    if (this.updateAngle.isBehind()) return;
    markFresh(this.angle, this.warnings);
    this.onAngle(found, values);
    if (found.critical_angle_deg === undefined) {
      this.spread.replaceChildren();
      markFresh(this.spread);
    } else this.updateSpread({ values, sampling: QUICK });
  }

  async #showSpread({ values, sampling }, signal) {
    const inputs = usualInputs(values);
    const uncertain = inputs.map((input) => uncertainInput(input, values));
    const body = { ...angleRequest(values), uncertain, sensitivity: false, sampling };
    const study = knownStudy(values, inputs) ?? (await request("cra/uncertainty", { body, signal })).data;
    if (signal.aborted) return;
    this.spread.replaceChildren(...describeSpread(study, inputs, () => this.#refine()), howSure(values));
    markFresh(this.spread);
  }

  #refine() {
    markStale(this.spread);
    this.updateSpread({ values: this.#values, sampling: {} });
  }
}

/** Return a spread in words, with the inputs that scatter, and a button for a narrower one. */
function describeSpread(study, inputs, refine) {
  const [low, middle, high] = [0.05, 0.5, 0.95].map((level) => quantileOf(study, level));
  if (low === undefined) return [element("p", {}, "No sample has a critical angle.")];
  const shown = (angle) => `${angle.toFixed(1)}°`;
  const names = inputs.map(({ field }) => inputField(field).label.toLowerCase()).join(", ");
  const without = study.critical_angle.share_without_angle.value;
  const none = without > 0 ? `, ${digits(100 * without, 2)} % without an angle` : "";
  const by = `${study.method === "surrogate" ? "polynomials fitted to " : ""}${study.samples.toLocaleString("en")} searches`;
  const words = element(
    "p",
    {},
    `Median ${shown(middle)}, 90 % range `,
    element("strong", {}, `${shown(low)} to ${shown(high)}`),
    ` with the usual scatter of ${names} (by ${by}${none}).`,
  );
  const isQuick = study.samples === QUICK.max_samples && study.method === "direct";
  return isQuick ? [words, element("button", { type: "button", onclick: refine }, "Refine the spread")] : [words];
}

function howSure(values) {
  return element("a", { href: address("how-sure", caseQuery(values)) }, "How sure, input by input");
}

/** Return what a critical angle depends on, as text. */
function keyOf(values) {
  return JSON.stringify(angleRequest(values));
}
