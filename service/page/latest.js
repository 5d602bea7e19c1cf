// While values keep changing, at most one request runs, and the latest value is requested next.

import { markAnswered, markLost, retryDelay } from "./lost.js";
import { isAbort, isLost } from "./service.js";

/**
 * Return a function that runs `work(value, signal)` for the latest value it was called with.
 *
 * Work that fails because the service does not answer is repeated with the latest value until it does (lost.js).
 *
 * @param {(value: any, signal: AbortSignal) => Promise<void>} work it shows nothing once its signal is aborted
 * @param {(error: Error) => void} onError called on other failures, not on requests given up
 * @param {{supersede?: boolean, restMs?: number}} options `supersede` gives up the running work for a newer value;
 *   `restMs` is how long a value has to be the latest before it is worked on
 * @returns {((value: any) => void) & {cancel: () => void, stop: () => void, isBehind: () => boolean}} `cancel` gives up
 *   the value, `stop` the function too; `isBehind` returns whether a newer value waits
 */
export function latest(work, onError, { supersede = false, restMs = 0 } = {}) {
  let waiting = [];
  let running; // of the running work
  let [runs, isStopped] = [false, false];
  let wake = () => {};

  const pause = (milliseconds) =>
    new Promise((resolve) => {
      const timer = setTimeout(resolve, milliseconds);
      wake = () => {
        clearTimeout(timer);
        resolve();
      };
    });

  const rest = async () => {
    let value;
    while (restMs && waiting.length && waiting[0] !== value) {
      [value] = waiting;
      await pause(restMs);
    }
  };

  const run = async () => {
    runs = true;
    let failures = 0;
    for (;;) {
      await rest();
      if (!waiting.length || isStopped) break;
      const [value] = waiting;
      waiting = [];
      running = new AbortController();
      const { signal } = running;
      try {
        await work(value, signal);
        failures = 0;
        markAnswered(update);
      } catch (error) {
        if (isAbort(error) || signal.aborted) continue;
        if (isLost(error)) {
          markLost(update, error);
          if (!waiting.length) waiting = [value];
          await pause(retryDelay(failures++, error));
          continue;
        }
        markAnswered(update);
        if (!waiting.length) onError(error); // else it is of a value that is no longer there
      }
    }
    runs = false;
  };

  const update = (value) => {
    waiting = [value];
    if (supersede) running?.abort();
    wake();
    if (!runs) run();
  };
  update.isBehind = () => waiting.length > 0;
  update.cancel = () => {
    waiting = [];
    running?.abort();
    markAnswered(update);
    wake();
  };
  update.stop = () => {
    isStopped = true;
    update.cancel();
  };
  return update;
}
