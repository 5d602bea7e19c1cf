// Descriptions of downloaded files: the name, the title, the case and the key of the result.

import { withValue } from "./case.js";
import { names } from "./contract.js";
import { fieldAt, shownNumber, shownValue, withUnit } from "./fields.js";

const [SPEED, STRENGTH, ANGLE] = ["impact.velocity_m_s", "target.compressive_strength_pa", "impact.oblique_angle_deg"];
const MPA = { factor: 1e6 };

/**
 * Return a file name without its extension, such as `ricochet-238mps-39MPa-45deg-histories`.
 *
 * @param {{values: object, part?: string, hasAngle?: boolean, others?: object[], varied?: string[]}} about `part` names
 *   the content; with `hasAngle` the content is for the oblique angle of the case; `others` are cases compared with it, each
 *   with a `name`; `varied` are fields that vary, so that their values in the case are left out
 */
export function fileName({ values, part, hasAngle, others = [], varied = [] }) {
  const parts = [
    [SPEED, `${values.impact.velocity_m_s}mps`],
    [STRENGTH, `${shownNumber(MPA, values.target.compressive_strength_pa)}MPa`],
    [ANGLE, hasAngle && `${values.impact.oblique_angle_deg}deg`],
  ].map(([path, text]) => !varied.includes(path) && text);
  return ["ricochet", ...parts, part, others.length && "compared"].filter(Boolean).join("-");
}

/** Return text as part of a file name: letters, digits and full stops, with hyphens in place of all else. */
export function slug(text) {
  return text.replaceAll(/[^\p{L}\p{N}.]+/gu, "-").replaceAll(/^[-.]+|[-.]+$/g, "");
}

/** Return the description of a picture of one run and of the runs compared with it. */
export function aboutRuns([{ run }, ...others]) {
  return {
    values: run.values,
    key: [run, ...others.map((each) => each.run)].map(({ key }) => key).join(", "),
    hasAngle: true,
    others: others.map((each) => ({ name: each.name, values: each.run.values })),
  };
}

/** Describe a case in one line, in the units shown and without the fields that vary. */
export function caseLine({ values, hasAngle, varied = [] }) {
  const shown = (path, words) => {
    const field = fieldAt(path);
    const value = shownValue(field, values);
    if (varied.includes(path) || value === undefined) return "";
    return words(field.choices ? names.choices[path][value] : withUnit(value, field.unit));
  };
  const parts = [
    shown(SPEED, (speed) => speed),
    hasAngle && shown(ANGLE, (angle) => `${angle} from the normal`),
    shown("projectile.nose.shape", (nose) => `${nose} nose`),
    shown("projectile.diameter_m", (diameter) => `⌀ ${diameter}`),
    shown("projectile.length_m", (length) => `${length} long`),
    shown("projectile.mass_kg", (mass) => mass),
    shown(STRENGTH, (strength) => strength),
    shown("target.density_kg_m3", (density) => density),
    shown("target.thickness_m", (thickness) => `${thickness} thick`),
    shown("resistance.free_surface.model", (decay) => `free surface ${decay}`),
    shown("resistance.strength_factor.model", (law) => `S ${law}`),
  ];
  return parts.filter(Boolean).join(", ");
}

/** Return CSV text below comment lines with the title, the case without the fields that vary, and the key. */
export function withHeader(csv, { title, values, key, others = [], varied = [] }) {
  const fixed = varied.reduce((rest, path) => withValue(rest, path), values);
  const lines = [title, `case: ${JSON.stringify(fixed)}`, ...others.map((each) => `${each.name}: ${JSON.stringify(each.values)}`)];
  return [...lines, ...(key ? [`key: ${key}`] : [])].map((line) => `# ${line}`).concat(csv).join("\r\n");
}

/** Return the lines above a downloaded picture: the title, the cases and the keys. */
export function titleLines(about) {
  const others = (about.others ?? []).map(({ name, values }) => `${name}: ${caseLine({ ...about, values })}`);
  return [about.title, caseLine(about), ...others, ...(about.key ? about.key.split(", ").map((key) => `key ${key}`) : [])];
}
