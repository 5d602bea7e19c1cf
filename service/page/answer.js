// The answer to a case: its critical angle with the spread, the choice of model beside it, and the warnings to it.

import { address, caseQuery } from "./address.js";
import { angleRequest } from "./case.js";
import { element } from "./elements.js";
import { latest } from "./latest.js";
import { usualInputs, uncertainInput } from "./scatter.js";
import { ask } from "./service.js";
import { clearParts, markFresh, markStale } from "./stale.js";
import { headline, knownStudy, quantileOf } from "./study.js";
import { degreesShown, digits, tellAngle, tellWarnings } from "./words.js";

const REST_MS = 300; // without a change before the spread is computed: it is hundreds of searches
const QUICK = { max_samples: 256, method: "direct", half_width: 0.5 }; // the fewest samples that the service takes
const USUAL = "when speed, strength, density, mass and angle of attack scatter as is usual";

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
    this.askAngle = latest((values, signal) => this.#showAngle(values, signal), onError);
    const showSpread = (wanted, signal) => this.#showSpread(wanted, signal);
    this.askSpread = latest(showSpread, onError, { supersede: true, restMs: REST_MS });
  }

  /** Show the answer to a case. */
  setCase(values) {
    this.#values = values;
    if (keyOf(values) !== this.#key) {
      markStale(this.angle, this.warnings, this.spread);
      this.askSpread.cancel();
    }
    this.askAngle(values);
  }

  /** Tell whether the angle that is shown is that of a case. */
  isOf(values) {
    return keyOf(values) === this.#key;
  }

  /** Show none, as a field is not accepted. */
  clear() {
    this.askAngle.cancel();
    this.askSpread.cancel();
    this.#key = undefined;
    clearParts(this.angle, this.warnings, this.spread);
  }

  /** Show the range under other laws too, if the answer is of this case. */
  setAlternatives(found, values) {
    if (keyOf(values) === this.#key) this.angle.replaceChildren(tellAngle(found));
  }

  stop() {
    this.askAngle.stop();
    this.askSpread.stop();
  }

  async #showAngle(values, signal) {
    const key = keyOf(values);
    if (key === this.#key && !this.angle.hasAttribute("aria-busy")) return this.onAngle(this.found, values); // at another angle
    const found = (await ask("cra", { body: angleRequest(values), signal })).data;
    if (signal.aborted) return;
    this.angle.replaceChildren(tellAngle(found));
    this.warnings.replaceChildren(...tellWarnings(found.warnings));
    this.#key = key;
    this.found = found;
    if (this.askAngle.isBehind()) return;
    markFresh(this.angle, this.warnings);
    this.onAngle(found, values);
    if (found.critical_angle_deg === undefined) {
      this.spread.replaceChildren();
      markFresh(this.spread);
    } else this.askSpread({ values, sampling: QUICK });
  }

  async #showSpread({ values, sampling }, signal) {
    const known = knownStudy(values);
    const numbers = usualInputs().filter(({ type }) => type !== "discrete");
    const uncertain = numbers.map((input) => uncertainInput(input, values));
    const body = { ...angleRequest(values), uncertain, sensitivity: false, sampling };
    const study = known ?? (await ask("cra/uncertainty", { body, signal })).data;
    if (signal.aborted) return;
    this.spread.replaceChildren(...tellSpread(study, known, () => this.#refine()), howSure(values));
    markFresh(this.spread);
  }

  #refine() {
    markStale(this.spread);
    this.askSpread({ values: this.#values, sampling: {} });
  }
}

/** Return what a spread is in words: the 90 % range, its half width, and a button for a narrower one. */
function tellSpread(study, known, refine) {
  const [low, high] = [0.05, 0.95].map((level) => quantileOf(study, level));
  if (low === undefined) return [element("p", {}, "No sample has a critical angle.")];
  if (known) return [element("p", {}, "Spread ", element("strong", {}, headline(study)), ", the median and the 90 % range.")];
  const without = study.critical_angle.share_without_angle.value;
  const none = without > 0 ? `, ${digits(100 * without, 2)} % without an angle` : "";
  const by = study.method === "surrogate" ? "a polynomial chaos" : `${study.samples.toLocaleString("en")} searches`;
  const words = element(
    "p",
    {},
    "Spread ",
    element("strong", {}, `${degreesShown(low)} to ${degreesShown(high)}`),
    `, the 90 % range, ${USUAL} (by ${by}${none}).`,
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
