// Map: a sweep over two fields, which runs as a job and is drawn meanwhile.

import { replaceAddress } from "../address.js";
import { announce, element } from "../elements.js";
import { CaseForm } from "../form.js";
import { submit } from "../job-progress.js";
import { lostNote } from "../lost.js";
import { computeCurve, withBand } from "../map-curve.js";
import { buildMapForm } from "../map-form.js";
import { MapPicture } from "../map-picture.js";
import { followMap, quickMap } from "../map-run.js";
import { QUICK, usualAround } from "../scatter.js";
import { isAbort, request } from "../service.js";
import { isSame, isSmall, mapOfJob, mapQuery, readMap, sweepRequest } from "../sweep.js";
import { Verdict } from "../verdict.js";
import { grouped } from "../words.js";

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
  #shown; // the map in the picture, with its job
  #curve; // promise of the critical curve of that map

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
      if (this.#form) this.#run({ ...this.#form, job: "", study: undefined });
    };
    const form = element("form.panel", { novalidate: true, "aria-label": "What to map", onsubmit }, axes, this.size, buttons);
    this.verdict = new Verdict({ onError: (error) => this.form.fail(error), isLine: true });
    const results = element("div.column", {}, this.verdict.root, this.problem, lostNote());
    this.picture = new MapPicture(results, (places) => this.#drag(places));
    root.append(element("h1", {}, "Map"), element("div.sides", {}, element("div.column", {}, form, element("div.panel", {}, details)), results));
    if (map.job) {
      this.#begin(map);
      this.#follow(map);
    }
    this.axes = buildMapForm(axes, map, (changed) => this.#change(changed));
    this.form = new CaseForm(others, {
      case: map.values,
      onChange: (values) => this.#setCase(values),
      onHold: () => this.#change(undefined),
      problem: this.problem,
      panels: [this.verdict],
    });
    this.verdict.setCase(map.values);
    if (!map.job && this.#form && isSmall(this.#form)) this.#run(this.#form, false);
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
    this.size.textContent = map ? `${grouped(map.x.count * map.y.count)} cases` : "";
    const isShown = Boolean(map && this.#shown && isSame(map, this.#shown));
    if (map) replaceAddress("map", mapQuery({ ...map, job: isShown ? this.#shown.job : "" }));
    if (this.#shown) this.picture.compare(isShown, Boolean(map));
  }

  /** Compute a map as a job, and show a small map, or a coarse grid, at once. The small map with which the view opens needs no job. */
  async #run(map, hasJob = true) {
    this.#begin(map);
    const { signal } = this.#work;
    try {
      if (map.operation === "probability") map.study = { uncertain: await usualAround(map.values, signal), sampling: QUICK };
      const whenRefused = (error) => (hasJob ? undefined : Promise.reject(error)); // otherwise the job reports the error
      const [quick, curve] = await Promise.all([quickMap(map, signal).catch(whenRefused), this.#curve]);
      signal.throwIfAborted();
      if (quick) await this.picture.showCells({ cells: quick.isWhole ? quick.cells : [], rough: quick.cells, curve });
      signal.throwIfAborted();
      if (hasJob) {
        const { path, body } = sweepRequest(map);
        map.job = (await submit(path, body, signal)).id;
        await this.#follow(map, quick);
      } else if (quick) {
        await this.#end(map, { status: "successful", counts: { total: quick.cells.length, done: quick.cells.length } });
      }
    } catch (error) {
      this.#fail(error);
    }
  }

  async #follow(map, quick) {
    const { signal } = this.#work;
    if (this.#form) replaceAddress("map", mapQuery(map));
    this.cancelButton.disabled = false;
    const listeners = {
      onProgress: (job) => this.picture.showProgress(job),
      onCells: async (cells, isLast) => {
        const curve = await this.#curve;
        if (!signal.aborted) await this.picture.showCells({ cells, isLast, curve });
      },
    };
    try {
      await this.#end(map, await followMap(map, listeners, signal, quick?.isWhole ? quick.cells : []));
    } catch (error) {
      this.#fail(error);
    }
    if (!signal.aborted) this.cancelButton.disabled = true;
  }

  /** Show how a map ended, and then the band of its critical curve, which takes longer than the cells. */
  async #end(map, job) {
    const { signal } = this.#work;
    this.cancelButton.disabled = true;
    this.picture.showEnd(job);
    const curve = job.status === "successful" && (await this.#curve);
    if (!curve || signal.aborted) return;
    announce("All cases are computed. The 90 % range of the critical angle follows.");
    const whole = await withBand(map, curve, signal).catch(() => undefined);
    if (signal.aborted) return;
    if (whole) await this.picture.showCells({ curve: whole });
    announce(whole ? "The map shows the 90 % range of the critical angle too." : "The 90 % range of the critical angle could not be computed.");
  }

  #begin(map) {
    this.#work.abort();
    this.#work = new AbortController();
    this.#shown = map;
    this.problem.textContent = "";
    this.cancelButton.disabled = true; // until there is a job
    this.picture.begin(map);
    this.#curve = computeCurve(map, this.#work.signal).catch(() => undefined); // the cells show the error
    announce("The map is being computed.");
  }

  async #cancel() {
    this.cancelButton.disabled = true;
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
    this.problem.textContent = isGone ? "The job of this map has expired or was deleted. Run the map again." : error.message;
    if (error.errors) this.axes.showProblem(error);
  }
}
