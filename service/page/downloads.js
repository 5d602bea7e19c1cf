// Buttons that download the results of a job.

import { announce, save, taskButton } from "./elements.js";
import { slug } from "./exports.js";
import { request } from "./service.js";

const FORMS = {
  CSV: { type: "text/csv", ending: "csv" },
  JSONL: { type: "application/jsonl", ending: "jsonl" },
  HDF5: { type: "application/x-hdf5", ending: "h5" },
};

/**
 * Return buttons that download the results computed so far. Links would not do, because they cannot send the headers for format and key.
 *
 * @param {string} id of the job
 * @param {() => string} readTitle returns its current title
 * @param {(error: Error) => void} onError
 */
export function downloadButtons(id, readTitle, onError) {
  return Object.entries(FORMS).map(([name, { type, ending }]) => {
    const download = async () => {
      announce(`Preparing the ${name} file ...`);
      const { data } = await request(`jobs/${id}/results`, { headers: { Accept: type }, as: "blob" });
      save(data, `ricochet-${slug(readTitle())}.${ending}`, type);
      announce(`The ${name} file is downloaded.`);
    };
    return taskButton(name, { "aria-label": `${name} of job ${shortId(id)}` }, download, onError);
  });
}

/** Return the beginning of a job's ID, which is enough to distinguish jobs. */
export function shortId(id) {
  return id.slice(0, 8);
}
