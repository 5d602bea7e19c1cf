// A button that opens the report of a strike in a new tab.

import { linkButton } from "./copy-as.js";
import { announce, caseActions, element, save, taskButton } from "./elements.js";
import { fileName } from "./exports.js";
import { request } from "./service.js";
import { inUnits } from "./units.js";

const WAIT = "The report is being computed: about 550 cases, half a minute to a few minutes.";
const POLL_MS = 100;

/** Return the buttons that act on the case returned by `read`: `others`, then those of its report and its link. */
export function strikeActions(read, onError, ...others) {
  return caseActions("This case", element("p.actions", {}, ...others, reportButton(read, onError), linkButton()));
}

/** Return a button that opens the report of the case returned by `read`. */
function reportButton(read, onError) {
  const report = async () => {
    const tab = open("", "_blank"); // browsers allow this only during a click, so the tab opens before the report arrives
    if (tab) {
      tab.document.title = "Report";
      tab.document.body.textContent = WAIT;
    }
    announce(WAIT);
    const [values, back] = [read(), location.href];
    try {
      const { data } = await request("report", { body: inUnits(reportRequest(values)), as: "blob" });
      if (tab && !tab.closed) showIn(tab, data, values, back);
      announce("The report is in a new tab; print it from there.");
    } catch (error) {
      tab?.close();
      throw error;
    }
  };
  return taskButton("Report", {}, report, onError);
}

/** Show a report in a tab, below a bar that leads back to the case and saves the report as a file or PDF; it is not printed. */
function showIn(tab, report, values, back) {
  const url = URL.createObjectURL(report);
  tab.location.replace(url);
  const timer = setInterval(() => {
    if (tab.closed) return clearInterval(timer);
    if (tab.location.href !== url || tab.document.readyState !== "complete") return undefined;
    clearInterval(timer);
    const name = `${fileName({ values, part: "report", hasAngle: true })}.html`;
    const button = (text, onclick) => element("button", { type: "button", onclick }, text);
    const bar = element(
      "p",
      {},
      element("a", { href: back }, "Back to this case"),
      " ",
      button("Save as a file", () => save(report, name, "text/html")),
      " ",
      button("Print, or save as PDF", () => tab.print()),
    );
    tab.document.body.prepend(bar);
    for (const [event, hidden] of [["beforeprint", true], ["afterprint", false]]) tab.addEventListener(event, () => (bar.hidden = hidden));
    return undefined;
  }, POLL_MS);
}

/** Return the body for `/report` and `/verdict`: the case with its oblique angle, and `outcome` as the only method that they accept. */
export function reportRequest({ output, ...values }) {
  return { ...values, search: { ...values.search, method: "outcome" } };
}
