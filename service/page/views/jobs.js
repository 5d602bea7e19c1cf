// The jobs: how far they are, their results, their end.

import { element, say } from "../elements.js";
import { shortId } from "../downloads.js";
import { isFinal, pause } from "../job-progress.js";
import { COLUMNS, JobRow } from "../job-row.js";
import { ask, isAbort } from "../service.js";

const [BUSY_MS, IDLE_MS] = [1000, 10_000]; // between two looks, while a job runs and while none does
const PAGE = 1000; // the most the service gives at once

/** Show the table of jobs, and keep it up to date. */
export async function show(root) {
  const view = new JobsView(root);
  view.watch();
  return () => view.leave();
}

/** Return all jobs, the newest first. */
async function allJobs(signal) {
  const jobs = [];
  let cursor = "";
  while (cursor !== undefined) {
    const { data } = await ask(`jobs?limit=${PAGE}&cursor=${cursor}`, { signal });
    jobs.push(...data.jobs);
    cursor = data.next;
  }
  return jobs;
}

class JobsView {
  #life = new AbortController();
  #rows = new Map();

  constructor(root) {
    this.problem = element("p.problem", { role: "alert", hidden: true });
    this.empty = element("p.quiet", { hidden: true }, "No jobs. A map becomes one, and so do large batches and sweeps.");
    const heads = COLUMNS.map((name) => element("th", { role: "columnheader", scope: "col" }, name));
    this.body = element("tbody", { role: "rowgroup" });
    const head = element("thead", { role: "rowgroup" }, element("tr", { role: "row" }, ...heads));
    this.table = element("table", { role: "table", hidden: true, "aria-label": "Jobs, the newest first" }, head, this.body);
    this.dialog = element("dialog", { "aria-labelledby": "delete-title" });
    root.append(
      element("h1", {}, "Jobs"),
      this.problem,
      element("div.panel.jobs", {}, this.empty, this.table),
      this.dialog,
    );
  }

  async watch() {
    const { signal } = this.#life;
    while (!signal.aborted) {
      let isBusy = false;
      try {
        const jobs = await allJobs(signal);
        isBusy = jobs.some((job) => !isFinal(job));
        this.#tell(jobs);
        this.problem.hidden = true;
      } catch (error) {
        this.#fail(error);
      }
      await pause(isBusy ? BUSY_MS : IDLE_MS, signal).catch(() => {});
    }
  }

  leave() {
    this.#life.abort();
    this.dialog.close();
  }

  #tell(jobs) {
    const before = this.#rows;
    const listeners = {
      onCancel: (job) => this.#cancel(job),
      onDelete: (job) => this.#delete(job),
      onError: (error) => this.#fail(error),
    };
    this.#rows = new Map(jobs.map((job) => [job.id, before.get(job.id) ?? new JobRow(job, listeners)]));
    for (const [id, { root }] of before) if (!this.#rows.has(id)) root.remove();
    let after = null;
    for (const job of [...jobs].reverse()) {
      const row = this.#rows.get(job.id);
      row.update(job);
      if (!row.root.isConnected) this.body.insertBefore(row.root, after);
      after = row.root;
    }
    this.table.hidden = !jobs.length;
    this.empty.hidden = jobs.length > 0;
  }

  async #cancel(job) {
    try {
      const { data } = await ask(`jobs/${job.id}/cancel`, { method: "POST" });
      this.#rows.get(job.id)?.update(data);
      say(`Job ${shortId(job.id)} is cancelled.`);
    } catch (error) {
      this.#fail(error);
    }
  }

  async #delete(job) {
    if (!(await this.#confirm(job))) return;
    try {
      await ask(`jobs/${job.id}`, { method: "DELETE" });
      const left = [...this.#rows.values()].map((row) => row.job).filter(({ id }) => id !== job.id);
      this.#tell(left);
      say(`Job ${shortId(job.id)} is deleted.`);
      document.getElementById("view").focus(); // the button that had it is gone
    } catch (error) {
      this.#fail(error);
    }
  }

  /** Ask whether a job shall be deleted; Escape keeps it. */
  #confirm(job) {
    return new Promise((resolve) => {
      const end = (answer) => () => {
        this.dialog.close();
        resolve(answer);
      };
      this.dialog.replaceChildren(
        element("h2", { id: "delete-title" }, `Delete job ${shortId(job.id)}?`),
        element("p", {}, "It is cancelled if it runs, and its results can no longer be downloaded here."),
        element("button.main", { type: "button", onclick: end(true) }, "Delete"),
        element("button", { type: "button", autofocus: true, onclick: end(false) }, "Keep"),
      );
      this.dialog.addEventListener("cancel", () => resolve(false), { once: true });
      this.dialog.showModal();
    });
  }

  #fail(error) {
    if (isAbort(error) || this.#life.signal.aborted) return;
    this.problem.textContent = error.message;
    this.problem.hidden = false;
  }
}
