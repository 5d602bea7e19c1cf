// Cases to begin with.

import { address, caseQuery } from "./address.js";
import { paperCase } from "./contract.js";
import { element } from "./elements.js";

/** Each as it differs from the paper's case; the masses of rod and cone are those of solid steel. */
const PRESETS = {
  "The paper's strike": {},
  "155 mm body": {
    projectile: { nose: { shape: "ogive", caliber_radius_head: 2.5 }, diameter_m: 0.155, length_m: 0.7, mass_kg: 43 },
    impact: { velocity_m_s: 300, oblique_angle_deg: 45 },
  },
  "Flat rod": {
    projectile: { nose: { shape: "flat" }, diameter_m: 0.02, length_m: 0.2, mass_kg: 0.49 },
    impact: { velocity_m_s: 300, oblique_angle_deg: 60 },
  },
  Cone: {
    projectile: { nose: { shape: "conical", length_to_diameter: 1.5 }, diameter_m: 0.05, length_m: 0.3, mass_kg: 3.9 },
    impact: { velocity_m_s: 300, oblique_angle_deg: 55 },
  },
};

/** Return links that show a view with each of the cases. */
export function presetLinks(view) {
  const links = Object.entries(PRESETS).map(([name, parts]) =>
    element("a", { href: address(view, caseQuery({ ...paperCase(), ...parts })) }, name),
  );
  return element("p.presets", { role: "group", "aria-label": "Start from" }, "Start from: ", ...links);
}
