// Explore: one strike, as its fields are changed.

import { address, caseOf, caseQuery, readAddress, readCase, replaceAddress } from "../address.js";
import { alternativesTable, requestAngles, requestOutcomes } from "../alternatives.js";
import { Answer, MODEL_FIELDS } from "../answer.js";
import { Compare, readPins, writePins } from "../compare.js";
import { copyButtons } from "../copy-as.js";
import { element } from "../elements.js";
import { buildFold } from "../fold.js";
import { buildForm } from "../form.js";
import { drawHistories, moveInstant } from "../histories.js";
import { latest } from "../latest.js";
import { lostNote, pause } from "../lost.js";
import { purge } from "../plots.js";
import { presetLinks } from "../presets.js";
import { reportButton } from "../report.js";
import { computeRun, rowAt } from "../run.js";
import { buildScrubber } from "../scrubber.js";
import { Problem } from "../service.js";
import { drawSideView, markCritical, moveOutline } from "../side-view.js";
import { clearParts, markFresh, markStale } from "../stale.js";
import { TurnHandle } from "../turn-handle.js";
import { describeRun, outcomeShown, warningList } from "../words.js";

const ANGLE_MS = 20; // between side view and histories, for an angle that has arrived to be shown
const ABOUT =
  "A rigid projectile strikes concrete at an oblique angle, measured from the normal, and is turned away above the critical " +
  "angle: first, move the slider of the oblique angle through the critical angle to see the outcome change.";

/** Show the view. */
export async function show(root, query) {
  const explore = new Explore(root, query);
  return () => explore.leave();
}

class Explore {
  changed = performance.now(); // when a field was

  constructor(root, query) {
    this.laws = buildFold("Under other laws", element("div.laws-table"), (...given) => this.showLaws(...given), (error) => this.fail(error));
    const fail = (error) => this.fail(error);
    this.answer = new Answer({ onError: fail, onAngle: (_, values) => this.showAngle(values) });
    this.compare = new Compare(readPins(query), { currentCase: () => this.form.currentCase(), onChange: () => this.changePins() });
    const parts = build(root, this.answer.root, this.compare.root, this.laws.root);
    this.parts = parts;
    this.instant = query.has("time_ms") ? Number(query.get("time_ms")) / 1e3 : Infinity; // the last unless chosen
    this.updatePicture = latest((values, signal) => this.showPicture(values, signal), fail);
    this.handle = new TurnHandle(parts.side, {
      onTurn: (angle) => this.form.setField("impact.oblique_angle_deg", angle),
      onHold: () => this.holdRoom(true),
      onRelease: () => {
        this.holdRoom(false);
        this.updatePicture(this.form.currentCase()); // the axes fit again
      },
    });
    this.scrubber = buildScrubber(parts.scrubber, (row) => this.showInstant(row));
    this.form = buildForm(parts.form, {
      case: readCase(query),
      open: matchMedia("(min-width: 60rem)").matches ? ["Strike", "Projectile", "Target", "Model"] : ["Strike"],
      beside: { root: this.answer.models, paths: MODEL_FIELDS },
      onChange: (values) => this.change(values),
      onRefuse: () => this.refuse(),
    });
    this.copy = copyButtons(this.form.currentCase);
    parts.copy.append(this.copy.root);
    parts.problem.before(element("p.actions", {}, this.compare.button, reportButton(this.form.currentCase, fail)));
    parts.presets.addEventListener("click", ({ target }) => this.keepPins(target));
    this.change(this.form.currentCase());
  }

  /** What belongs to this strike. */
  get ofStrike() {
    const { outcome, side, histories, warnings } = this.parts;
    return [outcome, side, histories, warnings, ...(this.compare.pinned.length ? [this.compare.table] : [])];
  }

  change(values) {
    this.changed = performance.now();
    this.copy.clear();
    this.parts.problem.textContent = "";
    markStale(...this.ofStrike, this.parts.scrubber);
    this.answer.setCase(values);
    this.updatePicture(values);
    this.laws.setCase(values);
    this.readdress();
  }

  /** Nothing belongs to a case with a field that is not accepted. */
  refuse() {
    this.parts.problem.textContent = "";
    this.updatePicture.cancel();
    this.answer.clear();
    this.laws.clear();
    clearParts(...this.ofStrike);
    this.parts.scrubber.hidden = true;
  }

  async showPicture(values, signal) {
    const { parts, changed: start } = this;
    const [run] = await Promise.all([computeRun(values, signal), this.compare.load(signal)]);
    const runs = this.compare.withRuns(run);
    this.run = run;
    this.row = rowAt(run, this.instant);
    this.scrubber.setTimes(run.history.time_s, this.row);
    parts.scrubber.hidden = false;
    parts.outcome.replaceChildren(...describeRun(run)); // the words do not wait for what draws
    this.showWarnings();
    this.showDifferences();
    this.handle.stay();
    if (!this.updatePicture.isBehind()) markFresh(parts.outcome, parts.warnings);
    const marked = { critical: this.criticalOf(values), turns: true, isHeld: this.handle.isHeld };
    if (!(await drawSideView(parts.side, runs, this.row, marked)) || signal.aborted) return;
    const critical = this.criticalOf(values);
    if (critical !== marked.critical) markCritical(parts.side, run, critical); // found while what draws was loaded
    this.handle.follow(run, outcomeShown(run.outcome));
    performance.measure("ricochet: side view", { start });
    if (this.updatePicture.isBehind()) return;
    markFresh(parts.side, parts.scrubber);
    await pause(ANGLE_MS, signal);
    if (this.updatePicture.isBehind()) return;
    await drawHistories(parts.histories, runs, this.row);
    if (signal.aborted || this.updatePicture.isBehind()) return;
    markFresh(parts.histories);
    performance.measure("ricochet: histories", { start });
    listen(parts, (row) => this.scrubber.move(row));
  }

  showAngle(values) {
    this.angleOf = values;
    if (this.run?.values === values) markCritical(this.parts.side, this.run, this.criticalOf(values)); // else it is drawn with it
    this.showWarnings();
    this.showDifferences();
  }

  /** Keep what is above the side view from shrinking. */
  holdRoom(isHeld) {
    const panel = this.parts.outcome.parentElement;
    panel.style.minHeight = isHeld ? `${panel.offsetHeight}px` : "";
  }

  /** Return the critical angle of a case, if it is known: it is the same at every oblique angle. */
  criticalOf(values) {
    return this.answer.isOf(values) ? this.answer.found.critical_angle_deg : undefined;
  }

  /** Show the table once it can be of the inputs: run and critical angle come by themselves. */
  showDifferences() {
    const values = this.form.currentCase();
    if (!this.compare.pinned.length || this.run?.values !== values || this.angleOf !== values) return;
    if (this.compare.show({ values, run: this.run, found: this.answer.found })) markFresh(this.compare.table);
  }

  changePins() {
    const values = this.form.currentCase();
    markStale(this.parts.side, this.parts.histories, this.parts.scrubber);
    this.updatePicture(values);
    this.readdress();
  }

  /** Take what is pinned along to another case of this view. */
  keepPins(link) {
    if (link.hash) link.hash = address("explore", writePins(caseOf(readAddress(link.hash).query), this.compare.cases));
  }

  /** Show the warnings to this strike that are not among those to the critical angle. */
  showWarnings() {
    const known = new Set(this.answer.found?.warnings.map(({ code }) => code));
    this.parts.warnings.replaceChildren(...warningList((this.run?.warnings ?? []).filter(({ code }) => !known.has(code))));
  }

  async showLaws(values, signal) {
    const [angles, outcomes] = await Promise.all([requestAngles(values, signal), requestOutcomes(values, signal)]);
    if (signal.aborted) return;
    this.answer.setAlternatives(angles, values);
    this.laws.root.lastChild.replaceChildren(alternativesTable(angles, outcomes));
  }

  showInstant(row) {
    const { time_s: times } = this.run.history;
    this.row = row;
    this.instant = row < times.length - 1 ? times[row] : Infinity;
    moveOutline(this.parts.side, this.run, row);
    moveInstant(this.parts.histories, this.run, row);
    this.readdress();
  }

  readdress() {
    const query = writePins(caseQuery(this.form.currentCase()), this.compare.cases);
    if (Number.isFinite(this.instant)) query.set("time_ms", Number((this.instant * 1e3).toPrecision(4)));
    replaceAddress("explore", query);
  }

  fail(error) {
    if (error instanceof Problem && error.errors.length) this.refuse();
    const unplaced = error instanceof Problem ? this.form.showProblems(error) : error.message;
    this.parts.problem.textContent = unplaced || "A field is not accepted.";
  }

  leave() {
    this.updatePicture.stop();
    this.answer.stop();
    this.laws.stop();
    this.scrubber.stop();
    purge(this.parts.side);
    purge(this.parts.histories);
  }
}

function build(root, answer, compare, laws) {
  const parts = {
    form: element("form", { "aria-label": "Case", onsubmit: (event) => event.preventDefault() }),
    copy: element("div", {}),
    problem: element("p.problem", { role: "alert" }),
    outcome: element("div", {}, element("p.quiet", {}, "Computing ...")),
    warnings: element("div", {}),
    side: element("div.side-view", {}),
    scrubber: element("div.scrubber", {}),
    histories: element("div.histories", {}),
    presets: presetLinks("explore"),
  };
  root.append(
    element("h1", {}, "Explore a strike"),
    element("p.intro", {}, ABOUT),
    element(
      "div.sides",
      {},
      element("div.panel", {}, parts.presets, parts.form),
      element(
        "div.pictures",
        {},
        answer,
        element("section.panel.across", { "aria-label": "Outcome" }, parts.problem, parts.outcome, parts.warnings),
        compare,
        element("section.panel", {}, element("h2", {}, "Side view"), lostNote(), parts.side, parts.scrubber),
        element("section.panel", {}, element("h2", {}, "Histories"), parts.histories),
        laws,
        element("section.panel.copy", {}, element("h2", {}, "Copy this case"), parts.copy),
      ),
    ),
  );
  return parts;
}

/** Let a pointer over either plot choose the instant. */
function listen({ side, histories }, move) {
  for (const plot of [side, histories].map((each) => each.querySelector(".drawing"))) {
    plot.removeAllListeners("plotly_hover");
    plot.on("plotly_hover", ({ points }) => {
      const own = points.find(({ data }) => !data.meta); // not of a strike that is compared
      if (own) move(own.pointIndex);
    });
  }
}
