// Marks results that do not belong to the current inputs: they are greyed, and busy for screen readers.

import { announce, announceQuietly, element } from "./elements.js";

const stale = new Set();

/** Mark parts of a view as results of previous inputs, and say so in the status line. */
export function markStale(...parts) {
  mark(parts);
  announce("Out of date. Computing ...", true);
}

/** Mark parts of a view that stay out of date until the user runs them again, and say so in the status line. */
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

/** Enable or disable the downloads of a picture, which are offered only while it belongs to the inputs. */
function setDownloads(part, isOffered) {
  for (const button of part.querySelectorAll(".downloads button")) button.disabled = !isOffered;
}

/** Record that a view waits for a study or a job, represented by one of its parts; until that ends, the view is not up to date. */
export function markPending(part) {
  stale.add(part);
}

/** Record that a study or a job has ended or was cancelled. */
export function markSettled(part, words = "Up to date.") {
  stale.delete(part);
  if (!stale.size) announceQuietly(words);
}

/** Remove the marks of parts that belong to the current inputs. */
export function markFresh(...parts) {
  for (const part of parts) {
    part.removeAttribute("aria-busy");
    part.classList.remove("cleared");
    setDownloads(part, true);
    stale.delete(part);
  }
  for (const part of stale) if (!part.isConnected) stale.delete(part); // the view was left
  if (!stale.size) announceQuietly("Up to date.");
}

/** Remove the text of parts, because the inputs have no result; previous pictures stay, greyed and labelled as such. */
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
