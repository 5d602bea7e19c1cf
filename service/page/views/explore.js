// Explore: one strike, as its fields are changed.

import { address, caseQuery, readCase, replaceAddress } from "../address.js";
import { alternativesTable, askAngles, askOutcomes, rest } from "../alternatives.js";
import { angleRequest } from "../case.js";
import { copyButtons } from "../copy-as.js";
import { element } from "../elements.js";
import { buildForm } from "../form.js";
import { drawHistories, moveInstant } from "../histories.js";
import { latest } from "../latest.js";
import { purge } from "../plots.js";
import { askRun, rowAt } from "../run.js";
import { buildScrubber } from "../scrubber.js";
import { Problem, ask } from "../service.js";
import { drawSideView, moveOutline } from "../side-view.js";
import { headline, knownStudy } from "../study.js";
import { tellAngle, tellRun, tellWarnings } from "../words.js";

/** Show the view. */
export async function show(root, query) {
  const explore = new Explore(root, query);
  return () => explore.leave();
}

class Explore {
  warnings = { run: [], angle: [] };
  changed = performance.now(); // when a field was

  constructor(root, query) {
    const parts = build(root);
    const fail = (error) => this.fail(error);
    this.parts = parts;
    this.instant = query.has("time_ms") ? Number(query.get("time_ms")) / 1e3 : Infinity; // the last unless chosen
    this.askPicture = latest((values, signal) => this.showPicture(values, signal), fail);
    this.askAngle = latest((values, signal) => this.showAngle(values, signal), fail);
    this.askLaws = latest((values, signal) => this.showLaws(values, signal), fail);
    this.scrubber = buildScrubber(parts.scrubber, (row) => this.showInstant(row));
    this.form = buildForm(parts.form, {
      case: readCase(query),
      open: matchMedia("(min-width: 60rem)").matches ? ["Strike", "Projectile", "Target", "Model"] : ["Strike"],
      onChange: (values) => {
        this.changed = performance.now();
        parts.laws.setAttribute("aria-busy", "true");
        this.askPicture(values);
        this.readdress();
      },
    });
    parts.copy.append(copyButtons(this.form.currentCase));
    this.askPicture(this.form.currentCase());
  }

  async showPicture(values, signal) {
    const { parts, changed: start } = this;
    const run = await askRun(values, signal);
    this.run = run;
    this.row = rowAt(run, this.instant);
    this.scrubber.setTimes(run.history.time_s, this.row);
    await drawSideView(parts.side, [{ run, name: "Strike" }], this.row);
    performance.measure("ricochet: side view", { start });
    parts.problem.textContent = "";
    parts.outcome.replaceChildren(...tellRun(run));
    this.tellWarnings({ run: run.warnings });
    this.askAngle(values);
    if (this.askPicture.isBehind()) return;
    await drawHistories(parts.histories, run, this.row);
    performance.measure("ricochet: histories", { start });
    listen(parts, (row) => this.scrubber.move(row));
  }

  async showAngle(values, signal) {
    const body = angleRequest(values);
    const asked = JSON.stringify(body);
    if (asked !== this.angleAsked) {
      // the oblique angle does not matter to it
      const { data } = await ask("cra", { body, signal });
      this.angleAsked = asked;
      this.parts.angle.replaceChildren(tellAngle(data));
      this.tellWarnings({ angle: data.warnings });
    }
    this.tellStudy(values);
    this.askLaws(values);
  }

  /** Show how sure the critical angle is, once a study of this case was made. */
  tellStudy(values) {
    const study = knownStudy(values);
    const text = study && headline(study);
    const link = () => element("a", { href: address("how-sure", caseQuery(values)) }, "How sure");
    const words = () => element("p", {}, link(), ": ", element("strong", {}, text), ", the median and nine in ten.");
    this.parts.sure.replaceChildren(...(text ? [words()] : []));
  }

  async showLaws(values, signal) {
    await rest();
    if (this.askLaws.isBehind()) return;
    const [angles, outcomes] = await Promise.all([askAngles(values, signal), askOutcomes(values, signal)]);
    if (this.askLaws.isBehind()) return;
    const isShown = JSON.stringify(angleRequest(values)) === this.angleAsked;
    if (isShown) this.parts.angle.replaceChildren(tellAngle(angles));
    this.parts.laws.replaceChildren(alternativesTable(angles, outcomes));
    this.parts.laws.removeAttribute("aria-busy");
  }

  showInstant(row) {
    const { time_s: times } = this.run.history;
    this.row = row;
    this.instant = row < times.length - 1 ? times[row] : Infinity;
    moveOutline(this.parts.side, this.run, row);
    moveInstant(this.parts.histories, this.run, row);
    this.readdress();
  }

  tellWarnings(some) {
    Object.assign(this.warnings, some);
    const { run, angle } = this.warnings;
    const assumed = angle.some(({ code }) => code === "mass_properties_assumed"); // which says more than that of the run
    const rest = run.filter(({ code }) => !(assumed && code === "mass_properties_assumed"));
    this.parts.warnings.replaceChildren(...tellWarnings(rest, angle));
  }

  readdress() {
    const query = caseQuery(this.form.currentCase());
    if (Number.isFinite(this.instant)) query.set("time_ms", Number((this.instant * 1e3).toPrecision(4)));
    replaceAddress("explore", query);
  }

  fail(error) {
    const isOfService = error instanceof Problem;
    const unplaced = isOfService ? this.form.showProblems(error) : error.message;
    this.parts.problem.textContent = unplaced || "A field is not accepted; the picture is of the case before.";
  }

  leave() {
    this.askPicture.stop();
    this.askAngle.stop();
    this.askLaws.stop();
    this.scrubber.stop();
    purge(this.parts.side);
    purge(this.parts.histories);
  }
}

function build(root) {
  const parts = {
    form: element("form", { "aria-label": "Case", onsubmit: (event) => event.preventDefault() }),
    copy: element("div", {}),
    problem: element("p.problem", { role: "alert" }),
    outcome: element("div", {}, element("p.quiet", {}, "Computing ...")),
    angle: element("div", {}),
    sure: element("div.sure", {}),
    warnings: element("div", {}),
    laws: element("section.panel", { "aria-label": "Other laws", "aria-busy": "true" }),
    side: element("div.side-view", { "aria-busy": "true" }),
    scrubber: element("div.scrubber", {}),
    histories: element("div.histories", { "aria-busy": "true" }),
  };
  root.append(
    element("h1", {}, "Explore a strike"),
    element(
      "div.sides",
      {},
      element("div.panel", {}, parts.form, element("a", { href: "#/explore" }, "Start again from the paper's case")),
      element(
        "div.pictures",
        {},
        element("section.panel.across", { "aria-label": "Outcome" }, parts.outcome, parts.angle, parts.sure, parts.problem),
        element("section.panel", {}, element("h2", {}, "Side view"), parts.side, parts.scrubber),
        element("section.panel", {}, element("h2", {}, "Histories"), parts.histories),
        element("section.panel", { "aria-label": "Warnings" }, parts.warnings),
        parts.laws,
        element("section.panel", {}, element("h2", {}, "Copy this case"), parts.copy),
      ),
    ),
  );
  return parts;
}

/** Let a pointer over either plot choose the instant. */
function listen({ side, histories }, move) {
  for (const plot of [side, histories].map((each) => each.querySelector(".drawing"))) {
    plot.removeAllListeners("plotly_hover");
    plot.on("plotly_hover", ({ points }) => move(points[0].pointIndex));
  }
}
