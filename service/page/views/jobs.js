// Jobs: their progress and results, and the submission of new ones.

import { readCase } from "../address.js";
import { names } from "../contract.js";
import { shortId } from "../downloads.js";
import { acceptDroppedFile, announce, element } from "../elements.js";
import { isFinal, submit } from "../job-progress.js";
import { COLUMNS, JobRow, titleOf } from "../job-row.js";
import { pause } from "../lost.js";
import { casesOf } from "../pasted-cases.js";
import { isAbort, request } from "../service.js";

const [BUSY_MS, IDLE_MS] = [1000, 10_000]; // polling intervals while a job runs, and while none does
const PAGE = 50; // jobs in each request

/** Show the table of jobs, and keep it up to date. */
export async function show(root, query) {
  const view = new JobsView(root, readCase(query));
  view.watch();
  return () => view.leave();
}

class JobsView {
  #life = new AbortController();
  #rows = new Map();
  #older; // cursor of the older jobs that are not shown; undefined if all are shown

  constructor(root, base) {
    this.base = base; // gives the fields for which a pasted table has no column
    this.problem = element("p.problem", { role: "alert", hidden: true });
    this.empty = element("p.quiet", { hidden: true }, "No jobs. Paste a table of cases above, or run a map.");
    const heads = COLUMNS.map((name) => element("th", { role: "columnheader", scope: "col" }, name));
    this.body = element("tbody", { role: "rowgroup" });
    const head = element("thead", { role: "rowgroup" }, element("tr", { role: "row" }, ...heads));
    this.table = element("table", { role: "table", hidden: true, "aria-label": "Jobs, the newest first" }, head, this.body);
    this.more = element("button", { type: "button", onclick: () => this.#try(() => this.#loadOlder()) }, "Load older jobs");
    this.count = element("p.quiet", {});
    this.dialog = element("dialog", { "aria-labelledby": "dialog-title" });
    root.append(
      element("h1", {}, "Jobs"),
      this.problem,
      this.#tableForm(),
      element("div.panel.jobs", {}, this.empty, this.table, element("p.actions", {}, this.count, this.more)),
      this.dialog,
    );
  }

  /** Build the form that submits a table of cases as a job. */
  #tableForm() {
    const text = element("textarea", { id: "cases", rows: 5, required: true, spellcheck: "false", placeholder: "velocity_m_s,oblique_angle_deg\n238,45\n300,50" });
    const options = ["trajectory", "cra"].map((value) => element("option", { value }, names.operations[value]));
    const operation = element("select", { "aria-label": "What is computed" }, ...options);
    const note =
      "A header of fields in SI, such as velocity_m_s or projectile.length_m, and up to 1000 cases, one in each row. Fields without a column are those of the case in the other views.";
    acceptDroppedFile(text);
    const onsubmit = (event) => {
      event.preventDefault();
      this.#try(() => this.#submit(operation.value, text.value));
    };
    return element(
      "form.panel.table-of-cases",
      { onsubmit },
      element("label", { for: text.id }, "Cases, pasted or dropped as CSV"),
      element("p.quiet", {}, note),
      text,
      element("p.actions", {}, operation, element("button.main", {}, "Compute")),
    );
  }

  async #submit(operation, text) {
    const job = await submit(`${operation}/batch`, { cases: casesOf(text, this.base, operation) }, this.#life.signal);
    this.#showJobs([job, ...[...this.#rows.values()].map((row) => row.job)]);
    this.problem.hidden = true;
    announce(`Job ${shortId(job.id)} has ${job.counts.total} cases.`);
  }

  async watch() {
    const { signal } = this.#life;
    while (!signal.aborted) {
      let isBusy = false;
      try {
        isBusy = (await this.#look(signal)).some((job) => !isFinal(job));
        this.problem.hidden = true;
      } catch (error) {
        this.#fail(error);
      }
      await pause(isBusy ? BUSY_MS : IDLE_MS, signal).catch(() => {});
    }
  }

  /** Request the newest jobs, and older ones that are shown and have not ended; return all jobs shown. */
  async #look(signal) {
    const { jobs: newest, next } = (await request(`jobs?limit=${PAGE}`, { signal })).data;
    if (!this.#rows.size) this.#older = next;
    const seen = new Set(newest.map(({ id }) => id));
    const oldest = newest.at(-1)?.created ?? "";
    const shown = [...this.#rows.values()].map(({ job }) => job);
    const older = next === undefined ? [] : shown.filter(({ id, created }) => !seen.has(id) && created < oldest);
    const states = await Promise.all(older.map((job) => (isFinal(job) ? job : this.#stateOf(job, signal))));
    const jobs = [...newest, ...states.filter(Boolean)];
    if (next === undefined) this.#older = undefined;
    this.#showJobs(jobs);
    return jobs;
  }

  /** Return the current state of a job; undefined if it no longer exists. */
  async #stateOf({ id }, signal) {
    try {
      return (await request(`jobs/${id}`, { signal })).data;
    } catch (error) {
      if (error.status === 404) return undefined;
      throw error;
    }
  }

  async #loadOlder() {
    const { jobs, next } = (await request(`jobs?limit=${PAGE}&cursor=${this.#older}`)).data;
    this.#older = next;
    this.#showJobs([...[...this.#rows.values()].map(({ job }) => job), ...jobs.filter(({ id }) => !this.#rows.has(id))]);
  }

  /** Run an action, and show its error if it fails. */
  async #try(action) {
    try {
      await action();
    } catch (error) {
      this.#fail(error);
    }
  }

  leave() {
    this.#life.abort();
    this.dialog.close();
  }

  #showJobs(jobs) {
    const before = this.#rows;
    const listeners = {
      onCancel: (job) => this.#try(() => this.#change(job, "/cancel", { method: "POST" }, "cancelled")),
      onDelete: (job) => this.#try(() => this.#delete(job)),
      onRename: (job) => this.#try(() => this.#rename(job)),
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
    this.more.hidden = this.#older === undefined;
    this.count.textContent = this.#older === undefined ? "" : `The newest ${jobs.length} jobs. There are older ones.`;
  }

  async #change({ id }, path, options, word) {
    const { data } = await request(`jobs/${id}${path}`, options);
    this.#rows.get(id)?.update(data);
    announce(`Job ${shortId(id)} is ${word}.`);
  }

  async #delete(job) {
    const words = element("p", {}, "If it is running, it is cancelled. Its results can no longer be downloaded here.");
    if (!(await this.#ask(`Delete job ${shortId(job.id)}?`, words, "Delete", "Keep"))) return;
    await request(`jobs/${job.id}`, { method: "DELETE" });
    this.#showJobs([...this.#rows.values()].map((row) => row.job).filter(({ id }) => id !== job.id));
    announce(`Job ${shortId(job.id)} is deleted.`);
    document.getElementById("view").focus(); // the button that had the focus was removed
  }

  /** Ask for a new title of a job. */
  async #rename(job) {
    const input = element("input", { value: titleOf(job), required: true, maxlength: 200, autofocus: true, onfocus: () => input.select() });
    if (!(await this.#ask(`Rename job ${shortId(job.id)}`, element("p", {}, element("label", {}, "Title ", input)), "Rename", "Cancel"))) return;
    await this.#change(job, "", { method: "PATCH", body: { title: input.value } }, "renamed");
  }

  /** Ask a question, and return whether the answer is yes; Escape means no. The focus is on `no`, unless the content has an input. */
  #ask(title, content, yes, no) {
    const isFocused = !content.querySelector("input");
    this.dialog.replaceChildren(
      element(
        "form",
        { method: "dialog" },
        ...[element("h2", { id: "dialog-title" }, title), content],
        element("button.main", { value: "yes" }, yes),
        element("button", { value: "", formnovalidate: true, autofocus: isFocused }, no),
      ),
    );
    this.dialog.returnValue = "";
    this.dialog.showModal();
    return new Promise((resolve) => this.dialog.addEventListener("close", () => resolve(this.dialog.returnValue === "yes"), { once: true }));
  }

  #fail(error) {
    if (isAbort(error) || this.#life.signal.aborted) return;
    const [wrong] = error.errors ?? [];
    const [, number, path] = wrong?.pointer.match(/^\/cases\/(\d+)\/(.*)/) ?? [];
    this.problem.textContent = path ? `Case ${Number(number) + 1}, ${path.replaceAll("/", ".")}: ${wrong.detail}` : error.message;
    this.problem.hidden = false;
  }
}
