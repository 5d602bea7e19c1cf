// The report of a strike in a new tab, and its button.

import { announce, element, save, taskButton } from "./elements.js";
import { fileName } from "./exports.js";
import { request } from "./service.js";
import { inUnits } from "./units.js";

const WAIT = "The report is being computed: about 550 cases, half a minute to a few minutes.";
const POLL_MS = 100;

/**
 * Return a button that opens the report of the case that `read` returns.
 *
 * @param {() => object} read
 * @param {(error: Error) => void} onError
 */
export function reportButton(read, onError) {
  const report = async () => {
    const tab = open("", "_blank"); // only a click may open one, so it is opened before the report is there
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

/** Show a report in a tab, below a bar that is not printed: back to the case, and the report as a file or as PDF. */
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

/** Return the body of `/report` and `/verdict`: the case with the oblique angle that it has; a report does not take the paper's searches. */
export function reportRequest({ output, ...values }) {
  return { ...values, search: { ...values.search, method: "outcome" } };
}
