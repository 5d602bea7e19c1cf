// Runs work for the latest of quickly changing values, one run at a time.

import { untilAnswered } from "./lost.js";
import { isAbort } from "./service.js";

/**
 * Return a function that runs `work(value, signal)` for the latest value it was called with.
 *
 * Work that fails because the service does not answer is repeated with the latest value until it answers (lost.js).
 *
 * @param {(value: any, signal: AbortSignal) => Promise<void>} work must show nothing once its signal is aborted
 * @param {(error: Error) => void} onError called on other failures, except aborted requests
 * @param {{supersede?: boolean, restMs?: number}} options with `supersede` a newer value aborts the running work;
 *   `restMs` is the pause without a newer value before work starts; the first value, with which a view opens, starts at once
 * @returns {((value: any) => void) & {cancel: () => void, stop: () => void, isBehind: () => boolean}} `cancel` aborts
 *   the work and drops a waiting value; `stop` also ignores later values; `isBehind` returns whether a newer value waits
 */
export function latest(work, onError, { supersede = false, restMs = 0 } = {}) {
  let waiting = [];
  let running; // AbortController of the running work
  let timer; // set during the pause before work starts
  let [isFirst, isStopped] = [true, false];

  const run = async () => {
    timer = undefined;
    if (running) return; // the loop of the running work takes the value that waits
    while (waiting.length && !timer) {
      running = new AbortController();
      const { signal } = running;
      let value;
      const send = () => {
        if (waiting.length) [value] = waiting.splice(0);
        return work(value, signal);
      };
      try {
        await untilAnswered(send, signal);
      } catch (error) {
        const isOutdated = isAbort(error) || signal.aborted || waiting.length; // the failure concerns an earlier value
        if (!isOutdated) onError(error);
      }
    }
    running = undefined;
  };

  const update = (value) => {
    if (isStopped) return;
    waiting = [value];
    if (supersede) running?.abort();
    clearTimeout(timer);
    if (restMs && !isFirst) timer = setTimeout(run, restMs);
    else run();
    isFirst = false;
  };
  update.isBehind = () => waiting.length > 0;
  update.cancel = () => {
    waiting = [];
    clearTimeout(timer);
    timer = undefined;
    running?.abort();
  };
  update.stop = () => {
    isStopped = true;
    update.cancel();
  };
  return update;
}
