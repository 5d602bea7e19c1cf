// Copies the current case as a curl command or a Python program.

import { angleRequest, trajectoryRequest } from "./case.js";
import { announce, caseActions, element } from "./elements.js";
import { locate } from "./service.js";

/** Return the curl command that posts a request to a path. */
function curl(request, path) {
  const body = JSON.stringify(request, null, 2).replaceAll("'", "'\\''");
  return `curl -s ${locate(path)} -H 'Content-Type: application/json' -d '${body}'\n`;
}

/** Return a Python program that requests the trajectory and the critical angle of a case. */
function python(values) {
  return `import httpx

service = ${JSON.stringify(locate(""))}
trajectory = ${literal(trajectoryRequest(values))}
angle = ${literal(angleRequest(values))}

answer = httpx.post(service + "trajectory", json=trajectory, timeout=60.0).raise_for_status().json()
print(answer["outcome"], answer.get("maximum_depth_m"))
answer = httpx.post(service + "cra", json=angle, timeout=60.0).raise_for_status().json()
print(answer["status"], answer.get("critical_angle_deg"))
`;
}

/**
 * Return buttons that copy the case returned by `read`, and show the copied text.
 *
 * @returns {{root: HTMLElement, actions: HTMLFieldSetElement, clear: () => void}} `actions` hold the buttons; `clear` hides the copied text,
 *   for when the case changes
 */
export function copyButtons(read) {
  const shown = element("pre", { hidden: true, tabindex: 0, "aria-label": "Copied text" });
  const button = (text, make) =>
    element("button", { type: "button", onclick: () => copy(make(read()), text, shown) }, `Copy ${text}`);
  const buttons = [
    button("as curl", (values) => curl(trajectoryRequest(values), "/trajectory")),
    button("search as curl", (values) => curl(angleRequest(values), "/cra")),
    button("as Python", python),
  ];
  const actions = caseActions("Copy", element("div", {}, element("div.actions", {}, ...buttons), shown));
  const root = element("section.panel.copy", {}, element("h2", {}, "Copy this case"), actions);
  return { root, actions, clear: () => shown.toggleAttribute("hidden", true) };
}

/** Return a button that copies the address of what is shown. */
export function linkButton() {
  const shown = element("input", { type: "text", readonly: true, hidden: true, "aria-label": "Link to this case" });
  const button = element("button", { type: "button", onclick: () => copy(location.href, "the link", shown) }, "Copy link");
  return element("span", {}, button, shown);
}

async function copy(text, what, shown) {
  shown[shown.matches("input") ? "value" : "textContent"] = text;
  shown.hidden = false;
  try {
    await navigator.clipboard.writeText(text); // browsers allow it only over https or on localhost
    announce(`Copied ${what}.`);
  } catch {
    announce("The browser does not allow the page to copy; the text is shown beside the buttons.");
  }
}

/** Return a value as a Python literal, which is JSON except for the names of three constants. */
const literal = (value) => JSON.stringify(value, null, 4).replace(/: (true|false|null)\b/g, (_, word) => `: ${WORDS[word]}`);

const WORDS = { true: "True", false: "False", null: "None" };
