// Walls: the least thickness that stops a strike, by both models of the rear face and by the formulas of the field.

import { caseQuery, readCase, replaceAddress } from "../address.js";
import { withValue } from "../case.js";
import { element } from "../elements.js";
import { buildForm } from "../form.js";
import { latest } from "../latest.js";
import { presetLinks } from "../presets.js";
import { lostNote } from "../lost.js";
import { request } from "../service.js";
import { clearParts, markFresh, markStale } from "../stale.js";
import { digits, unbroken, warningList } from "../words.js";

const THICKNESS = "target.thickness_m";
const PLUG = "resistance.rear_plug";
const CRATER = "resistance.crater";
const NAMES = {
  modified_ndrc: "Modified NDRC",
  degen: "Degen",
  cea_edf: "CEA-EDF",
  ukaea: "UKAEA (Barr)",
  chang: "Chang",
  hughes: "Hughes",
  kar: "Kar",
  ace: "ACE",
  brl: "BRL",
  li_chen: "Li and Chen",
  whiffen: "Whiffen",
};
const COLUMNS = ["By", "Perforation limit [mm]", "Scabbing limit [mm]", "Penetration [mm]", "Range of the tests behind it"];
const STATUSES = {
  always_perforated: "perforated however thick",
  never_perforated: "never perforated",
};

/** Show the view. */
export async function show(root, query) {
  const parts = build(root);
  const shown = [parts.answer, parts.warnings, parts.table];
  const refuse = () => {
    parts.problem.textContent = "";
    updateResults.cancel();
    clearParts(...shown);
  };
  const fail = (error) => {
    refuse();
    parts.problem.textContent = error.errors ? form.showProblems(error) || "A field is not accepted." : error.message;
  };
  const updateResults = latest(async (values, signal) => {
    const post = async (path, body) => (await request(path, { body, signal })).data;
    const { projectile, target, impact, resistance, numerics } = values;
    const models = modelsOf({ projectile, target, impact, resistance, numerics });
    const thick = await Promise.all(models.map(({ body }) => post("thickness", withValue(body, THICKNESS))));
    const table = await post("formulas", withValue({ projectile, target, impact }, THICKNESS));
    const isWall = target.thickness_m !== undefined;
    const speeds = await Promise.all(isWall ? models.map(({ body }) => post("limit-speed", slow(body))) : []);
    if (signal.aborted || updateResults.isBehind()) return;
    const lines = models.map((model, i) => ({ ...model, thickness: thick[i], speed: speeds[i] }));
    parts.answer.replaceChildren(...answer(lines, table, target.thickness_m));
    parts.warnings.replaceChildren(...warningList(...thick.map(({ warnings }) => warnings)));
    parts.table.replaceChildren(tableOf(lines, table));
    markFresh(...shown);
  }, fail, { supersede: true });
  const refresh = (values) => {
    parts.problem.textContent = "";
    markStale(...shown);
    updateResults(values);
  };
  const form = buildForm(parts.form, {
    case: readCase(query),
    include: ["Strike", "Projectile", "Target", "Model"],
    open: matchMedia("(min-width: 60rem)").matches ? undefined : ["Strike"],
    onChange(values) {
      refresh(values);
      replaceAddress("walls", caseQuery(values));
    },
    onRefuse: refuse,
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

/** The body of `/limit-speed`: the speed is what is sought. */
function slow(body) {
  return withValue(body, "impact.velocity_m_s");
}

function answer(lines, { perforation_thickness_spread: spread }, thickness) {
  const [first, ...others] = lines;
  const also = others.map(({ name, thickness: found }) => `${name} ${thicknessShown(found)}`).join(", ");
  const range = spread
    ? ` Formulas within their range: ${millimetres(spread.lowest)} to ${millimetres(spread.highest)} mm.`
    : " No formula is within its range.";
  const shown = [
    element(
      "p",
      {},
      "Least thickness that is not perforated: ",
      element("strong.angle", {}, thicknessShown(first.thickness)),
      unbroken(`${also && `; ${also}`}.${range}`),
    ),
  ];
  if (thickness !== undefined) {
    const speeds = lines.map(({ name, speed }) => `${speedShown(speed)} (${name.toLowerCase()})`).join(", ");
    shown.push(element("p", {}, `Least speed that perforates a wall of ${millimetres(thickness)} mm: ${speeds}.`));
  }
  return shown;
}

function capital(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

function tableOf(lines, { formulas, scabbing_margin: scabbing, perforation_margin: perforation }) {
  const isNumber = (column) => column > 0 && column < COLUMNS.length - 1;
  const cell = (text, column) => element(isNumber(column) ? "td.number" : "td", {}, text);
  const row = (attributes, cells) => element("tr", attributes, ...cells.map(cell));
  const models = lines.map(({ name, thickness: found }) => row({}, [capital(name), thicknessShown(found, ""), "", "", ""]));
  const others = formulas.map((each) =>
    row({ class: each.in_range ? undefined : "quiet" }, [
      `${NAMES[each.formula] ?? each.formula}${each.verified ? "" : "\u00a0*"}`,
      millimetres(each.perforation_thickness_m),
      millimetres(each.scabbing_thickness_m),
      millimetres(each.penetration_depth_m),
      rangeShown(each),
    ]),
  );
  const title = (name, column) => element(isNumber(column) ? "th.number" : "th", { scope: "col" }, name);
  const head = element("tr", {}, ...COLUMNS.map(title));
  const caption = element("caption", {}, "By model and by formula, without margins");
  const table = element("table.thicknesses", {}, caption, element("thead", {}, head), element("tbody", {}, ...models, ...others));
  const note =
    "Limits are the least thickness that is not perforated and the least whose rear face sheds no concrete (scabbing); " +
    "penetration is the depth in thick concrete. Formulas have no angle: as is common practice, they take the normal component of the speed. DOE-STD-3014 requires " +
    `${scabbing} times the scabbing and ${perforation} times the perforation limit in a design. * Constants from secondary sources.`;
  return element(
    "div",
    {},
    element("div.wide", { tabindex: 0, role: "group", "aria-label": "Table of thicknesses" }, table),
    element("p.quiet", {}, note),
  );
}

function rangeShown({ in_range: isWithin, range_known: isKnown, out_of_range: outside, note }) {
  const reasons = outside.map(({ detail }) => detail).join("; ");
  const range = isWithin ? "within" : isKnown ? `outside: ${reasons}` : `not known${reasons && `; ${reasons}`}`;
  return note ? `${range}; ${note}` : range;
}

function thicknessShown({ status, least_thickness_m: found }, unit = " mm") {
  return found === undefined ? STATUSES[status] : `${millimetres(found)}${unit}`;
}

function speedShown({ status, limit_speed_m_s: found }) {
  return found === undefined ? STATUSES[status] : `${digits(found)} m/s`;
}

function millimetres(value) {
  return value === undefined ? "" : (1e3 * value).toFixed(0);
}

function build(root) {
  const parts = {
    form: element("form", { "aria-label": "Case", onsubmit: (event) => event.preventDefault() }),
    problem: element("p.problem", { role: "alert" }),
    answer: element("div.outcome", {}, element("p.quiet", {}, "Computing ...")),
    warnings: element("div", {}),
    table: element("div", {}),
  };
  parts.results = element(
    "div.pictures",
    {},
    parts.problem,
    lostNote(),
    element("section.panel", { "aria-label": "Answer" }, parts.answer, parts.warnings),
    element("section.panel", { "aria-label": "Thicknesses" }, parts.table),
  );
  root.append(element("h1", {}, "Walls"), element("div.sides", {}, element("div.panel", {}, presetLinks("walls"), parts.form), parts.results));
  return parts;
}
