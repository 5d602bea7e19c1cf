// The results of a job as files.

import { announce, save, taskButton } from "./elements.js";
import { slug } from "./exports.js";
import { request } from "./service.js";

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
    const download = async () => {
      announce(`${name} is being made ...`);
      const { data } = await request(`jobs/${id}/results`, { headers: { Accept: type }, as: "blob" });
      save(data, `ricochet-${slug(readTitle())}.${ending}`, type);
      announce(`${name} is downloaded.`);
    };
    return taskButton(name, { "aria-label": `${name} of job ${shortId(id)}` }, download, onError);
  });
}

/** Return the beginning of a job's name, enough to distinguish jobs. */
export function shortId(id) {
  return id.slice(0, 8);
}
