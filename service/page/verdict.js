// The verdict on a case: what happens at its oblique angle, how probable that is, the critical angle with its range, and the range
// over the theories on one strip with the angle of the case.

import { address, caseQuery } from "./address.js";
import { requestAngles } from "./alternatives.js";
import { angleRequest } from "./case.js";
import { element, svg } from "./elements.js";
import { latest } from "./latest.js";
import { requestEnd } from "./run.js";
import { QUICK, inputField, uncertainInput, usualInputs } from "./scatter.js";
import { request } from "./service.js";
import { clearParts, markFresh, markStale } from "./stale.js";
import { knownStudy, probabilityAt, quantileOf } from "./study.js";
import { degreesShown, describeAngle, digits, lengthShown, outcomeShown, quantityShown, warningList } from "./words.js";

const REST_MS = 300; // without a change before the spread and the theories are computed: they are hundreds of searches
const STRIP = { height: 40, edge: 14, margin_deg: 4 };

/**
 * Return the verdict on a strike in words. What is not known yet is undefined.
 *
 * @param {{values: object, run?: object, found: object, study?: object}} known the answers to `/trajectory`, `/cra` and
 *   `/cra/uncertainty` for a case
 * @returns {{sentence: string, figures: {name: string, value: string, note: string, kind?: string}[]}}
 */
export function verdictOf({ values, run, found, study }) {
  const mine = `${values.impact.oblique_angle_deg}°`;
  const angle = found.critical_angle_deg;
  const what = run && `At ${mine} the projectile ${ENDS[run.outcome]}`;
  const begins = angle === undefined ? describeAngle(found) : `the critical angle is ${degreesShown(angle)}.`;
  const [low, high] = study ? [0.05, 0.95].map((level) => quantileOf(study, level)) : [];
  const probability = study && probabilityAt(study, values.impact.oblique_angle_deg);
  return {
    sentence: what ? `${what}${angle === undefined ? `. ${begins}` : `; ${begins}`}` : "Computing ...",
    figures: [
      { name: `Outcome at ${mine}`, value: run ? capital(outcomeShown(run.outcome)) : "...", note: run ? endOf(run) : "" },
      {
        name: "Probability of ricochet",
        value: probability ? percent(probability.value) : angle === undefined ? "–" : "...",
        note: probability ? `sampling error ± ${percent(probability.error)}` : "",
      },
      {
        name: "Critical angle",
        value: angle === undefined ? "none" : degreesShown(angle),
        note: low === undefined ? "" : `90 % range ${low.toFixed(1)}° to ${high.toFixed(1)}°`,
        kind: angle === undefined ? undefined : "angle",
      },
    ],
  };
}

const ENDS = {
  ricochet: "is turned away",
  embedded: "digs in and stays",
  in_motion: "still moves when the run is given up",
  perforated: "goes through: the wall is perforated",
};

/** Put a verdict into an element: a sentence and its figures. */
export function showCard(root, { sentence, figures }, outcome) {
  root.replaceChildren(
    element("p.outcome", { "data-outcome": outcome }, element("strong", {}, sentence)),
    element(
      "dl.figures",
      {},
      ...figures.map(({ name, value, note, kind }) =>
        element("div", {}, element("dt", {}, name), element("dd", {}, element(kind ? `strong.${kind}` : "strong", {}, value), element("span.note", {}, note))),
      ),
    ),
  );
}

/** The panel with the verdict. */
export class Verdict {
  #key; // of the case whose angle is shown
  #values;
  #run; // of the case at its oblique angle
  #study;
  #others; // the answer with its alternatives

  /**
   * @param {{onError: (error: Error) => void, onAngle?: (found: object, values: object) => void, hasRun?: boolean, hasStudy?: boolean}} options
   *   `onAngle` is called with the answer of `/cra` for the inputs shown, whenever these change; with `hasRun` the view computes the
   *   run and gives it to `setRun`, with `hasStudy` the study and gives it to `setStudy`
   */
  constructor({ onError, onAngle = () => {}, hasRun = false, hasStudy = false }) {
    Object.assign(this, { onAngle, hasRun, hasStudy });
    this.card = element("div", {}, element("p.quiet", {}, "Computing ..."));
    this.strip = element("div.strip");
    this.spread = element("div", { role: "group", "aria-label": "Spread" });
    this.link = element("a", {}, "How sure, input by input");
    const about = element("details", {}, element("summary", {}, "What the range stands for"), this.spread);
    this.warnings = element("div", {});
    this.root = element("section.panel.across.verdict", { "aria-label": "Verdict" }, this.card, this.strip, element("div.spread", {}, about, this.link), this.warnings);
    this.updateAngle = latest((values, signal) => this.#showAngle(values, signal), onError);
    this.updateSpread = latest((wanted, signal) => this.#showSpread(wanted, signal), onError, { supersede: true, restMs: REST_MS });
  }

  /** Show the verdict on a case. */
  setCase(values) {
    this.#values = values;
    this.#run = undefined;
    this.link.hidden = this.hasStudy;
    this.link.setAttribute("href", address("how-sure", caseQuery(values)));
    markStale(this.card, this.warnings, this.strip);
    if (!this.isOf(values)) {
      markStale(this.spread);
      this.updateSpread.cancel();
    }
    this.updateAngle(values);
  }

  /** Return whether the angle that is shown is that of a case. */
  isOf(values) {
    return keyOf(values) === this.#key;
  }

  /** Take the run of the case, which the view has computed. */
  setRun(run) {
    if (run.values !== this.#values) return;
    this.#run = run;
    if (this.isOf(run.values)) this.#show();
  }

  /** Take the study of the case, which the view has computed, or none. */
  setStudy(study, values) {
    if (!this.isOf(values)) return;
    this.#study = study;
    this.#show();
  }

  /** Show that the inputs are about to change. */
  hold() {
    this.updateAngle.cancel();
    this.updateSpread.cancel();
    this.#key = undefined;
    markStale(this.card, this.warnings, this.strip, this.spread);
  }

  /** Show none, as a field is not accepted. */
  clear() {
    this.hold();
    clearParts(this.card, this.warnings, this.strip, this.spread);
  }

  stop() {
    this.updateAngle.stop();
    this.updateSpread.stop();
  }

  async #showAngle(values, signal) {
    const isKnown = this.isOf(values);
    const [found, run] = await Promise.all([
      isKnown ? this.found : request("cra", { body: angleRequest(values), signal }).then(({ data }) => data),
      this.hasRun ? undefined : requestEnd(values, signal),
    ]);
    if (signal.aborted) return;
    if (!isKnown) [this.#study, this.#others] = [undefined, undefined];
    this.found = found;
    this.#key = keyOf(values);
    this.#run = run ?? this.#run;
    if (this.updateAngle.isBehind()) return;
    this.#show();
    this.onAngle(found, values);
    if (!isKnown || !this.#others) this.updateSpread({ values, sampling: QUICK });
  }

  #show() {
    const [values, run] = [this.#values, this.#run];
    if (!run || !this.isOf(values)) return;
    showCard(this.card, verdictOf({ values, run, found: this.found, study: this.#study }), run.outcome);
    this.warnings.replaceChildren(...warningList(run.warnings, this.found.warnings));
    this.#showStrip();
    markFresh(this.card, this.warnings, this.strip);
  }

  #showStrip() {
    const angles = (this.#others?.alternatives ?? []).map((each) => each.critical_angle_deg).filter((angle) => angle !== undefined);
    const ends = this.#study ? [0.05, 0.95].map((level) => quantileOf(this.#study, level)) : [];
    const mine = this.#values.impact.oblique_angle_deg;
    this.strip.replaceChildren(stripOf(mine, this.found.critical_angle_deg, angles, ends[0] === undefined ? [] : ends, this.strip.clientWidth));
  }

  async #showSpread({ values, sampling }, signal) {
    const inputs = usualInputs(values);
    const uncertain = inputs.map((input) => uncertainInput(input, values));
    const body = { ...angleRequest(values), uncertain, sensitivity: false, sampling };
    const isThere = this.found.critical_angle_deg !== undefined && !this.hasStudy;
    const [others, study] = await Promise.all([
      this.#others ?? requestAngles(values, signal),
      isThere ? (knownStudy(values, inputs) ?? request("cra/uncertainty", { body, signal }).then(({ data }) => data)) : undefined,
    ]);
    if (signal.aborted) return;
    this.#others = others;
    this.#study = study ?? (this.hasStudy ? this.#study : undefined);
    this.spread.replaceChildren(...describeSpread(this.#study, this.found, others, inputs, () => this.#refine()));
    markFresh(this.spread);
    this.#show();
  }

  #refine() {
    markStale(this.spread);
    this.updateSpread({ values: this.#values, sampling: {} });
  }
}

/** Return where a run has ended in a few words. */
function endOf({ outcome, final, exit, maximum_depth_m: depth }) {
  if (outcome === "perforated") return `goes on at ${quantityShown(exit?.speed_m_s ?? final.depth_velocity_m_s, "m/s")}`;
  if (exit) return `at ${quantityShown(exit.speed_m_s, "m/s")}, ${digits(exit.elevation_deg)}° from the face`;
  return `${lengthShown(depth)} deep after ${digits(final.time_s * 1e3)} ms`;
}

/** Return what the range stands for in words, with a button for a narrower one. */
function describeSpread(study, found, { alternatives }, inputs, refine) {
  const angles = alternatives.map((each) => each.critical_angle_deg).filter((angle) => angle !== undefined);
  const none = alternatives.length - angles.length;
  const range = angles.length ? `${degreesShown(Math.min(...angles))} to ${degreesShown(Math.max(...angles))}` : "no critical angle";
  const theories = `${found.critical_angle_deg === undefined ? "" : `${describeAngle(found)} `}Theories: ${range}${none && angles.length ? `, none in ${none} of ${alternatives.length}` : ""}.`;
  if (!study) return [theories];
  const names = inputs.map(({ field }) => inputField(field).label.toLowerCase()).join(", ");
  const without = study.critical_angle?.share_without_angle.value ?? 0;
  const by = `${study.method === "surrogate" ? "polynomials fitted to " : ""}${study.samples.toLocaleString("en")} searches`;
  const words = `${theories} 90 % range: usual scatter of ${names} (${by}${without ? `, ${percent(without)} without an angle` : ""}).`;
  const isQuick = study.samples === QUICK.max_samples && study.method === "direct";
  return [words, ...(isQuick ? [" ", element("button", { type: "button", onclick: refine }, "Refine the spread")] : [])];
}

/** A strip of angles: the theories as strokes on their range, the 90 % range as a band, the angle of the case as a pointer. */
function stripOf(mine, critical, theories, range, width) {
  const all = [mine, critical, ...theories, ...range].filter((angle) => angle !== undefined);
  const least = Math.max(Math.floor((Math.min(...all) - STRIP.margin_deg) / 5) * 5, 0);
  const most = Math.min(Math.ceil((Math.max(...all) + STRIP.margin_deg) / 5) * 5, 90);
  const [size, { height, edge }] = [Math.max(width, 280), STRIP];
  const at = (angle) => edge + ((angle - least) / (most - least)) * (size - 2 * edge);
  const bar = ([low, high], name, y, thickness) => svg("rect", { class: name, x: at(low), y, width: Math.max(at(high) - at(low), 1), height: thickness });
  const step = most - least > 40 ? 10 : 5;
  const ticks = Array.from({ length: Math.floor((most - least) / step) + 1 }, (_, i) => Math.ceil(least / step) * step + i * step).filter((angle) => angle <= most);
  const ends = theories.length ? [Math.min(...theories), Math.max(...theories)] : [];
  const words = [
    `Your angle ${mine}°`,
    critical === undefined ? "no critical angle" : `critical angle ${degreesShown(critical)}`,
    ends.length ? `theories ${ends.map(degreesShown).join(" to ")}` : "",
    range.length ? `90 % range ${range.map((angle) => `${angle.toFixed(1)}°`).join(" to ")}` : "",
  ];
  const toRight = at(mine) > size - 70;
  return svg(
    "svg",
    { viewBox: `0 0 ${size} ${height}`, role: "img", "aria-label": `${words.filter(Boolean).join(", ")}.` },
    svg("line", { class: "axis", x1: edge, x2: size - edge, y1: 22, y2: 22 }),
    ...ticks.map((angle) => svg("text", { x: at(angle), y: height - 3, "text-anchor": "middle" }, `${angle}°`)),
    ...(range.length ? [bar(range, "band", 15, 14)] : []),
    ...(ends.length ? [bar(ends, "theories", 20, 4)] : []),
    ...theories.map((angle) => svg("line", { class: "theory", x1: at(angle), x2: at(angle), y1: 17, y2: 27 })),
    ...(critical === undefined ? [] : [svg("line", { class: "critical", x1: at(critical), x2: at(critical), y1: 13, y2: 30 })]),
    svg("path", { class: "mine", d: `M${at(mine) - 6} 4h12l-6 12z` }),
    svg("text", { class: "mine", x: at(mine) + (toRight ? -9 : 9), y: 12, "text-anchor": toRight ? "end" : "start" }, `${mine}°`),
  );
}

function percent(share) {
  const value = 100 * share;
  return `${value > 0 && value < 10 ? digits(value, 2) : value.toFixed(0)} %`;
}

function capital(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** Return what a critical angle depends on, as text. */
function keyOf(values) {
  return JSON.stringify(angleRequest(values));
}
