// Units: those in which the page shows quantities, SI or US customary, and those that may be typed.

import { keep, kept } from "./storage.js";

const STORED = "ricochet-units";
const KINDS = {
  speed: { "m/s": 1, "km/s": 1e3, "km/h": 1 / 3.6, "ft/s": 0.3048, fps: 0.3048, mph: 0.44704 },
  length: { m: 1, cm: 0.01, mm: 1e-3, in: 0.0254, '"': 0.0254, ft: 0.3048 },
  mass: { kg: 1, g: 1e-3, t: 1e3, lb: 0.45359237, lbs: 0.45359237, oz: 0.028349523125 },
  pressure: { Pa: 1, kPa: 1e3, MPa: 1e6, GPa: 1e9, bar: 1e5, psi: 6894.757293168, ksi: 6894757.293168 },
  density: { "kg/m³": 1, "kg/m3": 1, "g/cm³": 1e3, "g/cm3": 1e3, "lb/ft³": 16.018463373960142, "lb/ft3": 16.018463373960142 },
  inertia: { "kg m²": 1, "kg m2": 1, "lb ft²": 0.042140110093804, "lb ft2": 0.042140110093804 },
  share: { "%": 0.01, weight: 1 },
  angle: { "°": 1, deg: 1, rad: 180 / Math.PI },
  turning: { "rad/s": 1, "°/s": Math.PI / 180, "deg/s": Math.PI / 180, rpm: Math.PI / 30 },
  force: { N: 1, kN: 1e3, MN: 1e6, lbf: 4.4482216152605, kip: 4448.2216152605 },
  energy: { J: 1, kJ: 1e3, MJ: 1e6, "ft lbf": 1.3558179483314 },
};
/** US customary units that replace units of SI. */
const US = { "m/s": "ft/s", m: "ft", mm: "in", kg: "lb", MPa: "psi", GPa: "ksi", "kg/m³": "lb/ft³", "kg m²": "lb ft²", kN: "kip", kJ: "ft lbf", J: "ft lbf", N: "lbf", Pa: "psi" };
const COLUMN = /_(m_s|kg_m3|kg_m2|m|kg|pa|n_m|n|j)$/;
const COLUMNS = { m_s: ["ft_s", 0.3048], kg_m3: ["lb_ft3", 16.018463373960142], kg_m2: ["lb_ft2", 0.042140110093804], m: ["in", 0.0254], kg: ["lb", 0.45359237], pa: ["psi", 6894.757293168], n_m: ["ft_lbf", 1.3558179483314], n: ["lbf", 4.4482216152605], j: ["ft_lbf", 1.3558179483314] };

/** Names of the systems of units in addresses and requests. */
export const SYSTEMS = ["si", "us"];

let isUs = kept(STORED) === "us";

/** Follow a <select> of the units; `onChange` is called when the user chooses other units. */
export function followUnits(select, onChange) {
  select.value = isUs ? "us" : "si";
  select.addEventListener("change", () => {
    isUs = select.value === "us";
    keep(STORED, select.value);
    onChange();
  });
}

/** Show the units that an address names, if any, without storing them as the user's choice. */
export function showUnits(name, select) {
  if (!SYSTEMS.includes(name)) return;
  isUs = name === "us";
  select.value = name;
}

/** Return whether US customary units are shown. */
export function areUs() {
  return isUs;
}

/** Add the units shown to the body of a request, so that the texts of its answer or its refusal use them. */
export function inUnits(body) {
  return { ...body, units: isUs ? "us" : "si" };
}

/** Return the unit shown for a unit of SI, and its factor to the unit without prefix: 1e-3 for mm. */
export function unitOf(si) {
  const unit = isUs ? (US[si] ?? si) : si;
  return { unit, factor: kindOf(si)?.[unit] ?? 1 };
}

/**
 * Read a number with a decimal point or comma and, if it has one, a unit: `250,5`, `5656 psi`, `1,200.5 mm`.
 *
 * A comma before three digits, as in `2,500` but not in `0,125`, separates thousands; any other single comma is a decimal comma.
 *
 * @returns {{value?: number, wrong?: string, note?: string}} `value` in SI; a number without a unit is in the one shown;
 *   `note` says how an ambiguous number was read
 */
export function readQuantity(text, si) {
  const [, digits, name] = text.replaceAll("−", "-").trim().match(/^([-+]?[\d.,'\s]*(?:e[-+]?\d+)?)\s*(.*)$/i);
  const bare = digits.replace(/['\s]/g, "");
  const isThousands = /^[-+]?[1-9]\d{0,2},\d{3}$/.test(bare);
  const isGrouped = isThousands || /,.*[,.]/.test(bare); // such as 1,200.5
  const value = Number(isGrouped ? bare.replaceAll(",", "") : bare.replace(/,(?=\d*(e|$))/i, "."));
  if (!bare || !Number.isFinite(value)) return { wrong: `${JSON.stringify(text)} is not a number` };
  const known = kindOf(si) ?? {};
  const unit = name.trim().replaceAll("·", " ").replaceAll("^", "") || unitOf(si).unit;
  const found = Object.keys(known).find((each) => each === unit) ?? Object.keys(known).find((each) => each.toLowerCase() === unit.toLowerCase());
  if (unit && !found) return { wrong: `${JSON.stringify(name.trim())} is not a unit here${si ? `, as ${unitOf(si).unit} is` : ""}` };
  const note = isThousands ? `${bare} is read as ${bare.replace(",", "")}; for a fraction type ${bare.replace(",", ".")}` : undefined;
  return { value: Number((value * (known[found] ?? 1)).toPrecision(15)), note };
}

/** Convert columns in SI, whose names end with their unit, to the units shown. */
export function inShownColumns(columns) {
  if (!isUs) return columns;
  const entries = Object.entries(columns).map(([name, values]) => {
    const [unit, factor] = COLUMNS[name.match(COLUMN)?.[1]] ?? [];
    if (!unit) return [name, values];
    const shown = values.map((value) => (typeof value === "number" ? Number((value / factor).toPrecision(12)) : value));
    return [name.replace(COLUMN, `_${unit}`), shown];
  });
  return Object.fromEntries(entries);
}

function kindOf(si) {
  return Object.values(KINDS).find((units) => si in units);
}
