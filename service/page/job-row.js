// A row of the table of jobs, which is updated in place so that the focus does not move.

import { names } from "./contract.js";
import { downloadButtons, shortId } from "./downloads.js";
import { element } from "./elements.js";
import { baseCase } from "./job-case.js";
import { isFinal, progressWords } from "./job-progress.js";
import { mapNameOf } from "./sweep.js";
import { grouped } from "./words.js";

/** Names of the columns; in a narrow window a row becomes a card, where each cell shows the name of its column. */
export const COLUMNS = ["Job", "Computation", "Status", "Cases", "Created", "Finished", "Kept until", "Results", "Actions"];
const TIME = new Intl.DateTimeFormat(undefined, { dateStyle: "short", timeStyle: "medium" });

/** The row of one job. */
export class JobRow {
  /**
   * @param {object} job
   * @param {{onCancel: (job: object) => void, onDelete: (job: object) => void, onRename: (job: object) => void, onError: (error: Error) => void}} listeners
   */
  constructor(job, { onCancel, onDelete, onRename, onError }) {
    const id = shortId(job.id);
    const act = (text, listener) =>
      element("button", { type: "button", "aria-label": `${text} job ${id}`, onclick: () => listener(this.job) }, text);
    this.bar = element("progress", { "aria-label": `Progress of job ${id}` });
    this.counts = element("span");
    this.cancel = act("Cancel", onCancel);
    this.cells = COLUMNS.map((name) => element("td", { role: "cell", "data-name": name }));
    this.root = element("tr", { role: "row" }, ...this.cells);
    const [name, operation, , progress, created, , , results, actions] = this.cells;
    this.title = element("strong", {}, titleOf(job));
    name.append(element("div", {}, this.title, " ", element("code", {}, id), ...(job.axes ? [baseCase(job, onError)] : [])));
    operation.append(names.operations[job.operation]);
    progress.append(element("div", {}, this.bar, this.counts));
    created.append(time(job.created));
    results.append(...downloadButtons(job.id, () => titleOf(this.job), onError));
    if (mapNameOf(job)) actions.append(element("a", { href: `#/map?job=${job.id}`, "aria-label": `Open job ${id} as a map` }, "Map"));
    actions.append(this.cancel, act("Rename", onRename), act("Delete", onDelete));
    this.update(job);
  }

  /** Update the row to a new state of the job. */
  update(job) {
    this.job = job;
    const ahead = job.queue?.jobs_ahead;
    const [, , status, , , finished, expires] = this.cells;
    this.title.textContent = titleOf(job);
    status.textContent = names.job_statuses[job.status] + (job.problem ? `: ${job.problem.detail}` : "") + (job.status === "accepted" && ahead ? `, ${ahead} ahead` : "");
    Object.assign(this.bar, { max: job.counts.total, value: job.counts.done });
    this.counts.textContent = progressWords(job);
    finished.replaceChildren(job.finished ? time(job.finished) : "");
    expires.replaceChildren(job.expires ? time(job.expires) : "");
    this.cancel.hidden = isFinal(job);
  }
}

/** Return the title that a job was given, or else what it computes. */
export function titleOf({ title, counts, operation }) {
  return title ?? `${grouped(counts.total)} × ${names.operations[operation]}`;
}

function time(text) {
  return element("time", { datetime: text }, TIME.format(new Date(text)));
}
