// A mark on what is shown but does not belong to the inputs: greyed, and busy for those who hear the page.

import { announce, announceQuietly, element } from "./elements.js";

const stale = new Set();

/** Mark parts of a view as those of inputs before; said in the status line. */
export function markStale(...parts) {
  mark(parts);
  announce("Out of date. Computing ...", true);
}

/** Mark parts of a view that are computed only when they are run; said in the status line. */
export function markUntilRun(...parts) {
  mark(parts);
  announce("Out of date. Run again.", true);
}

function mark(parts) {
  for (const part of parts) {
    part.setAttribute("aria-busy", "true");
    setDownloads(part, false);
    stale.add(part);
  }
}

/** Files of a picture are offered only while it is of the inputs. */
function setDownloads(part, isOffered) {
  for (const button of part.querySelectorAll(".downloads button")) button.disabled = !isOffered;
}

/** Note that a view waits for a study or a job, which a part of it stands for: it is not up to date, whatever else is. */
export function markPending(part) {
  stale.add(part);
}

/** Note that a study or a job has ended, or was given up. */
export function markSettled(part, words = "Up to date.") {
  stale.delete(part);
  if (!stale.size) announceQuietly(words);
}

/** Take the marks away: the parts are of the inputs that are shown. */
export function markFresh(...parts) {
  for (const part of parts) {
    part.removeAttribute("aria-busy");
    part.classList.remove("cleared");
    setDownloads(part, true);
    stale.delete(part);
  }
  for (const part of stale) if (!part.isConnected) stale.delete(part); // of a view that was left
  if (!stale.size) announceQuietly("Up to date.");
}

/** Take away the words of parts, as the inputs have no result; the pictures before stay, greyed and named as such. */
export function clearParts(...parts) {
  for (const part of parts) {
    part.classList.add("cleared");
    if (part.querySelector(".drawing, input")) {
      mark([part]);
      continue;
    }
    part.removeAttribute("aria-busy");
    stale.delete(part);
    part.replaceChildren(element("p.quiet", {}, "No result: a field is not accepted."));
  }
  announce("A field is not accepted. Nothing is computed.", true);
}
