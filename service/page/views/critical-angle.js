// Critical angle: how three searches find it, and what happens just below and above.

import { caseQuery, readCase, replaceAddress } from "../address.js";
import { alternativesTable, askAngles, rest } from "../alternatives.js";
import { angleRequest, withValue } from "../case.js";
import { METHODS, drawAngles, drawPositions, summary, trialTable } from "../convergence.js";
import { copyButtons } from "../copy-as.js";
import { element } from "../elements.js";
import { buildForm } from "../form.js";
import { latest } from "../latest.js";
import { purge } from "../plots.js";
import { askRun } from "../run.js";
import { ask } from "../service.js";
import { drawSideView } from "../side-view.js";
import { outcomeShown, tellAngle, tellWarnings } from "../words.js";

const OFFSET = "offset_deg";
const OFFSETS = [0.01, 0.1, 0.5, 1, 2, 5];
const LARGEST_DEG = 89.9;

/** Show the view. */
export async function show(root, query) {
  const parts = build(root, Number(query.get(OFFSET)));
  let answers = {};

  const fail = (error) => {
    parts.problem.textContent = error.errors ? form.showProblems(error) || "A field is not accepted." : error.message;
  };

  const askSides = latest(async (values, signal) => {
    const angle = answers.outcome.critical_angle_deg;
    parts.sidePanel.hidden = angle === undefined;
    if (angle === undefined) return;
    const offset = Number(parts.offset.value);
    const angles = [Math.max(angle - offset, 0), Math.min(angle + offset, LARGEST_DEG)];
    const runs = await Promise.all(
      angles.map(async (each) => {
        const run = await askRun(withValue(values, "impact.oblique_angle_deg", each), signal);
        return { run, name: `${each.toFixed(2)}°: ${outcomeShown(run.outcome)}` };
      }),
    );
    await drawSideView(parts.side, runs, 0);
  }, fail);

  const askLaws = latest(async (values, signal) => {
    await rest();
    if (askLaws.isBehind()) return;
    const found = await askAngles(values, signal);
    if (askLaws.isBehind()) return;
    answers = { ...answers, outcome: found };
    parts.answer.replaceChildren(tellAngle(found));
    parts.laws.replaceChildren(alternativesTable(found));
    parts.laws.removeAttribute("aria-busy");
  }, fail);

  const askers = Object.keys(METHODS).map((method) =>
    latest(async (values, signal) => {
      const search = method === values.search?.method ? values.search : { method };
      const { data } = await ask("cra", { body: angleRequest(values, search), signal });
      answers = { ...answers, [method]: data };
      await showAnswers(parts, answers);
      if (method === "outcome") {
        askSides(values);
        askLaws({ ...values, search });
      }
    }, fail),
  );

  const askAll = (values) => {
    parts.problem.textContent = "";
    parts.laws.setAttribute("aria-busy", "true");
    for (const asker of askers) asker(values);
  };
  const readdress = () => {
    const next = caseQuery(form.currentCase());
    next.set(OFFSET, parts.offset.value);
    replaceAddress("critical-angle", next);
  };

  const form = buildForm(parts.form, {
    case: readCase(query),
    include: ["Strike", "Projectile", "Target", "Model"],
    without: ["impact.oblique_angle_deg"],
    open: matchMedia("(min-width: 60rem)").matches ? undefined : ["Strike"],
    onChange(values) {
      askAll(values);
      readdress();
    },
  });
  parts.copy.append(copyButtons(form.currentCase));
  parts.offset.addEventListener("change", () => {
    if (answers.outcome) askSides(form.currentCase());
    readdress();
  });
  askAll(form.currentCase());
  return () => {
    for (const asker of [...askers, askSides, askLaws]) asker.stop();
    for (const plot of [parts.side, parts.angles, parts.positions]) purge(plot);
  };
}

async function showAnswers(parts, answers) {
  const methods = Object.keys(METHODS).filter((method) => method in answers);
  const found = Object.fromEntries(methods.map((method) => [method, answers[method]]));
  if (found.outcome) {
    parts.answer.replaceChildren(tellAngle(found.outcome));
    parts.warnings.replaceChildren(...tellWarnings(found.outcome.warnings));
  }
  parts.summary.replaceChildren(summary(found));
  parts.tables.replaceChildren(...methods.map((method) => trialTable(method, found[method])));
  await Promise.all([drawAngles(parts.angles, found), drawPositions(parts.positions, found)]);
}

function build(root, offset) {
  const options = OFFSETS.map((each) => {
    const selected = each === (OFFSETS.includes(offset) ? offset : 0.5);
    return element("option", { value: each, selected }, `${each}°`);
  });
  const parts = {
    form: element("form.panel", { "aria-label": "Case", onsubmit: (event) => event.preventDefault() }),
    copy: element("div", {}),
    problem: element("p.problem", { role: "alert" }),
    answer: element("div.outcome", {}, element("p.quiet", {}, "Computing ...")),
    warnings: element("div", {}),
    summary: element("div", {}),
    laws: element("section.panel.across", { "aria-label": "Other laws", "aria-busy": "true" }),
    offset: element("select", { id: "offset" }, ...options),
    side: element("div.side-view", {}),
    angles: element("div.trials", {}),
    positions: element("div.trials", {}),
    tables: element("div.thirds", {}),
  };
  parts.sidePanel = element(
    "section.panel",
    {},
    element("h2", {}, "Just below and just above"),
    element("p", {}, element("label", { for: "offset" }, "Distance from the critical angle "), parts.offset),
    parts.side,
  );
  const section = (title, ...content) => element("section.panel", {}, element("h2", {}, title), ...content);
  const note = "Filled marks count as turned away, in the paper's searches by which side of the face the tip ends on.";
  root.append(
    element("h1", {}, "Critical angle"),
    element(
      "div.sides",
      {},
      parts.form,
      element(
        "div.pictures",
        {},
        element("section.panel.across", { "aria-label": "Answer" }, parts.answer, parts.problem, parts.summary),
        parts.laws,
        section("Angles tried", element("p.quiet", {}, `${note} The dashed line is the critical angle.`), parts.angles),
        section("Final positions", element("p.quiet", {}, `${note} Outside the face is above.`), parts.positions),
        parts.sidePanel,
        element("section.panel", { "aria-label": "Warnings" }, parts.warnings),
        element("section.panel.across", {}, element("h2", {}, "Trials"), parts.tables),
        section("Copy this case", parts.copy),
      ),
    ),
  );
  return parts;
}
