// Explore: one strike, as its fields are changed.

import { caseQuery, readCase, replaceAddress } from "../address.js";
import { angleRequest } from "../case.js";
import { copyButtons } from "../copy-as.js";
import { element, say } from "../elements.js";
import { buildForm } from "../form.js";
import { drawHistories, moveInstant } from "../histories.js";
import { latest } from "../latest.js";
import { purge } from "../plots.js";
import { askRun, rowAt } from "../run.js";
import { buildScrubber } from "../scrubber.js";
import { ask } from "../service.js";
import { drawSideView, moveOutline } from "../side-view.js";
import { tellAngle, tellRun, tellWarnings } from "../words.js";

/** Show the view. */
export async function show(root, query) {
  const parts = build(root);
  const told = { run: [], angle: [] };
  let run;
  let row;
  let angleAsked;
  let start = performance.now();
  let instant = Number(query.get("time_ms")) / 1e3;

  const fail = (error) => {
    parts.problem.textContent = error.errors ? form.showProblems(error) || "A field above is not accepted." : error.message;
    say("");
  };
  const tell = () => parts.warnings.replaceChildren(...tellWarnings(told.run, told.angle));

  const askPicture = latest(async (values, signal) => {
    const asked = start;
    run = await askRun(values, signal);
    parts.problem.textContent = "";
    row = instant ? rowAt(run, instant) : run.history.time_s.length - 1;
    instant = 0;
    scrubber.setTimes(run.history.time_s);
    await drawSideView(parts.side, [{ run, name: "Strike" }], row);
    performance.measure("ricochet: side view", { start: asked });
    askAngle(values);
    parts.outcome.replaceChildren(...tellRun(run));
    told.run = run.warnings;
    tell();
    if (askPicture.isBehind()) return;
    await drawHistories(parts.histories, run, row);
    performance.measure("ricochet: histories", { start: asked });
    listen(parts, (next) => scrubber.move(next));
    scrubber.move(row);
  }, fail);

  const askAngle = latest(async (values, signal) => {
    const body = angleRequest(values);
    if (JSON.stringify(body) === angleAsked) return; // the oblique angle does not matter to it
    const { data } = await ask("cra", { body, signal });
    angleAsked = JSON.stringify(body);
    parts.angle.replaceChildren(tellAngle(data));
    told.angle = data.warnings;
    tell();
  }, fail);

  const scrubber = buildScrubber(parts.scrubber, (next) => {
    row = next;
    moveOutline(parts.side, run, row);
    moveInstant(parts.histories, run, row);
  });

  const form = buildForm(parts.form, {
    case: readCase(query),
    open: matchMedia("(min-width: 60rem)").matches ? ["Strike", "Projectile", "Target", "Model"] : ["Strike"],
    onChange(values, path) {
      start = performance.now();
      askPicture(values);
      replaceAddress("explore", caseQuery(values));
    },
  });
  parts.copy.append(copyButtons(form.currentCase));
  askPicture(form.currentCase());
  return () => {
    for (const asker of [askPicture, askAngle]) asker.stop();
    scrubber.stop();
    for (const plot of [parts.side, parts.histories]) purge(plot);
  };
}

function build(root) {
  const parts = {
    form: element("form.panel", { "aria-label": "Case", onsubmit: (event) => event.preventDefault() }),
    copy: element("div", {}),
    problem: element("p.problem", { role: "alert" }),
    outcome: element("div", {}, element("p.quiet", {}, "Computing ...")),
    angle: element("div", {}),
    warnings: element("div", {}),
    side: element("div.side-view", { "aria-busy": "true" }),
    scrubber: element("div.scrubber", {}),
    histories: element("div.histories", { "aria-busy": "true" }),
  };
  root.append(
    element("h1", {}, "Explore a strike"),
    element(
      "div.sides",
      {},
      parts.form,
      element(
        "div.pictures",
        {},
        element("section.panel.across", { "aria-label": "Outcome" }, parts.outcome, parts.angle, parts.problem),
        element("section.panel", {}, element("h2", {}, "Side view"), parts.side, parts.scrubber),
        element("section.panel", {}, element("h2", {}, "Histories"), parts.histories),
        element("section.panel", { "aria-label": "Warnings" }, parts.warnings),
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
