// Cases to start from: presets, and cases that the user saved by name in this browser.

import { address, caseOf, caseQuery, readAddress } from "./address.js";
import { paperCase } from "./contract.js";
import { announce, element } from "./elements.js";
import { keep, kept } from "./storage.js";

const STORED = "ricochet-cases";
/**
 * Differences of each preset from the paper's case. The paper reports four tests of its own strike, which give the scatter of S
 * in its preset; the rod, the sphere and the cone have the mass of solid steel.
 */
const PRESETS = {
  "The paper's strike": { strength_scatter: "paper_table_1" },
  "155 mm body": {
    projectile: { nose: { shape: "ogive", caliber_radius_head: 2.5 }, diameter_m: 0.155, length_m: 0.7, mass_kg: 43 },
    impact: { velocity_m_s: 300, oblique_angle_deg: 45 },
  },
  "Flat rod": {
    projectile: { nose: { shape: "flat" }, diameter_m: 0.02, length_m: 0.2, mass_kg: 0.49 },
    impact: { velocity_m_s: 300, oblique_angle_deg: 60 },
  },
  "Steel sphere": {
    projectile: { nose: { shape: "sphere" }, diameter_m: 0.02, length_m: 0.02, mass_kg: 0.0329 },
    impact: { velocity_m_s: 800, oblique_angle_deg: 60 },
  },
  Cone: {
    projectile: { nose: { shape: "conical", length_to_diameter: 1.5 }, diameter_m: 0.05, length_m: 0.3, mass_kg: 3.9 },
    impact: { velocity_m_s: 300, oblique_angle_deg: 55 },
  },
};

/** Return links that show a view with each of these cases, and a form that saves the case of the address by name. */
export function presetLinks(view) {
  const links = Object.entries(PRESETS).map(([name, parts]) =>
    element("a", { href: address(view, caseQuery({ ...paperCase(), ...parts })) }, name),
  );
  const list = element("span.kept");
  const name = element("input", { type: "text", required: true, "aria-label": "Name of the case", placeholder: "Name" });
  const write = (cases, words) => {
    keep(STORED, JSON.stringify(cases));
    announce(words);
    show();
  };
  const save = (event) => {
    event.preventDefault();
    const text = name.value.trim();
    write({ ...read(), [text]: caseOf(readAddress(location.hash).query).toString() }, `Saved as ${text} in this browser.`);
    name.value = "";
  };
  const forget = (each) => {
    const { [each]: _, ...others } = read();
    write(others, `${each} is no longer saved.`);
  };
  const show = () => {
    const lines = Object.entries(read()).map(([each, query]) =>
      element("span", {},
        element("a", { href: address(view, new URLSearchParams(query)) }, each),
        element("button", { type: "button", "aria-label": `Forget ${each}`, onclick: () => forget(each) }, "×"),
      ),
    );
    list.replaceChildren(...lines);
  };
  show();
  const form = element("form.actions", { onsubmit: save, "aria-label": "Save this case" }, name, element("button", {}, "Save"));
  const saved = element("details.saved", {}, element("summary", {}, "Saved cases"), list, form);
  return element("div", {}, element("p.presets", { role: "group", "aria-label": "Start from" }, "Start from: ", ...links), saved);
}

/** Return the queries of the saved cases by name, without damaged entries. */
function read() {
  try {
    const cases = JSON.parse(kept(STORED) ?? "{}");
    return Object.fromEntries(Object.entries(cases ?? {}).filter(([, query]) => typeof query === "string"));
  } catch {
    return {};
  }
}
