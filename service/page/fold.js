// A folded section whose content is computed only while it is open, and given up when the input moves on.

import { element } from "./elements.js";
import { latest } from "./latest.js";
import { clearParts, markFresh, markStale } from "./stale.js";

const REST_MS = 300; // without a change before anything is computed: these are many cases

/**
 * Build a section.
 *
 * @param {string} title
 * @param {HTMLElement} content
 * @param {(values: object, signal: AbortSignal) => Promise<void>} work computes and shows the content for a case
 * @param {(error: Error) => void} onError
 * @returns {{root: HTMLElement, setCase: (values: object) => void, hold: () => void, clear: () => void, stop: () => void}} `setCase`
 *   makes the content that of another case, `clear` that of none
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
      if (shown) clearParts(content); // else there is nothing to clear, and what is shown later needs its parts
    },
    stop: compute.stop,
  };
}
