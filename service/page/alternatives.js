// The same case under other laws: how much the choice of model decides.

import { angleRequest, trajectoryRequest } from "./case.js";
import { element } from "./elements.js";
import { fieldAt } from "./fields.js";
import { request } from "./service.js";
import { degreesShown, outcomeShown, statusShown } from "./words.js";

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
  const [decays, laws] = ["free_surface", "strength_factor"].map((part) => fieldAt(`resistance.${part}.model`).choices);
  const rows = angles.alternatives.map((each, i) => [
    [decays[each.free_surface]],
    [laws[each.strength_factor]],
    [angleShown(each)],
    ...(outcomes ? [[endShown(outcomes.alternatives[i])]] : []),
    [each.fitted_to],
  ]);
  const names = ["Free surface", "Strength factor S", "Critical angle", ...(outcomes ? ["This strike"] : []), "Fitted to"];
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
