// While values keep changing, at most one request runs, and the latest value is requested next.

import { say } from "./elements.js";
import { isAbort } from "./service.js";

const SLOW_MS = 500;

let slow = 0; // how many are waited for that long

/**
 * Return a function that runs `work(value, signal)` for the latest value it was called with.
 *
 * @param {(value: any, signal: AbortSignal) => Promise<void>} work
 * @param {(error: Error) => void} onError called on failures, not on requests given up
 * @returns {((value: any) => void) & {stop: () => void, isBehind: () => boolean}} `isBehind` returns whether a newer
 *   value waits, so that what only matters at rest can be left out
 */
export function latest(work, onError) {
  const controller = new AbortController();
  let waiting = [];
  let runs = false;
  const run = async () => {
    runs = true;
    while (waiting.length && !controller.signal.aborted) {
      const value = waiting.pop();
      waiting = [];
      const done = announce();
      try {
        await work(value, controller.signal);
      } catch (error) {
        if (!isAbort(error) && !controller.signal.aborted) onError(error);
      } finally {
        done();
      }
    }
    runs = false;
  };
  const ask = (value) => {
    waiting = [value];
    if (!runs) run();
  };
  ask.isBehind = () => waiting.length > 0;
  ask.stop = () => controller.abort();
  return ask;
}

/** Say after a while that something is computed; return what ends it. */
function announce() {
  let isSlow = false;
  const timer = setTimeout(() => {
    isSlow = true;
    slow += 1;
    say("Computing ...");
  }, SLOW_MS);
  return () => {
    clearTimeout(timer);
    if (!isSlow) return;
    slow -= 1;
    if (!slow) say("");
  };
}
