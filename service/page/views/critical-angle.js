// Critical angle: how three searches find it, and what happens just below and above.

import { caseQuery, readCase, replaceAddress } from "../address.js";
import { lawsFold } from "../alternatives.js";
import { angleRequest, withValue } from "../case.js";
import { ANGLES, POSITIONS, drawTrials, searches, summary, trialTable } from "../convergence.js";
import { copyButtons } from "../copy-as.js";
import { drawCurves, requestCurves } from "../curves.js";
import { element, formBeside } from "../elements.js";
import { buildFold } from "../fold.js";
import { CaseForm } from "../form.js";
import { latest } from "../latest.js";
import { lostNote } from "../lost.js";
import { purge } from "../plots.js";
import { presetLinks } from "../presets.js";
import { strikeActions } from "../report.js";
import { computeRun } from "../run.js";
import { request } from "../service.js";
import { drawSideView } from "../side-view.js";
import { markFresh, markStale } from "../stale.js";
import { inUnits } from "../units.js";
import { Verdict } from "../verdict.js";
import { outcomeShown } from "../words.js";

const OFFSET = "offset_deg";
const OFFSETS = [0.01, 0.1, 0.5, 1, 2, 5];
const LARGEST_DEG = 89.9;
const REST_MS = 300; // pause without a change before the curves are computed, which takes 26 searches

/** Show the view. */
export async function show(root, query) {
  const fail = (error) => form.fail(error);
  let [found, foundFor] = [undefined, undefined]; // the latest answer of `/cra`, and its case
  const laws = lawsFold(fail, { hasStrike: false });
  const searches = buildFold("How it was found", searchParts(), (values, signal) => showSearches(searches.root, values, signal), fail);
  const verdict = new Verdict({
    onError: fail,
    onAngle(data, values) {
      [found, foundFor] = [data, values];
      updateSides(values);
      updateCurves(values);
    },
  });
  const copy = copyButtons(() => form.currentCase());
  const actions = strikeActions(() => form.currentCase(), fail);
  const parts = build(root, Number(query.get(OFFSET)), verdict.root, actions, [searches.root, laws.root, copy.root]);

  const updateSides = latest(async (values, signal) => {
    const angle = found.critical_angle_deg;
    parts.sidePanel.hidden = angle === undefined;
    if (angle === undefined) return markFresh(...parts.sides);
    const offset = Number(parts.offset.value);
    const angles = [Math.max(angle - offset, 0), Math.min(angle + offset, LARGEST_DEG)];
    const runs = await Promise.all(
      angles.map(async (each) => {
        const run = await computeRun(withValue(values, "impact.oblique_angle_deg", each), signal);
        return { run, name: `${each.toFixed(2)}°: ${outcomeShown(run.outcome)}` };
      }),
    );
    if (signal.aborted) return;
    runs.forEach((each, i) => {
      const caption = `Just ${["below", "above"][i]}, at ${each.name}`;
      drawSideView(parts.sides[i], [each], each.run.history.time_s.length - 1, { beside: [runs[1 - i].run], caption });
    });
    if (!signal.aborted) markFresh(...parts.sides);
  }, fail, { supersede: true });

  const updateCurves = latest(async (values, signal) => {
    const curves = await requestCurves(values, signal);
    if (signal.aborted) return;
    await drawCurves(parts.curves, curves, values, found);
    if (!signal.aborted) markFresh(parts.curves);
  }, fail, { supersede: true, restMs: REST_MS });

  const ofCase = [...parts.sides, parts.curves];
  const cancel = () => [updateSides, updateCurves].forEach((each) => each.cancel());
  const change = (values) => {
    copy.clear();
    markStale(...ofCase);
    cancel();
    verdict.setCase(values);
    for (const fold of [searches, laws]) fold.setCase(values);
    readdress();
  };
  const readdress = () => {
    const next = caseQuery(form.currentCase());
    next.set(OFFSET, parts.offset.value);
    replaceAddress("critical-angle", next);
  };

  const form = new CaseForm(parts.form, {
    case: readCase(query),
    include: ["What strikes", "What it strikes", "How it strikes", "Laws"],
    open: matchMedia("(min-width: 60rem)").matches ? undefined : ["How it strikes"],
    onChange: change,
    onHold: cancel,
    problem: parts.problem,
    parts: () => ofCase,
    panels: [verdict, searches, laws],
    actions: [actions, copy.actions],
  });
  parts.offset.addEventListener("change", () => {
    markStale(...parts.sides);
    if (foundFor === form.currentCase()) updateSides(foundFor);
    readdress();
  });
  change(form.currentCase());
  return () => {
    for (const each of [verdict, updateSides, updateCurves, searches, laws]) each.stop();
    for (const plot of root.querySelectorAll(".plot")) purge(plot);
  };
}

/** Return the search by a method, with the settings of the case if it uses this method. */
function searchOf(values, method) {
  return method === values.search?.method ? values.search : { method };
}

function searchParts() {
  const note = "Filled marks count as a ricochet; the paper's searches decide this by the side of the face on which the tip ends.";
  return element(
    "div.searches",
    {},
    element("div.summary", {}),
    element("h3", {}, "Angles tried"),
    element("p.quiet", {}, `${note} The dashed line is the critical angle.`),
    element("div.trials.angles", {}),
    element("h3", {}, "Final positions"),
    element("p.quiet", {}, "The dashed line is the face; above it is outside."),
    element("div.trials.positions", {}),
    element("h3", {}, "Trials"),
    element("div.thirds", {}),
  );
}

/** Show how the three searches converge. */
async function showSearches(root, values, signal) {
  const part = (name) => root.querySelector(name);
  const answers = {};
  for (const method of Object.keys(searches())) {
    answers[method] = (await request("cra", { body: inUnits(angleRequest(values, searchOf(values, method))), signal })).data;
  }
  if (signal.aborted) return;
  part(".summary").replaceChildren(summary(answers));
  part(".thirds").replaceChildren(...Object.keys(answers).map((method) => trialTable(method, answers[method])));
  await Promise.all([drawTrials(part(".angles"), answers, values, ANGLES), drawTrials(part(".positions"), answers, values, POSITIONS)]);
}

function build(root, offset, verdict, actions, folds) {
  const options = OFFSETS.map((each) => {
    const selected = each === (OFFSETS.includes(offset) ? offset : 0.5);
    return element("option", { value: each, selected }, `${each}°`);
  });
  const parts = {
    form: element("form", { "aria-label": "Case", onsubmit: (event) => event.preventDefault() }),
    problem: element("p.problem", { role: "alert" }),
    offset: element("select", { id: "offset" }, ...options),
    sides: [0, 1].map(() => element("div.side-view", {})),
    curves: element("div.curves", {}),
  };
  parts.sidePanel = element(
    "section.panel.across",
    {},
    element("h2", {}, "Just below and just above"),
    element("p", {}, element("label", { for: "offset" }, "Distance from the critical angle "), parts.offset),
    element("div.pair", {}, ...parts.sides),
  );
  root.append(
    element("h1", {}, "Critical angle"),
    formBeside(
      [presetLinks("critical-angle"), parts.form],
      ...[verdict, actions, parts.problem, lostNote(), parts.sidePanel],
      element("section.panel.across", {}, element("h2", {}, "Over speed and over strength"), parts.curves),
      ...folds,
    ),
  );
  return parts;
}
