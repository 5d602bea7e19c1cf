// Computes a map: at once, by studies of its cells, or as a job that is followed to its end.

import { trajectoryRequest } from "./case.js";
import { isFinal, resultsOf, statesOf } from "./job-progress.js";
import { pause, untilAnswered } from "./lost.js";
import { readCell } from "./map-cells.js";
import { request } from "./service.js";
import { reportRequest } from "./report.js";
import { clipped } from "./run.js";
import { QUICK, takeUsual, uncertainInput, usualInputs } from "./scatter.js";
import { caseAt, quickSweep } from "./sweep.js";

const REDRAW_MS = 300; // at least; a large map is drawn less often, as drawing takes turns with the workers
const REST = 6; // times what it takes to read and draw the cells: 1/7 of a core
const AT_ONCE = 2; // studies that are computed at the same time

/**
 * Compute as many cases of a map as the service answers at once: all of a small map, a coarse grid of a large one.
 *
 * @returns {Promise<{cells: object[], isWhole: boolean}|undefined>} the nearest of them for each cell; undefined if there
 *   are none such
 */
export async function quickMap(map, signal) {
  const quick = quickSweep(map);
  if (!quick) return undefined;
  const { body, path, places, isWhole } = quick;
  const { results } = (await untilAnswered(() => request(path, { body, signal }), signal)).data;
  if (!results) return undefined; // the answer is a job, because this service is set to answer fewer cases at once
  const found = results.map(readCell);
  const nearest = (count, some) => Array.from({ length: count }, (_, i) => indexOfNearest(some, i));
  const [columns, rows] = [nearest(map.x.count, places.x), nearest(map.y.count, places.y)];
  return { isWhole, cells: rows.flatMap((row) => columns.map((column) => found[row * places.x.length + column])) };
}

/**
 * Compute a map of probabilities: for each cell the outcomes of strikes with the usual scatter around its case.
 *
 * @param {(cells: object[], job: object) => Promise<void>} onCells called with the cells and the progress, as of a job
 */
export async function followStudies(map, onCells, signal) {
  const cells = Array.from({ length: map.x.count * map.y.count });
  const counts = { total: cells.length, done: 0, failed: 0 };
  const started = new Date().toISOString();
  const judge = () => request("verdict", { body: reportRequest(clipped(map.values)), signal });
  takeUsual((await untilAnswered(judge, signal)).data.usual_scatter); // what scatters is that of the case
  let [next, shown] = [0, performance.now()];
  const study = async (index) => {
    const values = caseAt(map, { column: index % map.x.count, row: Math.floor(index / map.x.count) });
    const uncertain = usualInputs(values).map((input) => uncertainInput(input, values));
    const body = { ...trajectoryRequest(values), uncertain, sampling: QUICK };
    try {
      const { data } = await untilAnswered(() => request("trajectory/uncertainty", { body, signal }), signal);
      cells[index] = readCell({ result: data });
    } catch (error) {
      if (!error.errors) throw error; // else a case that the service does not accept
      counts.failed += 1;
      cells[index] = readCell({ problem: error });
    }
    counts.done += 1;
  };
  const work = async () => {
    while (next < cells.length) {
      await study(next++);
      if (performance.now() - shown < REDRAW_MS && counts.done < counts.total) continue;
      shown = performance.now();
      await onCells(cells, { status: counts.done < counts.total ? "running" : "successful", counts, started });
    }
  };
  try {
    await Promise.all(Array.from({ length: AT_ONCE }, work));
  } finally {
    next = cells.length; // after a failure none is begun
  }
}

function indexOfNearest(places, place) {
  const distances = places.map((each) => Math.abs(each - place));
  return distances.indexOf(Math.min(...distances));
}

/**
 * Follow the job of a map.
 *
 * @param {object} map map with its job
 * @param {{onProgress: (job: object) => void, onCells: (cells: object[], isLast: boolean) => Promise<void>}} listeners called
 *   whenever the job has changed, and with the cells, row by row, when there are more; cells without a result are undefined
 * @param {AbortSignal} signal
 * @param {object[]} known cells that are already computed
 * @returns {Promise<object>} the job at its end
 */
export async function followMap(map, { onProgress, onCells }, signal, known = []) {
  const cells = Array.from({ length: map.x.count * map.y.count }, (_, i) => known[i]);
  const ready = resultsOf(map.job, signal);
  let job;
  const follow = async () => {
    for await (job of statesOf(map.job, signal)) {
      if (job.operation !== map.operation || job.counts.total !== cells.length) {
        throw new Error("The job is that of another map. Run this one.");
      }
      onProgress(job);
    }
  };
  const read = async () => {
    let [isLast, known] = [false, undefined];
    while (!isLast) {
      isLast = job !== undefined && isFinal(job);
      const begun = performance.now();
      if (job && (isLast || job.counts.done !== known)) {
        known = job.counts.done;
        for await (const items of ready()) for (const item of items) cells[item.index] = readCell(item);
        await onCells(cells, isLast);
      }
      const rest = Math.max(REST * (performance.now() - begun), REDRAW_MS);
      if (!isLast) await Promise.race([ended, pause(rest, signal)]);
    }
  };
  const ended = follow();
  await Promise.all([ended, read()]);
  return job;
}

/** Describe how a job ended. */
export function endWords({ status, counts, problem }) {
  const { total, done } = counts;
  if (status === "dismissed") return `Cancelled after ${done} of ${total} cases.`;
  if (status === "failed" || status === "damaged") return `Given up after ${done} of ${total} cases: ${problem?.detail ?? "it failed"}.`;
  return `All ${total} cases are computed.`;
}
