// While values keep changing, at most one request runs, and the latest value is requested next.

import { untilAnswered } from "./lost.js";
import { isAbort } from "./service.js";

/**
 * Return a function that runs `work(value, signal)` for the latest value it was called with.
 *
 * Work that fails because the service does not answer is repeated with the latest value until it does (lost.js).
 *
 * @param {(value: any, signal: AbortSignal) => Promise<void>} work it shows nothing once its signal is aborted
 * @param {(error: Error) => void} onError called on other failures, not on requests given up
 * @param {{supersede?: boolean, restMs?: number}} options `supersede` gives up the running work for a newer value;
 *   `restMs` is how long a value has to be the latest before it is worked on; the first one, with which a view opens, has not to
 * @returns {((value: any) => void) & {cancel: () => void, stop: () => void, isBehind: () => boolean}} `cancel` gives up
 *   the value, `stop` the function too; `isBehind` returns whether a newer value waits
 */
export function latest(work, onError, { supersede = false, restMs = 0 } = {}) {
  let waiting = [];
  let running; // of the running work
  let timer; // while a value has to rest
  let [isFirst, isStopped] = [true, false];

  const run = async () => {
    timer = undefined;
    if (running) return; // the running work is followed by what waits
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
        const isOfBefore = isAbort(error) || signal.aborted || waiting.length; // of a value that is no longer there
        if (!isOfBefore) onError(error);
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
