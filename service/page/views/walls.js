// Walls: whether a wall is thick enough against perforation and scabbing, and the thicknesses by formula and by model.

import { caseQuery, readCase, replaceAddress } from "../address.js";
import { withValue } from "../case.js";
import { names } from "../contract.js";
import { element, formBeside, table } from "../elements.js";
import { CaseForm } from "../form.js";
import { latest } from "../latest.js";
import { presetLinks } from "../presets.js";
import { lostNote } from "../lost.js";
import { strikeActions } from "../report.js";
import { request } from "../service.js";
import { markFresh, markStale } from "../stale.js";
import { inUnits, unitOf } from "../units.js";
import { sentencesOf, showCard, verdictSection } from "../verdict.js";
import { endingShown, grouped, quantityShown, warningList } from "../words.js";

const THICKNESS = "target.thickness_m";
const SPEED = "impact.velocity_m_s";
/** Names of the variants of the model, which differ in how they treat the faces. */
const MODELS = { plain: "This model", rear_plug: "With a plug at the rear", rear_plug_and_crater: "With a plug and a crater" };
const COLUMNS = ["By", "Perforation limit", "Scabbing limit", "Penetration", "Range of the tests behind it"];

/** Show the view. */
export async function show(root, query) {
  const fail = (error) => form.fail(error);
  const actions = strikeActions(() => form.currentCase(), fail);
  const parts = build(root, actions);
  const shown = [parts.card, parts.warnings, parts.thicknesses];
  const updateResults = latest(async (values, signal) => {
    const post = async (path, body) => (await request(path, { body, signal })).data;
    const { projectile, target, impact, resistance, numerics } = values;
    const body = inUnits({ projectile, target, impact, resistance, numerics });
    const isWall = target.thickness_m !== undefined;
    const [judged, thickness, table, speed] = await Promise.all([
      post("wall", body),
      post("thickness", withValue(body, THICKNESS)),
      post("formulas", withValue(inUnits({ projectile, target, impact }), THICKNESS)),
      isWall ? post("limit-speed", withValue(body, SPEED)) : undefined,
    ]);
    if (signal.aborted) return;
    const [first, ...others] = sentencesOf(judged.sentence);
    const ends = isWall ? `The strike ends by this model: ${endingShown(judged)}.` : "Fill in the thickness of the target.";
    showCard(parts.card, { first, second: [...others, ends].join(" "), line: first });
    const sentences = [thickness, speed].filter(Boolean).map(({ sentence }) => element("p", {}, sentence));
    parts.warnings.replaceChildren(...warningList(judged.warnings, thickness.warnings));
    parts.thicknesses.replaceChildren(...sentences, tableOf(thickness, table, judged, target));
    markFresh(...shown);
  }, fail, { supersede: true });
  const refresh = (values) => {
    markStale(...shown);
    updateResults(values);
  };
  const form = new CaseForm(parts.form, {
    case: readCase(query),
    include: ["What strikes", "What it strikes", "How it strikes", "Laws"], // keeps the thickness, which this view judges, in view
    open: matchMedia("(min-width: 60rem)").matches ? undefined : ["What it strikes", "How it strikes"],
    onChange(values) {
      refresh(values);
      replaceAddress("walls", caseQuery(values));
    },
    onHold: () => updateResults.cancel(),
    problem: parts.problem,
    parts: () => shown,
    actions: [actions],
  });
  refresh(form.currentCase());
  return () => updateResults.stop();
}

function tableOf({ variants }, { formulas, scabbing_margin: scabbing, perforation_margin: perforation }, judged, target) {
  const isNumber = (column) => column > 0 && column < COLUMNS.length - 1;
  const { compressive_strength_pa: mean, characteristic_strength_pa: characteristic } = target;
  const models = Object.entries(MODELS).map(([variant, name]) => [name, bare(variants[variant], Math.ceil), "", "", ""]);
  const others = formulas.map((each) => [
    `${names.formulas[each.formula]}${each.verified ? "" : "\u00a0*"}`,
    bare(each.perforation_thickness_m, Math.ceil),
    bare(each.scabbing_thickness_m, Math.ceil),
    bare(each.penetration_depth_m, Math.round),
    rangeShown(each, judged),
  ]);
  const heads = COLUMNS.map((name, column) => (isNumber(column) ? `${name} [${unitOf("mm").unit}]` : name));
  const caption = `By formula and by model, with the mean strength of ${quantityShown(mean, "MPa", 6)}, without margins`;
  const rest = { caption, label: "Table of thicknesses", isNumber, classes: formulas.map((each) => (each.in_range ? undefined : "quiet")) };
  const note =
    "Limits are the least thickness that is not perforated and the least whose rear face sheds no concrete (scabbing); penetration is the depth in " +
    "thick concrete. Formulas have no angle: as is common practice, they take the normal component of the speed. DOE-STD-3014 requires " +
    `${scabbing} times the scabbing and ${perforation} times the perforation limit in a design. * Constants from secondary sources.` +
    (characteristic === undefined ? "" : ` The design values of the wall are for the characteristic strength of ${quantityShown(characteristic, "MPa", 6)}.`);
  return element("div", {}, table("table.thicknesses", { heads, rows: [...others, ...models], ...rest }), element("p.quiet", {}, note));
}

function rangeShown({ formula, in_range: isWithin, range_known: isKnown, out_of_range: outside, note }, judged) {
  const reasons = outside.map(({ detail }) => detail).join("; ");
  const range = isWithin ? "within" : isKnown ? `outside: ${reasons}` : `not known${reasons && `; ${reasons}`}`;
  const [one, other] = ["scabbing", "perforation"].filter((name) => judged[name].formula === formula);
  return [range, note, other ? "gives both design values" : one && `gives the design value against ${one}`].filter(Boolean).join("; ");
}

/** Format a length without its unit, in whole millimetres or tenths of an inch; limits are rounded up, as in the sentences. */
function bare(value, round) {
  const { unit, factor } = unitOf("mm");
  const step = unit === "mm" ? 1 : 0.1;
  return value === undefined ? "" : grouped((round(value / factor / step - 1e-9) * step).toFixed(unit === "mm" ? 0 : 1));
}

function build(root, actions) {
  const parts = {
    form: element("form", { "aria-label": "Case", onsubmit: (event) => event.preventDefault() }),
    problem: element("p.problem", { role: "alert" }),
    card: element("div", {}, element("p.quiet", {}, "Computing ...")),
    warnings: element("div", {}),
    thicknesses: element("div", {}),
  };
  const results = [
    verdictSection(element("div.panel.head", {}, parts.problem, lostNote(), parts.card), element("div.panel.notes", {}, parts.warnings)),
    actions,
    element("section.panel.across", { "aria-label": "Thicknesses" }, parts.thicknesses),
  ];
  root.append(element("h1", {}, "Walls"), formBeside([presetLinks("walls"), parts.form], ...results));
  return parts;
}
