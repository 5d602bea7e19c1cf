// A collapsible section whose content is computed only while it is open, and cancelled when the case changes.

import { element } from "./elements.js";
import { latest } from "./latest.js";
import { clearParts, markFresh, markStale } from "./stale.js";

const REST_MS = 300; // pause without a change before computing, because the content takes many cases

/**
 * Build a collapsed section.
 *
 * @param {string} title
 * @param {HTMLElement} content
 * @param {(values: object, signal: AbortSignal) => Promise<void>} work computes and shows the content for a case
 * @param {(error: Error) => void} onError
 * @returns {{root: HTMLElement, setCase: (values: object) => void, hold: () => void, clear: () => void, stop: () => void}} `setCase`
 *   changes the case of the content, `hold` cancels its computation, `clear` empties it
 */
export function buildFold(title, content, work, onError) {
  let [wanted, shown] = [undefined, undefined];
  const compute = latest(
    async (values, signal) => {
      await work(values, signal);
      if (signal.aborted || values !== wanted) return;
      shown = values;
      markFresh(content);
    },
    onError,
    { supersede: true, restMs: REST_MS },
  );
  const refresh = () => {
    if (!root.open) compute.cancel();
    else if (wanted && wanted !== shown) {
      markStale(content);
      compute(wanted);
    }
  };
  const root = element("details.panel.fold", { ontoggle: refresh }, element("summary", {}, title), content);
  return {
    root,
    setCase(values) {
      wanted = values;
      content.setAttribute("aria-busy", "true");
      refresh();
    },
    hold: compute.cancel,
    clear() {
      wanted = undefined;
      if (shown) clearParts(content); // without a result there is nothing to clear, and `work` still needs the parts of the content
    },
    stop: compute.stop,
  };
}
