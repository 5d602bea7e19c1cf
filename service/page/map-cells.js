// Results of the cells of a map, and texts that describe them.

import { csvOf } from "./plots.js";
import { grouped, lengthShown, outcomeShown, statusShown, warningShown } from "./words.js";

/** Quantities that a map shows by colours, by operation: `column` is the name in CSV, `si` the unit when SI is shown. Outcomes have none. */
export const QUANTITIES = {
  cra: { label: "Critical angle", si: "°", name: "an angle", column: "critical_angle_deg", of: ({ angle }) => angle },
  thickness: { label: "Least thickness", si: "mm", name: "a thickness", column: "least_thickness_m", of: ({ thickness }) => thickness },
  probability: { label: "Probability of ricochet", si: "", name: "a probability", column: "ricochet_probability", of: ({ probability }) => probability, range: [0, 1] },
};

/** Ending, on a map, of an embedded run whose nose protrudes from the rear face of a wall. */
const OUT = "embedded_out";

/** Symbol in the legend for endings whose cells have a colour but no mark, so that the labels of contours can be read there. */
export const PLAIN = "square";

/** Endings that a map distinguishes, each with its mark. */
export const ENDINGS = {
  cra: { no_ricochet: "x", always_ricochet: "circle", not_converged: "diamond", failed: "cross" },
  thickness: { always_perforated: "x", never_perforated: "circle", failed: "cross" },
  probability: { failed: "cross" },
  trajectory: { embedded: PLAIN, [OUT]: "triangle-up", perforated: "triangle-down", in_motion: "diamond", ricochet: PLAIN, failed: "cross" },
};

/** Return the display name of an ending. */
export function endingShown(ending) {
  if (ending === OUT) return `${outcomeShown("embedded")}, its nose out of the rear face`;
  return outcomeShown(ending) ?? statusShown(ending) ?? ending;
}

/**
 * Return the values of one result that a map shows.
 *
 * @param {{result?: object, problem?: object}} item of a job
 * @returns {{ending: string, angle?: number, probability?: number, depth?: number, thickness?: number, stress?: number, warnings: string[], key?: string, detail?: string}}
 *   `angle` in degrees, `depth` and `thickness` in metres, `stress` the largest bending stress in pascals
 */
export function readCell({ result, problem }) {
  if (!result) return { ending: "failed", warnings: [], detail: problem?.detail };
  return {
    ending: result.outcome === "embedded" && result.protrusion?.final_m ? OUT : (result.status ?? result.outcome ?? "converged"),
    // Only searches have a status; their outcomes, on a wall, are ranges of angles instead of probabilities.
    probability: result.status ? undefined : result.outcomes && (result.outcomes.find(({ outcome }) => outcome === "ricochet")?.value ?? 0),
    angle: result.critical_angle_deg,
    depth: result.outcome && result.maximum_depth_m,
    thickness: result.least_thickness_m,
    stress: result.bending?.peak_stress_pa,
    warnings: [...new Set(result.warnings.filter(({ standing }) => !standing).map(({ code }) => code))],
    key: result.key,
  };
}

/** Describe the result of a cell. */
export function cellWords(cell) {
  if (!cell) return "not computed";
  const label = endingShown(cell.ending);
  if (cell.ending === "failed") return `${label}: ${cell.detail}`;
  if (cell.probability !== undefined) return `ricochet with a probability of ${cell.probability.toFixed(2)}`;
  if (cell.thickness !== undefined) return `stopped by ${lengthShown(cell.thickness)} by this model, not a design value`;
  const words = cell.angle === undefined ? label : `ricochet from ${cell.angle.toFixed(2)}° on`;
  return cell.depth === undefined || cell.ending === "perforated" ? words : `${words}, ${lengthShown(cell.depth)} deep`;
}

/** Return the codes of warnings that some cells have and others do not, each with the number of cells that have it. */
export function localWarnings(cells) {
  const computed = cells.filter(Boolean);
  const counts = new Map();
  for (const { warnings } of computed) for (const code of warnings) counts.set(code, (counts.get(code) ?? 0) + 1);
  return [...counts].filter(([, count]) => count < computed.length);
}

/** Return the codes of warnings that fewer than a quarter of the cells have; only these are marked. */
export function rareWarnings(cells) {
  const computed = cells.filter(Boolean).length;
  return new Set(localWarnings(cells).flatMap(([code, count]) => (count < computed / 4 ? [code] : [])));
}

/** Describe how many cells have each ending, and each warning. */
export function countWords(operation, cells) {
  const counts = {};
  for (const cell of cells) if (cell) counts[cell.ending] = (counts[cell.ending] ?? 0) + 1;
  const words = Object.entries(counts).map(([ending, count]) => {
    const label = ending === "converged" ? `with ${QUANTITIES[operation].name}` : endingShown(ending);
    return `${grouped(count)} ${label}`;
  });
  const warnings = localWarnings(cells).map(([code, count]) => `${warningShown(code)} (${grouped(count)})`);
  return words.join(", ") + (warnings.length ? `; warnings of some: ${warnings.join(", ")}` : "");
}

/** Return the cells as CSV, in the units shown. */
export function cellsCsv(operation, [x, y], cells) {
  const found = [...cells.keys()].filter((index) => cells[index]);
  const column = (value) => found.map((index) => value(cells[index]));
  const quantity = QUANTITIES[operation];
  return csvOf({
    [x.field]: found.map((index) => x.values[index % x.values.length]),
    [y.field]: found.map((index) => y.values[Math.floor(index / x.values.length)]),
    [quantity ? "status" : "outcome"]: column(({ ending }) => (ending === OUT ? "embedded" : ending)),
    [quantity?.column ?? "maximum_depth_m"]: column(quantity?.of ?? (({ depth }) => depth)),
    warnings: column(({ warnings }) => warnings.join(" ")),
    key: column(({ key }) => key),
  });
}
