// Explore: one strike, computed again whenever its fields change.

import { address, caseQuery, readAddress, readCase, replaceAddress } from "../address.js";
import { lawsFold } from "../alternatives.js";
import { Compare, readPins, writePins } from "../compare.js";
import { copyButtons } from "../copy-as.js";
import { element, formBeside, showText } from "../elements.js";
import { drawFlight, flightWords, requestFlight } from "../flight.js";
import { CaseForm } from "../form.js";
import { drawHistories, moveInstant } from "../histories.js";
import { latest } from "../latest.js";
import { lostNote, untilSeen } from "../lost.js";
import { purge } from "../plots.js";
import { presetLinks } from "../presets.js";
import { strikeActions } from "../report.js";
import { computeRun, rowAt } from "../run.js";
import { buildScrubber } from "../scrubber.js";
import { drawSideView, markCritical, moveOutline, rowNear } from "../side-view.js";
import { markFresh, markStale } from "../stale.js";
import { TurnHandle } from "../turn-handle.js";
import { Verdict } from "../verdict.js";
import { describeRun, outcomeShown } from "../words.js";

const REST_MS = 1000; // delay before histories out of view are drawn, which takes as long as several steps of a slider
const ABOUT = "A rigid projectile strikes concrete at an angle from the normal; above the critical angle it ricochets.";

/** Show the view. */
export async function show(root, query) {
  const explore = new Explore(root, query);
  return () => explore.leave();
}

class Explore {
  changed = performance.now(); // time of the latest change of a field

  constructor(root, query) {
    const fail = (error) => this.form.fail(error);
    this.laws = lawsFold(fail, { hasStrike: true });
    this.verdict = new Verdict({ onError: fail, onAngle: (_, values) => this.showAngle(values), hasRun: true });
    const read = () => this.form.currentCase();
    this.compare = new Compare(readPins(query), { currentCase: read, onChange: () => this.changePins() });
    this.copy = copyButtons(read);
    const actions = strikeActions(read, fail, this.compare.button);
    const parts = build(root, { verdict: this.verdict.root, compare: this.compare.root, laws: this.laws.root, copy: this.copy.root, actions });
    this.parts = parts;
    this.instant = query.has("time_ms") ? Number(query.get("time_ms")) / 1e3 : Infinity; // the last one unless another is chosen
    this.updatePicture = latest((values, signal) => this.showPicture(values, signal), fail);
    this.updateHistories = latest((start, signal) => this.showHistories(start, signal), fail, { supersede: true });
    this.handle = new TurnHandle(parts.side, {
      onTurn: (angle) => this.form.setField("impact.oblique_angle_deg", angle),
      onHold: (isHeld) => {
        this.verdict.keepHeight(isHeld); // it is above the picture, which must not move
        if (!isHeld && !this.form.isHeld) this.updatePicture(this.form.currentCase()); // fits the frame to the picture again
      },
    });
    this.scrubber = buildScrubber(parts.scrubber, (row) => this.showInstant(row));
    this.form = new CaseForm(parts.form, {
      case: readCase(query),
      open: matchMedia("(min-width: 60rem)").matches ? undefined : ["How it strikes"],
      onChange: (values) => this.change(values),
      onHold: () => [this.updatePicture, this.updateHistories].forEach((each) => each.cancel()),
      problem: parts.problem,
      parts: () => [...this.ofStrike, parts.scrubber],
      panels: [this.verdict, this.laws],
      actions: [actions, this.copy.actions],
    });
    parts.side.addEventListener("pointermove", (event) => this.point(event));
    this.follower = new ResizeObserver(() => this.run && this.drawSide());
    this.follower.observe(parts.side);
    for (const links of [parts.presets, this.verdict.own]) links.addEventListener("click", ({ target }) => this.keepPins(target));
    this.verdict.linkTo(this.form.currentCase());
    if (query.has("enter")) this.form.enterShots();
    if (!this.form.isHeld) this.change(this.form.currentCase());
  }

  /** The parts that belong to this strike. */
  get ofStrike() {
    const { outcome, side, histories, landing, flight } = this.parts;
    return [outcome, side, histories, landing, flight, ...(this.compare.pinned.length ? [this.compare.table] : [])];
  }

  change(values) {
    this.changed = performance.now();
    this.copy.clear();
    markStale(...this.ofStrike, this.parts.scrubber);
    this.updateHistories.cancel();
    this.verdict.setCase(values);
    this.updatePicture(values);
    this.laws.setCase(values);
    this.readdress();
  }

  async showPicture(values, signal) {
    const { parts, changed: start } = this;
    const [run] = await Promise.all([computeRun(values, signal), this.compare.load(signal)]);
    this.runs = this.compare.withRuns(run);
    this.run = run;
    this.row = rowAt(run, this.instant);
    this.scrubber.setTimes(run.history.time_s, this.row);
    parts.scrubber.hidden = false;
    showText(parts.outcome, describeRun(run));
    this.verdict.setRun(run);
    this.showDifferences();
    this.drawSide();
    this.handle.follow(run, outcomeShown(run.outcome));
    performance.measure("ricochet: side view", { start });
    if (this.updatePicture.isBehind()) return;
    markFresh(parts.outcome, parts.side, parts.scrubber);
    this.updateHistories(start);
  }

  /** Show the histories once they are in view, so that a slider above them does not wait for plots that nobody sees. */
  async showHistories(start, signal) {
    const { parts, run } = this;
    await untilSeen(parts.histories, REST_MS, signal);
    await drawHistories(parts.histories, this.runs, this.row);
    if (signal.aborted) return;
    markFresh(parts.histories);
    performance.measure("ricochet: histories", { start });
    listen(parts, (row) => this.scrubber.move(row));
    await this.showFlight(run, signal);
  }

  /** Show where a body lands after a ricochet. */
  async showFlight(run, signal) {
    const { landing, flight } = this.parts;
    const found = await requestFlight(run, signal);
    if (signal.aborted) return;
    flight.parentElement.hidden = !found;
    if (!flight.querySelector(".drawing")) flight.replaceChildren(); // removes the message on a field that was not accepted
    if (found) {
      showText(landing, flightWords(found));
      await drawFlight(flight, run, found);
    }
    if (!signal.aborted) markFresh(landing, flight);
  }

  drawSide() {
    drawSideView(this.parts.side, this.runs, this.row, { critical: this.criticalOf(this.run.values), turns: true, isHeld: this.handle.isHeld });
    this.handle.place();
  }

  showAngle(values) {
    this.angleOf = values;
    if (this.run?.values === values) markCritical(this.parts.side, this.criticalOf(values)); // otherwise the next drawing includes it
    this.showDifferences();
  }

  /** Let a pointer near the path choose the instant. */
  point({ offsetX, offsetY, target, buttons }) {
    if (buttons || !this.run || !target.closest(".drawing svg")) return;
    const row = rowNear(this.parts.side, [offsetX, offsetY]);
    if (row !== undefined && row !== this.row) this.scrubber.move(row);
  }

  /** Return the critical angle of a case if it is known; it does not depend on the oblique angle. */
  criticalOf(values) {
    return this.verdict.isOf(values) ? this.verdict.found.critical_angle_deg : undefined;
  }

  /** Show the table of differences once both the run and the critical angle of the inputs have arrived. */
  showDifferences() {
    const values = this.form.currentCase();
    if (!this.compare.pinned.length || this.run?.values !== values || this.angleOf !== values) return;
    if (this.compare.show({ values, run: this.run, found: this.verdict.found })) markFresh(this.compare.table);
  }

  changePins() {
    this.readdress();
    if (this.form.isHeld) return; // the comparison follows once all fields are accepted
    markStale(this.parts.side, this.parts.histories, this.parts.scrubber);
    this.updateHistories.cancel();
    this.updatePicture(this.form.currentCase());
  }

  /** Keep the pinned strikes in a link to another case of this view. */
  keepPins(link) {
    if (link.hash) link.hash = address("explore", writePins(readAddress(link.hash).query, this.compare.cases));
  }

  showInstant(row) {
    const { time_s: times } = this.run.history;
    this.row = row;
    this.instant = row < times.length - 1 ? times[row] : Infinity;
    moveOutline(this.parts.side, row);
    moveInstant(this.parts.histories, this.run, row);
    this.readdress();
  }

  readdress() {
    const query = writePins(caseQuery(this.form.currentCase()), this.compare.cases);
    if (Number.isFinite(this.instant)) query.set("time_ms", Number((this.instant * 1e3).toPrecision(4)));
    replaceAddress("explore", query);
  }

  leave() {
    const { updatePicture, updateHistories, verdict, laws, scrubber, follower, parts } = this;
    for (const each of [updatePicture, updateHistories, verdict, laws, scrubber]) each.stop();
    follower.disconnect();
    for (const plot of [parts.side, parts.histories, parts.flight]) purge(plot);
  }
}

function build(root, { verdict, compare, laws, copy, actions }) {
  const parts = {
    form: element("form", { "aria-label": "Case", onsubmit: (event) => event.preventDefault() }),
    problem: element("p.problem", { role: "alert" }),
    outcome: element("p.quiet", { role: "group", "aria-label": "Outcome" }),
    side: element("div.side-view", {}),
    scrubber: element("div.scrubber", {}),
    histories: element("div.histories", {}),
    landing: element("p", {}),
    flight: element("div.flight", {}),
    presets: presetLinks("explore"),
  };
  root.append(
    element("div.heading", {}, element("h1", {}, "Explore a strike"), element("p.intro", {}, ABOUT)),
    formBeside(
      [parts.presets, parts.form],
      verdict,
      element("section.panel.picture", { "aria-label": "Side view" }, parts.problem, lostNote(), parts.side, parts.scrubber),
      element("section.panel.across", { "aria-label": "This strike" }, parts.outcome, actions),
      compare,
      element("section.panel", {}, element("h2", {}, "Histories"), parts.histories),
      element("section.panel", { hidden: true, "aria-label": "Where it lands" }, element("h2", {}, "Where it lands"), parts.landing, parts.flight),
      laws,
      copy,
    ),
  );
  return parts;
}

/** Let a pointer over the histories choose the instant. */
function listen({ histories }, move) {
  const plot = histories.querySelector(".drawing");
  plot.removeAllListeners("plotly_hover");
  plot.on("plotly_hover", ({ points }) => {
    const own = points.find(({ data }) => !data.meta); // not a compared strike
    if (own) move(own.pointIndex);
  });
}
