// The verdict on a case: the sentences of the service with the outcome, its probability and the critical angle, and a strip with the
// oblique angle of the case, the critical angles of the theories and the 90 % range.

import { address, caseQuery } from "./address.js";
import { angleRequest, valueAt, withValue } from "./case.js";
import { names } from "./contract.js";
import { element, showText, svg, table } from "./elements.js";
import { latest } from "./latest.js";
import { reportRequest } from "./report.js";
import { clipped, requestEnd } from "./run.js";
import { inputField, takeUsual } from "./scatter.js";
import { request } from "./service.js";
import { clearParts, markFresh, markStale } from "./stale.js";
import { inUnits } from "./units.js";
import { capital, degreesShown, describeAngle, digits, endingShown, lengthShown, quantityShown, statusShown, warningList, withInterval } from "./words.js";

const REST_MS = 300; // pause without a change before the spread and the theories are computed, which takes hundreds of searches
const MOST_WITHOUT = 0.1; // share of samples without a critical angle up to which the service names the range without "of the others"
const STRENGTH = "resistance.strength_factor";
const STRIP = { edge: 14, margin_deg: 4, row: 13, rows: 2 }; // lengths in px, the margin in °; `rows` is the least number of rows of labels

/**
 * Return the verdict on a strike: the deciding sentence, the sentences that explain it, and the design values of a wall.
 *
 * Together they are the `sentence` of the service; until that arrives, `first` says how the strike ends, and that a wall is not judged yet.
 *
 * @param {{values: object, run: object, found: object, judged?: object, failure?: string}} known the answers to `/trajectory`, `/cra` and
 *   `/verdict` for a case; `judged` may be for another oblique angle, which does not change its range; `failure` is the reason why
 *   there is no answer to `/verdict`
 * @returns {{first: string, second: string, end: string, design: string, angle?: string, line: string}} `angle` is the critical angle as
 *   written in `second`, `end` says where the strike ends with the inputs as given, and `line` is a summary in one line
 */
function verdictOf({ values, run, found, judged, failure }) {
  const mine = `${clipped(values).impact.oblique_angle_deg}°`; // angle of the strike that is computed; if it was clipped, a warning says so
  const angle = found.critical_angle_deg && degreesShown(found.critical_angle_deg, decimalsOf(judged));
  const range = judged?.range_text ? `, ${rangeShown(judged)}` : "";
  const isJudged = judged?.oblique_angle_deg === values.impact.oblique_angle_deg;
  const probability = isJudged && judged.probability_text ? ` (${run.outcome === "ricochet" ? "" : "ricochet "}${judged.probability_text})` : "";
  const [ending, critical] = [endingShown(run), angle ? `critical angle ${angle}` : "no critical angle"];
  const subject = values.target.thickness_m === undefined ? "the strike" : "the wall";
  const unjudged = failure ? `; ${subject} could not be judged: ${failure.replace(/\.$/, "")}` : subject === "the wall" ? "; the wall is not judged yet" : "";
  const pending = `At ${mine} from the normal, with the inputs as given: ${ending}${unjudged}. ${capital(critical)}${range}.`;
  const [strike, design = ""] = (isJudged ? judged.sentence : pending).split(/ (?=(?:Design|No design) value)/);
  const [first, ...others] = sentencesOf(strike);
  const wall = /^(The w|W)all /.test(first) ? `${first.replace(/ of .* from the normal:/, "").split(/[.:;]/)[0]}; ` : "";
  const line = `${capital(`${wall}${ending}`)} at ${mine}${isJudged ? probability : unjudged}, ${critical}`;
  const end = isJudged && range && judged.probability_text === undefined ? `${mine} is not in the range searched. ${endOf(run)}` : endOf(run);
  return { first, second: others.join(" "), end, design, angle, line };
}

/** Split a text into sentences, which end with a full stop before a capital letter. */
export const sentencesOf = (text) => text.split(/(?<=\.) (?=[A-Z])/);

/** Show a verdict in an element: the deciding sentence, and the sentences that explain it. */
export function showCard(root, { first, second, end = "", angle, line = "" }, outcome) {
  const [before, ...after] = second.split(angle);
  const rest = after.length ? [before, element("strong.angle", {}, angle), after.join(angle)] : [before];
  const parts = [element("span.line", {}, line), element("strong", {}, first), " ", element("span.rest", {}, ...rest), " ", element("span.end", {}, end)];
  root.replaceChildren(element("p.outcome.figures", { "data-outcome": outcome }, ...parts));
  showText(root.closest(".verdict").querySelector(".sticky"), line);
}

/** Return the section of a verdict: its first part stays at the upper edge of the window or, if that is narrow, its summary in one line. */
export function verdictSection(head, ...others) {
  const setHeight = () => document.documentElement.style.setProperty("--verdict", `${head.offsetHeight}px`);
  new ResizeObserver(setHeight).observe(head);
  return element("section.verdict", { "aria-label": "Verdict" }, head, element("p.sticky", { "aria-hidden": "true" }), ...others);
}

/** The panel with the verdict. */
export class Verdict {
  #key; // `keyOf` the case whose angle is shown
  #values;
  #run; // of the case at its oblique angle
  #judged; // the answer to `/verdict`, perhaps for another oblique angle
  #failure; // the reason why there is no answer to `/verdict`

  /**
   * @param {{onError: (error: Error) => void, onAngle?: (found: object, values: object) => void, onJudged?: (judged: object) => void, hasRun?: boolean, isLine?: boolean}} options
   *   `onAngle` is called with the answer of `/cra` whenever the inputs shown change, `onJudged` with the answer of `/verdict` once
   *   scatter.js has its usual scatter; with `hasRun` the view computes the run and passes it to `setRun`; with `isLine` the verdict
   *   is one line that expands
   */
  constructor({ onError, onAngle = () => {}, onJudged = () => {}, hasRun = false, isLine = false }) {
    Object.assign(this, { onAngle, onJudged, hasRun });
    this.card = element("div", {}, element("p.quiet", {}, "Computing ..."));
    this.strip = element("div.strip");
    this.design = element("p");
    this.spread = element("div", { role: "group", "aria-label": "Spread" });
    this.fit = element("div", { role: "group", "aria-label": "Own depth tests" });
    this.link = element("a", {}, "How sure, input by input");
    this.own = element("a", {}, "Enter own shots");
    this.about = element("details", {}, element("summary", {}, "What the range stands for"), this.spread);
    this.warnings = element("div", {});
    const notes = [this.design, element("div.spread", {}, this.about, this.own, this.link), this.fit, this.warnings];
    this.parts = isLine
      ? [element("details.panel.head", { ontoggle: () => this.#show() }, element("summary", {}, this.card), this.strip, ...notes)]
      : [element("div.panel.across.head", {}, this.card, this.strip), element("div.panel.across.notes", {}, ...notes)];
    this.root = verdictSection(...this.parts);
    this.updateAngle = latest((values, signal) => this.#showAngle(values, signal), onError);
    this.updateJudged = latest((values, signal) => this.#judge(values, signal), onError, { supersede: true, restMs: REST_MS });
  }

  /** Show the verdict on a case. */
  setCase(values) {
    this.#values = values;
    this.#run = this.#failure = undefined;
    this.linkTo(values);
    markStale(this.card, this.warnings, this.strip, this.design);
    this.updateJudged.cancel();
    if (!this.isOf(values)) markStale(this.spread, this.fit);
    this.updateAngle(values);
  }

  /** Let the links lead to other views of a case. */
  linkTo(values) {
    this.link.setAttribute("href", address("how-sure", caseQuery(values)));
    this.own.setAttribute("href", address("explore", new URLSearchParams([...caseQuery(values), ["enter", "shots"]])));
  }

  /** Return whether the critical angle shown belongs to a case. */
  isOf(values) {
    return keyOf(values) === this.#key;
  }

  /** Accept the run of the case from the view, which has computed it. */
  setRun(run) {
    if (run.values !== this.#values) return;
    this.#run = run;
    if (this.isOf(run.values)) this.#show();
  }

  /** Mark the verdict as out of date, because the inputs are being changed. */
  hold() {
    this.updateAngle.cancel();
    this.updateJudged.cancel();
    this.#key = undefined;
    markStale(this.card, this.warnings, this.strip, this.design, this.spread, this.fit);
  }

  /** Remove the verdict, because a field is not accepted. */
  clear() {
    this.hold();
    const others = [this.warnings, this.strip, this.design, this.spread, this.fit];
    for (const part of others) part.replaceChildren();
    markFresh(...others);
    clearParts(this.card); // the message is needed only once
  }

  /** Fix the current height, or release it, so that a picture below does not move under a pointer that drags in it. */
  keepHeight(isKept) {
    for (const part of this.parts) Object.assign(part.style, isKept ? { height: `${part.offsetHeight}px`, overflow: "clip" } : { height: "", overflow: "" });
  }

  stop() {
    this.updateAngle.stop();
    this.updateJudged.stop();
  }

  async #showAngle(values, signal) {
    const isKnown = this.isOf(values);
    const [found, run] = await Promise.all([
      isKnown ? this.found : request("cra", { body: inUnits(angleRequest(values)), signal }).then(({ data }) => data),
      this.hasRun ? undefined : requestEnd(values, signal),
    ]);
    if (signal.aborted) return;
    if (!isKnown) this.#judged = undefined;
    this.found = found;
    this.#key = keyOf(values);
    this.#run = run ?? this.#run;
    if (this.updateAngle.isBehind()) return;
    this.#show();
    this.onAngle(found, values);
    this.updateJudged(values);
  }

  async #judge(values, signal) {
    const judge = async (given) => (await request("verdict", { body: inUnits(reportRequest(clipped(given))), signal })).data;
    const data = await judge(values).catch((error) => {
      if (signal.aborted) throw error;
      this.#failure = error.message;
      this.#show();
      throw error;
    });
    if (signal.aborted) return;
    this.#failure = undefined;
    this.#judged = { ...data, oblique_angle_deg: values.impact.oblique_angle_deg };
    takeUsual(data.usual_scatter);
    this.onJudged(data);
    this.#show();
    const law = valueAt(values, STRENGTH);
    if (!law?.shots) return;
    const before = await judge(withValue(values, STRENGTH, { ...law, model: "published_tests", shots: undefined }));
    if (signal.aborted) return;
    this.#judged.before = before;
    this.#show();
  }

  /**
   * Return the warnings of the search and of the verdict to show beside those of the run: standing notes, and warnings whose codes
   * the run does not have. Such warnings of the search get the prefix "at the critical angle".
   */
  #warningsBeside(run) {
    const own = new Set(run.warnings.map(({ code }) => code));
    const searched = new Set(this.found.warnings.map(({ detail }) => detail));
    const others = [...this.found.warnings, ...(this.#judged?.warnings ?? [])].filter(({ code, standing }) => standing || !own.has(code));
    return others.map((each) => (each.standing || !searched.has(each.detail) ? each : { ...each, detail: `at the critical angle: ${each.detail}` }));
  }

  #show() {
    const [values, run] = [this.#values, this.#run];
    if (!run || !this.isOf(values)) return;
    const verdict = verdictOf({ values, run, found: this.found, judged: this.#judged, failure: this.#failure });
    showCard(this.card, verdict, run.outcome);
    showText(this.design, verdict.design);
    this.fit.replaceChildren(...(this.#judged?.own_tests ? [changesOf(this.#judged)] : []));
    showText(this.spread, [describeAngle(this.found, decimalsOf(this.#judged)), this.#judged ? describeRange(this.#judged) : ""].join(" "));
    this.warnings.replaceChildren(...warningList(run.warnings, this.#warningsBeside(run)));
    // The strip must not show several critical angles for a law of the user's own, so there the theories appear only in the text.
    const theories = (this.#judged?.own_law ? [] : this.#judged?.theories ?? []).filter((each) => each.critical_angle_deg !== undefined);
    const { oblique_angle_deg: mine } = values.impact;
    this.strip.replaceChildren(stripOf(mine, this.found.critical_angle_deg, theories, this.#judged, this.strip.clientWidth));
    markFresh(this.card, this.strip, this.design, this.fit);
    // Until the verdict arrives, a warning may turn out to be a standing note.
    if (this.#judged?.oblique_angle_deg === mine || this.#failure) markFresh(this.warnings, this.spread);
  }
}

/** Return the decimals of a critical angle, as in the sentences of a verdict: one more than its range has, or 1 without a range. */
const decimalsOf = (judged) => judged?.range_text?.includes(".") ? 2 : 1;

/** Return the name of the range, and whether it stands only for the samples with a critical angle, as in the sentences of a verdict. */
const isOfOthers = ({ share_without_angle: without }) => without > MOST_WITHOUT;
const rangeName = (judged) => `90 % range${isOfOthers(judged) ? " of the others" : ""}`;

/** Return a range of a verdict with its name, after the share of the samples without a critical angle if it stands only for the others. */
const rangeShown = (judged, text = judged.range_text) =>
  `${isOfOthers(judged) ? `${percent(judged.share_without_angle)} of the samples without one, ` : ""}${rangeName(judged)} ${text}`;

/** Describe in a sentence where a run ended. */
function endOf({ outcome, final, exit, maximum_depth_m: depth }) {
  const given = "With the inputs as given it";
  if (outcome === "perforated") return `${given} continues at ${quantityShown(exit?.speed_m_s ?? final.depth_velocity_m_s, "m/s")}.`;
  if (exit) return `${given} leaves at ${quantityShown(exit.speed_m_s, "m/s")}, ${quantityShown(exit.elevation_deg, "°")} from the face.`;
  const after = `after ${digits(final.time_s * 1e3)} ms, at most ${lengthShown(depth)} deep.`;
  return `${given} ${outcome === "embedded" ? "stops" : "is in motion"} ${after}`;
}

/** Explain in words what the range covers. */
function describeRange(judged) {
  const { usual_scatter: scatter, strength_factor_dispersion: dispersion, theories, share_without_angle: without, theory_range: range } = judged;
  const inputs = scatter.map(({ field }) => inputField(field).label.toLowerCase()).join(", ");
  const decays = names.choices["resistance.free_surface.model"];
  const by = theories.map(({ free_surface: name, weight, critical_angle_deg: angle }) => {
    return `${decays[name]} (weight ${weight}) ${angle === undefined ? "none" : degreesShown(angle, decimalsOf(judged))}`;
  });
  return [
    without ? `${percent(without)} of the samples have no critical angle.` : "",
    `${rangeName(judged)}: usual scatter of ${inputs}; S scatters by ${percent(dispersion)}.`,
    judged.own_law ? "It is for the law chosen." : "",
    by.length ? `Theories, each with its own S over the angle and with the other inputs at their medians: ${by.join(", ")}${range ? `, their 90 % range ${range.lower_deg.toFixed(1)}° to ${range.upper_deg.toFixed(1)}°` : ""}.` : "",
  ].filter(Boolean).join(" ");
}

/** Draw a strip of angles: the theories as strokes, the 90 % range as a band and the angle of the case as a pointer, each with a label. */
function stripOf(mine, critical, theories, judged, width) {
  const shown = (angle) => degreesShown(angle, decimalsOf(judged));
  const range = judged?.range ? [judged.range.lower_deg, judged.range.upper_deg] : [];
  const ends = theories.map((each) => each.critical_angle_deg).sort((a, b) => a - b);
  const all = [mine, critical, ...ends, ...range].filter((angle) => angle !== undefined);
  const least = Math.max(Math.floor((Math.min(...all) - STRIP.margin_deg) / 5) * 5, 0);
  const most = Math.min(Math.ceil((Math.max(...all) + STRIP.margin_deg) / 5) * 5, 90);
  const [size, edge] = [Math.max(width, 280), STRIP.edge];
  const at = (angle) => edge + ((angle - least) / (most - least)) * (size - 2 * edge);
  const step = most - least > 40 ? 10 : 5;
  const ticks = Array.from({ length: Math.floor((most - least) / step) + 1 }, (_, i) => Math.ceil(least / step) * step + i * step).filter((angle) => angle <= most);
  const words = [
    `Your angle ${mine}°`,
    critical === undefined ? "no critical angle" : `critical angle ${shown(critical)}`,
    ends.length ? `theories ${[ends[0], ends.at(-1)].map(shown).join(" to ")}` : "",
    range.length ? rangeShown(judged, range.map((angle) => `${angle.toFixed(1)}°`).join(" to ")) : "",
  ];
  const decays = names.choices["resistance.free_surface.model"];
  const isCritical = (each) => shown(each.critical_angle_deg) === (critical !== undefined && shown(critical));
  const marks = [
    { angle: mine, name: "mine", text: `your angle ${mine}°` },
    { angle: critical, name: "critical", text: ["critical angle", ...theories.filter(isCritical).map((each) => decays[each.free_surface])].join(", ") },
    ...theories.filter((each) => !isCritical(each)).map((each) => ({ angle: each.critical_angle_deg, name: "theory", text: `${decays[each.free_surface]} ${shown(each.critical_angle_deg)} with its S` })),
    { angle: range[1], name: "band", text: judged && rangeName(judged) },
  ].filter(({ angle }) => angle !== undefined);
  const pen = document.createElement("canvas").getContext("2d");
  const widthOf = ({ name, text }) => {
    pen.font = `${name === "mine" ? 600 : 400} 11px ${getComputedStyle(document.body).fontFamily}`;
    return pen.measureText(text).width;
  };
  const rows = inRows(marks.map((mark) => ({ x: at(mark.angle), length: widthOf(mark) })), size);
  const top = STRIP.row * Math.max(STRIP.rows, ...rows.map(({ row }) => row + 1)); // the lower end of the labels
  const stroke = ({ angle, name }, begin, end) => svg("line", { class: name, x1: at(angle), x2: at(angle), y1: begin, y2: end });
  const band = range.length ? [svg("rect", { class: "band", x: at(range[0]), y: top + 10, width: Math.max(at(range[1]) - at(range[0]), 1), height: 14 })] : [];
  return svg(
    "svg",
    { viewBox: `0 0 ${size} ${top + 40}`, role: "img", "aria-label": `${words.filter(Boolean).join(", ")}.` },
    ...band,
    svg("line", { class: "axis", x1: edge, x2: size - edge, y1: top + 17, y2: top + 17 }),
    ...ticks.map((angle) => svg("text", { x: at(angle), y: top + 37, "text-anchor": "middle" }, `${angle}°`)),
    ...marks.map(({ angle }, i) => stroke({ angle, name: "leader" }, top - STRIP.row * rows[i].row, top + 10)),
    ...marks.filter(({ name }) => ["theory", "critical"].includes(name)).map((each) => stroke(each, top + 8, top + 26)),
    ...marks.map(({ name, text }, i) => svg("text", { class: name, x: rows[i].left, y: top - 3 - STRIP.row * rows[i].row }, text)),
    svg("path", { class: "mine", d: `M${at(mine) - 6} ${top + 1}h12l-6 12z` }),
  );
}

/**
 * Place labels whose leaders run down at `x`. Labels left of a cut end at their leader, the others begin there, and each is in a row above
 * all labels that it would touch, so that no leader crosses a label. A label that is moved into the picture may cover leaders beside its
 * own, so such labels may be placed last, above the others. The best placing has no crossings, the smallest moves and the fewest rows.
 */
function inRows(labels, size) {
  const order = [...labels.keys()].sort((one, other) => labels[one].x - labels[other].x);
  const placings = [...order, undefined].flatMap((_, cut) => [0, 1].map((isLast) => {
    const wanted = labels.map(({ x, length }, i) => (order.indexOf(i) < cut ? x - length - 2 : x + 2));
    const lefts = labels.map(({ length }, i) => Math.min(Math.max(wanted[i], 0), size - length));
    const moved = (i) => Math.abs(lefts[i] - wanted[i]);
    const placed = [];
    for (const i of [...order.slice(0, cut), ...order.slice(cut).reverse()].sort((one, other) => isLast * (moved(one) - moved(other)))) {
      const [left, { length }] = [lefts[i], labels[i]];
      const met = placed.filter((other) => left < other.left + other.length + 8 && other.left < left + length + 8);
      placed[i] = { left, length, row: 1 + Math.max(-1, ...met.map(({ row }) => row)) };
    }
    const isCrossed = (i) => placed.some(({ left, length, row }) => row < placed[i].row && left < labels[i].x && labels[i].x < left + length);
    return { placed, cost: Math.max(...order.map((i) => placed[i].row + moved(i) + (isCrossed(i) ? size : 0))) };
  }));
  return placings.reduce((best, each) => (each.cost < best.cost ? each : best)).placed;
}

/** Return a table of what the user's own tests change: S at normal impact and, once `before` is known, the verdict. */
function changesOf({ before, ...judged }) {
  const { own_tests: tests, oblique_angle_deg: mine } = judged;
  const angleOf = ({ critical_angle_deg: angle, status }) => (angle === undefined ? statusShown(status) : degreesShown(angle, decimalsOf(judged)));
  const row = (head, textOf) => [head, ...[before, judged].map((each) => textOf(each) ?? "not known")];
  const rows = [["S at 0°", withInterval(tests.prior_median, ...tests.prior_spread, digits), withInterval(tests.median, ...tests.spread, digits)]];
  const rangeOf = (each) => each.range_text && rangeShown(each).replace(/90 % range /, "");
  if (before) rows.push(row("Critical angle", angleOf), row("90 % range", rangeOf), row(`Ricochet at ${mine}°`, (each) => each.probability_text));
  const heads = ["", "Published tests", `With ${tests.shots} depth test${tests.shots === 1 ? "" : "s"}`];
  return table("table", { heads, rows, isNamed: true, label: "What your own tests change" });
}

function percent(share) {
  const value = 100 * share;
  return `${value > 0 && value < 10 ? digits(value, 2) : value.toFixed(0)} %`;
}

/** Return a text that identifies the inputs of a critical angle. */
const keyOf = (values) => JSON.stringify(angleRequest(values));
