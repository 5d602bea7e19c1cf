// The results of a job as files.

import { announce, element, save } from "./elements.js";
import { slug } from "./exports.js";
import { isAbort, request } from "./service.js";

const FORMS = {
  CSV: { type: "text/csv", ending: "csv" },
  JSONL: { type: "application/jsonl", ending: "jsonl" },
  HDF5: { type: "application/x-hdf5", ending: "h5" },
};

/**
 * Return buttons that download what is ready of a job. Not links: the form is requested by a header, as is the key.
 *
 * @param {string} id of the job
 * @param {() => string} readTitle returns its title as it is now
 * @param {(error: Error) => void} onError
 */
export function downloadButtons(id, readTitle, onError) {
  return Object.entries(FORMS).map(([name, { type, ending }]) => {
    const button = element("button", { type: "button", "aria-label": `${name} of job ${shortId(id)}` }, name);
    button.addEventListener("click", async () => {
      button.disabled = true;
      announce(`${name} is being made ...`);
      try {
        const { data } = await request(`jobs/${id}/results`, { headers: { Accept: type }, as: "blob" });
        save(data, `ricochet-${slug(readTitle())}.${ending}`, type);
        announce(`${name} is downloaded.`);
      } catch (error) {
        announce("");
        if (!isAbort(error)) onError(error);
      }
      button.disabled = false;
    });
    return button;
  });
}

/** Return the beginning of a job's name, enough to distinguish jobs. */
export function shortId(id) {
  return id.slice(0, 8);
}
