// Computes a map: cases that are answered at once, and a job that is followed to its end.

import { isFinal, resultsOf, statesOf } from "./job-progress.js";
import { pause, untilAnswered } from "./lost.js";
import { readCell } from "./map-cells.js";
import { request } from "./service.js";
import { evenly, isSmall, mapNameOf, numbers, OPERATIONS, sweepRequest } from "./sweep.js";
import { grouped } from "./words.js";

const COARSE = 8; // rows and columns of the preview of a large map
const REDRAW_MS = 300; // least time between drawings; a large map is drawn less often, because drawing competes with the workers
const REST = 6; // pause after a drawing, in multiples of its duration, so that drawing takes at most 1/7 of a core

/**
 * Compute cases of a map that the service answers at once: all cases of a small map, or a coarse grid of a large one.
 *
 * @returns {Promise<{cells: object[], isWhole: boolean}|undefined>} the nearest computed case for each cell; undefined if no case is answered at once
 */
export async function quickMap(map, signal) {
  if (OPERATIONS[map.operation].isSlow) return undefined;
  const isWhole = isSmall(map);
  const [x, y] = [map.x, map.y].map((axis) => {
    const values = numbers(axis);
    return { field: axis.field, values: evenly(axis.count, isWhole ? axis.count : COARSE).map((place) => values[place]) };
  });
  const { path, body } = sweepRequest({ ...map, x, y });
  const { results } = (await untilAnswered(() => request(path, { body, signal }), signal)).data;
  if (!results) return undefined; // the answer is a job, because this service is set to answer fewer cases at once
  const found = results.map(readCell);
  const nearest = ({ count }, { values }) => Array.from({ length: count }, (_, i) => Math.round((i * (values.length - 1)) / Math.max(count - 1, 1)));
  const [columns, rows] = [nearest(map.x, x), nearest(map.y, y)];
  return { isWhole, cells: rows.flatMap((row) => columns.map((column) => found[row * x.values.length + column])) };
}

/**
 * Follow the job of a map.
 *
 * @param {object} map the map, with its job
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
      const isOther = mapNameOf(job) !== map.operation || job.counts.total !== cells.length;
      if (isOther) throw new Error("The job belongs to another map. Run this map.");
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
  const [total, done] = [counts.total, counts.done].map(grouped);
  if (status === "dismissed") return `Cancelled after ${done} of ${total} cases.`;
  if (status === "failed" || status === "damaged") return `Stopped after ${done} of ${total} cases: ${problem?.detail ?? "it failed"}.`;
  return `All ${total} cases are computed.`;
}
