// The same case under other laws: how much the choice of model decides.

import { angleRequest, trajectoryRequest } from "./case.js";
import { element } from "./elements.js";
import { fieldAt } from "./fields.js";
import { request } from "./service.js";
import { degreesShown, outcomeShown, statusShown } from "./words.js";

const STRENGTH_LAWS = {
  obliquity_polynomial: () => ["Eq. 9"],
  published_tests: () => ["Published tests"],
  strength_power_law: () => ["82.6 (f′", element("sub", {}, "c"), "/MPa)", element("sup", {}, "−0.544")],
};

/** Return the critical angle of a case with its alternatives. */
export async function requestAngles(values, signal) {
  return (await request("cra", { body: { ...angleRequest(values), alternatives: true }, signal })).data;
}

/** Return the outcome of a strike with its alternatives. */
export async function requestOutcomes(values, signal) {
  const body = { ...trajectoryRequest(values), output: { history: false }, alternatives: true };
  return (await request("trajectory", { body, signal })).data;
}

/** Return a table of the alternatives of a search and, if given, of a strike. */
export function alternativesTable(angles, outcomes) {
  const decays = fieldAt("resistance.free_surface.model").choices;
  const rows = angles.alternatives.map((each, i) => [
    [decays[each.free_surface]],
    STRENGTH_LAWS[each.strength_factor](),
    [angleShown(each)],
    ...(outcomes ? [[endShown(outcomes.alternatives[i])]] : []),
    [each.fitted_to],
  ]);
  const names = ["Decay", "Strength factor S", "Critical angle", ...(outcomes ? ["This strike"] : []), "Fitted to"];
  const head = element("tr", {}, ...names.map((name) => element("th", { scope: "col" }, name)));
  const lines = rows.map((cells) => element("tr", {}, ...cells.map((cell) => element("td", {}, ...cell))));
  const parts = [element("thead", {}, head), element("tbody", {}, ...lines)];
  const table = element("table.laws", {}, element("caption", {}, "Under other laws"), ...parts);
  return element("div.wide", { tabindex: 0, role: "group", "aria-label": "Table of other laws" }, table); // it scrolls
}

function angleShown({ critical_angle_deg: angle, status, problem }) {
  if (problem) return problem.title;
  return angle === undefined ? statusShown(status) : degreesShown(angle);
}

function endShown({ outcome, problem }) {
  return problem ? problem.title : outcomeShown(outcome);
}
