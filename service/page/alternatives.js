// The same case under other laws, which shows how much depends on the choice of model.

import { angleRequest, trajectoryRequest } from "./case.js";
import { element, table } from "./elements.js";
import { fieldAt } from "./fields.js";
import { buildFold } from "./fold.js";
import { request } from "./service.js";
import { inUnits } from "./units.js";
import { degreesShown, outcomeShown, statusShown } from "./words.js";

const NOTE =
  "These are with the inputs as given. The theories beside the verdict are at the medians, and Mohr-Coulomb there has its own S over the angle, that of finite elements.";

/** Return a collapsed section with the critical angle under other laws and, with `hasStrike`, the outcome of the strike. */
export function lawsFold(onError, { hasStrike }) {
  const content = element("div.laws-table");
  const show = async (values, signal) => {
    const post = async (path, body) => (await request(path, { body: inUnits({ ...body, alternatives: true }), signal })).data;
    const strike = { ...trajectoryRequest(values), output: { history: false } };
    const [angles, outcomes] = await Promise.all([post("cra", angleRequest(values)), hasStrike && post("trajectory", strike)]);
    if (!signal.aborted) content.replaceChildren(alternativesTable(angles, outcomes), element("p.quiet", {}, NOTE));
  };
  return buildFold("Under other laws", content, show, onError);
}

function alternativesTable(angles, outcomes) {
  const [decays, laws, shapes] = ["free_surface.model", "strength_factor.model", "strength_factor.obliquity_shape"].map(
    (field) => fieldAt(`resistance.${field}`).choices,
  );
  const rows = angles.alternatives.map((each, i) => [
    decays[each.free_surface],
    each.obliquity_shape === "finite_elements" ? shapes[each.obliquity_shape] : laws[each.strength_factor],
    unlessFailed(each, ({ critical_angle_deg: angle, status }) => (angle === undefined ? statusShown(status) : degreesShown(angle))),
    ...(outcomes ? [unlessFailed(outcomes.alternatives[i], ({ outcome }) => outcomeShown(outcome))] : []),
    each.fitted_to,
  ]);
  const heads = ["Free surface", "Strength factor S", "Critical angle", ...(outcomes ? ["This strike"] : []), "Fitted to"];
  return table("table.laws", { heads, rows, caption: "Under other laws", label: "Table of other laws" });
}

function unlessFailed(each, shown) {
  return each.problem ? each.problem.title : shown(each);
}
