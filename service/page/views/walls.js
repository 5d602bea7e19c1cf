// Walls: the least thickness that stops a strike, by the formulas of the field and by both models of the rear face.

import { caseQuery, readCase, replaceAddress } from "../address.js";
import { withValue } from "../case.js";
import { names } from "../contract.js";
import { element, table } from "../elements.js";
import { buildForm } from "../form.js";
import { latest } from "../latest.js";
import { presetLinks } from "../presets.js";
import { lostNote } from "../lost.js";
import { request } from "../service.js";
import { markFresh, markStale } from "../stale.js";
import { inShownUnits, unitOf } from "../units.js";
import { showCard } from "../verdict.js";
import { capital, lengthShown, quantityShown, statusShown, unbroken, warningList } from "../words.js";

const THICKNESS = "target.thickness_m";
const SPEED = "impact.velocity_m_s";
const PLUG = "resistance.rear_plug";
const CRATER = "resistance.crater";
const COLUMNS = ["By", "Perforation limit", "Scabbing limit", "Penetration", "Range of the tests behind it"];

/** Show the view. */
export async function show(root, query) {
  const parts = build(root);
  const shown = [parts.card, parts.model, parts.warnings, parts.table];
  const updateResults = latest(async (values, signal) => {
    const post = async (path, body) => (await request(path, { body, signal })).data;
    const { projectile, target, impact, resistance, numerics } = values;
    const models = modelsOf({ projectile, target, impact, resistance, numerics });
    const thick = await Promise.all(models.map(({ body }) => post("thickness", withValue(body, THICKNESS))));
    const table = await post("formulas", withValue({ projectile, target, impact }, THICKNESS));
    const isWall = target.thickness_m !== undefined;
    const speeds = await Promise.all(isWall ? models.map(({ body }) => post("limit-speed", withValue(body, SPEED))) : []);
    if (signal.aborted || updateResults.isBehind()) return;
    const lines = models.map((model, i) => ({ ...model, thickness: thick[i], speed: speeds[i] }));
    showCard(parts.card, verdictOf(table, target.thickness_m));
    parts.model.replaceChildren(...modelWords(lines, target.thickness_m));
    parts.warnings.replaceChildren(...warningList(...thick.map(({ warnings }) => warnings)));
    parts.table.replaceChildren(tableOf(lines, table));
    markFresh(...shown);
  }, (error) => form.fail(error), { supersede: true });
  const refresh = (values) => {
    markStale(...shown);
    updateResults(values);
  };
  const form = buildForm(parts.form, {
    case: readCase(query),
    include: ["Strike", "Target", "Projectile", "Model"], // the thickness, which is judged here, in sight
    open: matchMedia("(min-width: 60rem)").matches ? undefined : ["Strike", "Target"],
    onChange(values) {
      refresh(values);
      replaceAddress("walls", caseQuery(values));
    },
    onHold: () => updateResults.cancel(),
    problem: parts.problem,
    parts: () => shown,
  });
  refresh(form.currentCase());
  return () => updateResults.stop();
}

/** The case as it is, and where it has neither, with a plug and with a crater too. */
function modelsOf(body) {
  if (body.resistance?.rear_plug || body.resistance?.crater) return [{ name: "This model", body }];
  const plugged = withValue(body, PLUG, {});
  return [
    { name: "This model", body },
    { name: "with a plug at the rear", body: plugged },
    { name: "with a plug and a crater", body: withValue(plugged, CRATER, {}) },
  ];
}

/**
 * Return the verdict on a wall in words: the formulas of the field decide, with the margin of DOE-STD-3014.
 *
 * @param {object} table the answer to `/formulas`
 * @param {number|undefined} thickness of the wall [m]
 */
function verdictOf({ perforation_thickness_spread: spread, perforation_margin: margin }, thickness) {
  const wall = thickness === undefined ? "" : `${lengthShown(thickness, 6)}: `;
  if (!spread) {
    const sentence = `${wall}${wall ? "not known" : "No design value"}. No formula is within the range of its tests.`;
    return { sentence, figures: [] };
  }
  const design = margin * spread.highest;
  const [isEnough, isBetween] = [thickness >= design, thickness > spread.highest];
  const word = wall && (isEnough ? "enough. " : "not enough. ");
  return {
    sentence: `${wall}${word}Design value at least ${upwards(design)} (largest formula within its range × ${margin}).`,
    figures: [
      {
        name: wall ? `Wall of ${lengthShown(thickness, 6)}` : "Wall",
        value: wall ? (isEnough ? "Enough" : "Not enough") : "No thickness given",
        note: wall ? (isEnough ? "" : isBetween ? "above the formulas, below the margin" : "below the largest formula") : "fill in the thickness of the target",
      },
      { name: "Formulas within their range", value: `${bare(spread.lowest)} to ${thicknessShown({ least_thickness_m: spread.highest })}`, note: "not perforated, without a margin" },
      { name: `Largest × ${margin}`, value: upwards(design), note: "DOE-STD-3014" },
    ],
  };
}

/** Return a length rounded up to whole millimetres, or tenths of an inch: a design value is not rounded down. */
function upwards(value) {
  const { unit, factor } = unitOf("mm");
  const step = unit === "mm" ? 1 : 0.1;
  return `${Number((Math.ceil(value / factor / step - 1e-9) * step).toFixed(1)).toLocaleString("en")} ${unit}`;
}

/** Return what the model gives, which is not to be designed by. */
function modelWords(lines, thickness) {
  const thick = lines.map(({ name, thickness: found }) => `${name.toLowerCase()} ${thicknessShown(found)}`).join(", ");
  const words = [`Least thickness that is not perforated by the model, which is not a design value: ${thick}.`];
  words.push("From that thickness on, Explore shows the strike as embedded or as a ricochet; a wall is enough only if it has the design value.");
  if (thickness !== undefined) {
    const speeds = lines.map(({ name, speed }) => `${speedShown(speed)} (${name.toLowerCase()})`).join(", ");
    words.push(`Least speed that perforates a wall of ${lengthShown(thickness, 6)}: ${speeds}.`);
  }
  return words.map((text) => element("p", {}, unbroken(text)));
}

function tableOf(lines, { formulas, scabbing_margin: scabbing, perforation_margin: perforation }) {
  const isNumber = (column) => column > 0 && column < COLUMNS.length - 1;
  const models = lines.map(({ name, thickness: found }) => [capital(name), thicknessShown(found, false), "", "", ""]);
  const others = formulas.map((each) => [
    `${names.formulas[each.formula]}${each.verified ? "" : "\u00a0*"}`,
    bare(each.perforation_thickness_m),
    bare(each.scabbing_thickness_m),
    bare(each.penetration_depth_m),
    rangeShown(each),
  ]);
  const heads = COLUMNS.map((name, column) => (isNumber(column) ? `${name} [${unitOf("mm").unit}]` : name));
  const classes = formulas.map((each) => (each.in_range ? undefined : "quiet"));
  const rest = { caption: "By formula and by model, without margins", label: "Table of thicknesses", isNumber, classes };
  const note =
    "Limits are the least thickness that is not perforated and the least whose rear face sheds no concrete (scabbing); " +
    "penetration is the depth in thick concrete. Formulas have no angle: as is common practice, they take the normal component of the speed. DOE-STD-3014 requires " +
    `${scabbing} times the scabbing and ${perforation} times the perforation limit in a design. * Constants from secondary sources.`;
  return element("div", {}, table("table.thicknesses", { heads, rows: [...others, ...models], ...rest }), element("p.quiet", {}, note));
}

function rangeShown({ in_range: isWithin, range_known: isKnown, out_of_range: outside, note }) {
  const reasons = outside.map(({ detail }) => detail).join("; ");
  const range = isWithin ? "within" : isKnown ? `outside: ${reasons}` : `not known${reasons && `; ${reasons}`}`;
  return inShownUnits(note ? `${range}; ${note}` : range);
}

function thicknessShown({ status, least_thickness_m: found }, hasUnit = true) {
  if (found === undefined) return statusShown(status);
  return hasUnit ? `${bare(found)} ${unitOf("mm").unit}` : bare(found);
}

function speedShown({ status, limit_speed_m_s: found }) {
  return found === undefined ? statusShown(status) : quantityShown(found, "m/s");
}

function bare(value) {
  const { unit, factor } = unitOf("mm");
  return value === undefined ? "" : (value / factor).toFixed(unit === "mm" ? 0 : 1);
}

function build(root) {
  const parts = {
    form: element("form", { "aria-label": "Case", onsubmit: (event) => event.preventDefault() }),
    problem: element("p.problem", { role: "alert" }),
    card: element("div.card", {}, element("p.quiet", {}, "Computing ...")),
    model: element("div"),
    warnings: element("div", {}),
    table: element("div", {}),
  };
  const results = element(
    "div.pictures",
    {},
    element("section.panel.verdict", { "aria-label": "Verdict" }, parts.problem, lostNote(), parts.card, parts.model, parts.warnings),
    element("section.panel", { "aria-label": "Thicknesses" }, parts.table),
  );
  root.append(element("h1", {}, "Walls"), element("div.sides", {}, element("div.panel", {}, presetLinks("walls"), parts.form), results));
  return parts;
}
