// What a downloaded file says of itself: its name, its title, the case and the key of the result.

import { shownNumber } from "./fields.js";

const MPA = { factor: 1e6 };
const MM = { factor: 1e-3 };

/**
 * Return a file name without its ending, as in `ricochet-238mps-39MPa-45deg-histories`.
 *
 * @param {{values: object, part?: string, hasAngle?: boolean, others?: object[]}} about `part` is what the file shows of
 *   the case; without `hasAngle` it is at no oblique angle; `others` are cases it is compared with, each with a `name`
 */
export function fileName({ values: { impact, target }, part, hasAngle, others = [] }) {
  const strength = shownNumber(MPA, target.compressive_strength_pa);
  const parts = [`${impact.velocity_m_s}mps`, `${strength}MPa`, hasAngle && `${impact.oblique_angle_deg}deg`, part, others.length && "compared"];
  return ["ricochet", ...parts.filter(Boolean)].join("-");
}

/** Return what pictures of one run and of those it is compared with say of themselves. */
export function aboutRuns([{ run }, ...others]) {
  return {
    values: run.values,
    key: [run, ...others.map((each) => each.run)].map(({ key }) => key).join(", "),
    hasAngle: true,
    others: others.map((each) => ({ name: each.name, values: each.run.values })),
  };
}

/** Return a case in a line. */
export function caseLine({ values: { impact, projectile, target, resistance }, hasAngle }) {
  const parts = [
    `${impact.velocity_m_s} m/s`,
    hasAngle && `${impact.oblique_angle_deg}° from the normal`,
    `${projectile.nose.shape} nose, ${shownNumber(MM, projectile.diameter_m)} mm × ${shownNumber(MM, projectile.length_m)} mm`,
    `${projectile.mass_kg} kg`,
    `${shownNumber(MPA, target.compressive_strength_pa)} MPa, ${target.density_kg_m3} kg/m³`,
    target.thickness_m !== undefined && `${shownNumber(MM, target.thickness_m)} mm thick`,
    resistance && `${resistance.free_surface?.model}, ${resistance.strength_factor?.model}`,
  ];
  return parts.filter(Boolean).join(", ");
}

/** Return CSV text below a header of comments: title, case and key. */
export function withHeader(csv, about) {
  const others = (about.others ?? []).map(({ name, values }) => `${name}: ${JSON.stringify(values)}`);
  const lines = [about.title, `case: ${JSON.stringify(about.values)}`, ...others, `key: ${about.key ?? "none"}`];
  return [...lines.map((line) => `# ${line}`), csv].join("\r\n");
}

/** Return a layout for a picture by itself: the title, the case and the key are above what is drawn. */
export function withTitle(layout, about) {
  const small = (text) => `<span style="font-size:11px">${text}</span>`;
  const others = (about.others ?? []).map(({ name, values }) => small(`${name}: ${caseLine({ ...about, values })}`));
  const keys = (about.key ?? "none").split(", ").map((key) => small(`key ${key}`));
  const text = [`<b>${about.title}</b>`, small(caseLine(about)), ...others, ...keys].join("<br>");
  const title = { text, x: 0, xref: "container", xanchor: "left", y: 1, yref: "container", yanchor: "top", font: { size: 15 } };
  return { ...layout, title: { ...title, pad: { l: 10, t: 42 } }, margin: { ...layout.margin, t: (layout.margin?.t ?? 8) + headPx(about) } };
}

/** Return the room that the title, the cases and the keys take. [px] */
export function headPx({ others = [] }) {
  return 108 + 36 * others.length;
}
