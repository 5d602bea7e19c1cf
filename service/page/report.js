// The report of a strike in a new tab, and its button.

import { announce, element } from "./elements.js";
import { isAbort, request } from "./service.js";

const WAIT = "The report is being computed: some 300 cases, half a minute to some minutes.";

/**
 * Return a button that opens the report of the case that `read` returns.
 *
 * @param {() => object} read
 * @param {(error: Error) => void} onError
 */
export function reportButton(read, onError) {
  const button = element("button", { type: "button" }, "Report");
  button.addEventListener("click", async () => {
    const tab = open("", "_blank"); // only a click may open one, so it is opened before the report is there
    if (tab) {
      tab.document.title = "Report";
      tab.document.body.textContent = WAIT;
    }
    button.disabled = true;
    announce(WAIT);
    try {
      const { data } = await request("report", { body: reportRequest(read()), as: "blob" });
      const address = URL.createObjectURL(data);
      if (tab && !tab.closed) tab.location.replace(address);
      announce("The report is in a new tab; print it from there.");
    } catch (error) {
      tab?.close();
      announce("");
      if (!isAbort(error)) onError(error);
    }
    button.disabled = false;
  });
  return button;
}

/** Return the body of `/report`: the case with the oblique angle that it has; a report does not take the paper's searches. */
function reportRequest({ output, ...values }) {
  return { ...values, search: { ...values.search, method: "outcome" } };
}
