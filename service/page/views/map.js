// Map: a sweep over two fields, which runs as a job and is drawn meanwhile.

import { replaceAddress } from "../address.js";
import { announce, element } from "../elements.js";
import { CaseForm } from "../form.js";
import { submit } from "../job-progress.js";
import { lostNote } from "../lost.js";
import { buildMapForm } from "../map-form.js";
import { MapPicture } from "../map-picture.js";
import { followMap, followStudies, quickMap } from "../map-run.js";
import { isAbort, request } from "../service.js";
import { isSame, isStudied, mapOfJob, mapQuery, quickSweep, readMap, sweepRequest } from "../sweep.js";
import { Verdict } from "../verdict.js";

/** Show the map of a query or, if the query names a job, the map of the job with its results. */
export async function show(root, query) {
  const view = new MapView(root, await mapOf(query));
  return () => view.leave();
}

/** Return the map that the job of a query computes or, if there is no such job or it is no map, the map that the query describes. */
async function mapOf(query) {
  const job = query.get("job");
  const data = job ? await request(`jobs/${job}`).then((answer) => answer.data, () => undefined) : undefined;
  return (data && mapOfJob(data)) ?? readMap(query);
}

class MapView {
  #work = new AbortController(); // of the running map, aborted when another map is run
  #form; // the map in the form; undefined while a field is not accepted
  #shown; // the map of the picture, with its job
  #progress; // of a map that is no job

  constructor(root, map) {
    this.runButton = element("button.main", { type: "submit" }, "Run");
    this.cancelButton = element("button", { type: "button", disabled: true, onclick: () => this.#cancel() }, "Cancel");
    this.size = element("p.quiet", { id: "map-size" });
    this.problem = element("p.problem", { role: "alert" });
    const [axes, others] = [element("div"), element("div")];
    const details = element("details", {}, element("summary", {}, "The other fields"), others);
    const buttons = element("p.buttons", {}, this.runButton, " ", this.cancelButton);
    const onsubmit = (event) => {
      event.preventDefault();
      this.#run();
    };
    const form = element("form.panel", { novalidate: true, "aria-label": "What to map", onsubmit }, axes, this.size, buttons);
    this.verdict = new Verdict({ onError: (error) => this.form.fail(error), isLine: true });
    const results = element("div.column", {}, this.verdict.root, this.problem, lostNote());
    this.picture = new MapPicture(results, (places) => this.#drag(places));
    root.append(
      element("h1", {}, "Map"),
      element("div.sides", {}, element("div.column", {}, form, element("div.panel", {}, details)), results),
    );
    if (map.job) this.#follow(map);
    this.axes = buildMapForm(axes, map, (changed) => this.#change(changed));
    this.form = new CaseForm(others, {
      case: map.values,
      onChange: (values) => this.#setCase(values),
      onHold: () => this.#change(undefined),
      problem: this.problem,
      panels: [this.verdict],
    });
    this.verdict.setCase(map.values);
    if (!map.job && this.#form && quickSweep(this.#form)?.isWhole) this.#preview(this.#form);
  }

  leave() {
    this.#work.abort();
    this.verdict.stop();
    this.picture.leave();
  }

  #setCase(values) {
    this.verdict.setCase(values);
    this.axes.setCase(values);
    if (this.#form && this.#shown && isSame(this.#form, this.#shown)) this.picture.setHere(values);
  }

  /** Change the case to a position on the map. */
  #drag(places) {
    const { x, y } = this.#shown;
    if (!this.#form || !isSame(this.#form, this.#shown)) return;
    [x, y].forEach(({ field }, i) => this.form.setField(field, places[i]));
  }

  #change(map) {
    this.#form = map;
    this.runButton.disabled = !map;
    this.size.textContent = map ? `${(map.x.count * map.y.count).toLocaleString("en")} cases` : "";
    if (map) replaceAddress("map", mapQuery({ ...map, job: this.#jobOf(map) }));
    if (this.#shown) this.picture.compare(map && isSame(map, this.#shown), Boolean(map));
  }

  /** Return the job of a map if it is the one that is shown. */
  #jobOf(map) {
    return this.#shown && isSame(map, this.#shown) ? this.#shown.job : "";
  }

  /** Show a small map, or a coarse grid of a large one, without a job. */
  async #preview(map) {
    this.#begin(map);
    const { signal } = this.#work;
    try {
      const quick = await quickMap(map, signal);
      if (!quick || signal.aborted) return;
      await this.picture.showCells(quick.cells);
      if (signal.aborted) return; // run meanwhile
      const total = map.x.count * map.y.count;
      this.picture.showEnd({ status: "successful", counts: { total, done: total } });
    } catch (error) {
      this.#fail(error);
    }
  }

  async #run() {
    const map = this.#form;
    if (!map) return;
    this.#begin(map);
    try {
      const { signal } = this.#work;
      if (isStudied(map)) {
        await this.#study(map, signal);
        return;
      }
      const { path, body } = sweepRequest(map);
      const quick = await quickMap(map, signal).catch(() => undefined); // the job says what is wrong
      signal.throwIfAborted();
      if (quick) await this.picture.showCells(quick.isWhole ? quick.cells : [], quick.cells);
      const job = await submit(path, body, signal);
      await this.#follow({ ...map, job: job.id }, quick);
    } catch (error) {
      this.#fail(error);
    }
  }

  /** Compute a map that is no job. */
  async #study(map, signal) {
    replaceAddress("map", mapQuery(map));
    this.cancelButton.disabled = false;
    const onCells = async (cells, job) => {
      if (signal.aborted) return;
      this.#progress = job;
      this.picture.showProgress(job);
      await this.picture.showCells(cells);
    };
    try {
      await followStudies(map, onCells, signal);
      this.picture.showEnd(this.#progress);
    } finally {
      if (!signal.aborted) this.cancelButton.disabled = true;
    }
  }

  async #follow(map, quick) {
    this.#begin(map);
    const { signal } = this.#work;
    if (this.#form) replaceAddress("map", mapQuery(map));
    this.cancelButton.disabled = false;
    const listeners = {
      onProgress: (job) => this.picture.showProgress(job),
      onCells: async (cells, isLast) => {
        if (!signal.aborted) await this.picture.showCells(cells, quick?.cells, isLast);
      },
    };
    try {
      this.picture.showEnd(await followMap(map, listeners, signal, quick?.isWhole ? quick.cells : []));
    } catch (error) {
      this.#fail(error);
    }
    if (!signal.aborted) this.cancelButton.disabled = true;
  }

  #begin(map) {
    this.#work.abort();
    this.#work = new AbortController();
    this.#shown = map;
    this.#progress = { counts: { total: map.x.count * map.y.count, done: 0 } };
    this.problem.textContent = "";
    this.picture.begin(map);
    announce("The map is being computed.");
  }

  async #cancel() {
    this.cancelButton.disabled = true;
    if (isStudied(this.#shown)) {
      this.#work.abort();
      this.picture.showEnd({ ...this.#progress, status: "dismissed" });
      announce("The map is cancelled.");
      return;
    }
    try {
      await request(`jobs/${this.#shown.job}/cancel`, { method: "POST" });
    } catch (error) {
      this.cancelButton.disabled = false;
      this.#fail(error);
    }
  }

  #fail(error) {
    if (isAbort(error)) return;
    announce("");
    this.picture.giveUp();
    const isGone = error.status === 404;
    this.problem.textContent = isGone ? "The job of this map is gone: it has expired. Run it again." : error.message;
    if (error.errors) this.axes.showProblem(error);
  }
}
