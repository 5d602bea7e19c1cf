// While values keep changing, at most one request runs, and the latest value is requested next.

import { isAbort, isLost } from "./service.js";

const RETRY_MS = [1000, 2000, 5000]; // before a service that does not answer is tried again; the last from then on

/**
 * Return a function that runs `work(value, signal)` for the latest value it was called with.
 *
 * Work that fails because the service does not answer is run again by itself, with the latest value, until it does.
 *
 * @param {(value: any, signal: AbortSignal) => Promise<void>} work it shows nothing once its signal is aborted
 * @param {(error: Error) => void} onError called on failures, not on requests given up
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
      } catch (error) {
        if (isAbort(error) || signal.aborted) continue;
        if (waiting.length && !isLost(error)) continue; // what is wrong with a value that is no longer there
        onError(error);
        if (!isLost(error)) continue;
        if (!waiting.length) waiting = [value];
        await pause(RETRY_MS[Math.min(failures++, RETRY_MS.length - 1)]);
      }
    }
    runs = false;
  };

  const ask = (value) => {
    waiting = [value];
    if (supersede) running?.abort();
    wake();
    if (!runs) run();
  };
  ask.isBehind = () => waiting.length > 0;
  ask.cancel = () => {
    waiting = [];
    running?.abort();
    wake();
  };
  ask.stop = () => {
    isStopped = true;
    ask.cancel();
  };
  return ask;
}
