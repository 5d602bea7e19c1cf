// The job of a map, followed to its end while its cells fill.

import { isFinal, pause, resultsOf, statesOf } from "./job-progress.js";
import { readCell } from "./map-cells.js";
import { isLost } from "./service.js";

const REDRAW_MS = 300;

/**
 * Follow the job of a map.
 *
 * @param {object} map with its job
 * @param {{onProgress: (job: object) => void, onCells: (cells: object[]) => Promise<void>}} listeners called whenever the
 *   job has changed, and of the cells, row by row, whenever there are more; those without a result are missing
 * @param {AbortSignal} signal
 * @returns {Promise<object>} the job at its end
 */
export async function followMap(map, { onProgress, onCells }, signal) {
  const cells = new Array(map.x.count * map.y.count).fill(undefined);
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
      if (job && job.counts.done !== known) {
        known = job.counts.done;
        try {
          for await (const items of ready()) for (const item of items) cells[item.index] = readCell(item);
        } catch (error) {
          if (!isLost(error)) throw error;
          [known, isLast] = [undefined, false]; // the rest once the service is back
        }
        await onCells(cells);
      }
      if (!isLast) await pause(REDRAW_MS, signal);
    }
  };
  await Promise.all([follow(), read()]);
  return job;
}

/** Say how far a job is, and how fast it goes. */
export function progressWords({ counts, status }, seconds, doneBefore) {
  const { total, done, cached, failed } = counts;
  const parts = [`${done} of ${total} cases`];
  if (cached) parts.push(`${cached} from cache`);
  if (failed) parts.push(`${failed} failed`);
  const rate = (done - doneBefore) / seconds;
  if (status === "running" && seconds > 0.5 && rate > 0) {
    parts.push(`${rate.toPrecision(2)} a second`, `${Math.ceil((total - done) / rate)} s left`);
  }
  return parts.join(", ");
}

/** Say how a job has ended. */
export function endWords({ status, counts, problem }) {
  const { total, done } = counts;
  if (status === "dismissed") return `Cancelled after ${done} of ${total} cases.`;
  if (status === "failed") return `Given up after ${done} of ${total} cases: ${problem?.detail ?? "it failed"}.`;
  return `All ${total} cases are computed.`;
}
