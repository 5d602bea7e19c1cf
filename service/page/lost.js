// Repeats requests that the service does not answer, and says so beside the picture.

import { announceAway, element } from "./elements.js";
import { isLost } from "./service.js";

const RETRY_MS = [1000, 2000, 5000]; // delays before the first retries; the last one applies to all further ones

const lost = new Map(); // messages by task that waits for the service
let note = element("p.problem", { role: "alert" });

/** Return the note of a view, which is empty unless a task waits for the service. */
export function lostNote() {
  note = element("p.problem", { role: "alert" });
  show();
  return note;
}

/** Record that a task waits for the service, until `markAnswered` is called. */
export function markLost(task, { message }) {
  lost.set(task, message);
  show();
}

/** Record that a task no longer waits for the service. */
export function markAnswered(task) {
  if (lost.delete(task)) show();
}

/** Return the delay before a request is repeated [ms]. */
export function retryDelay(failures, { retryAfter }) {
  return retryAfter ? 1000 * retryAfter : RETRY_MS[Math.min(failures, RETRY_MS.length - 1)];
}

/**
 * Send a request, and repeat it until the service answers.
 *
 * @param {() => Promise<any>} send
 * @param {AbortSignal} signal
 * @param {(error: Error) => boolean} isTemporary whether a request that failed may succeed later
 */
export async function untilAnswered(send, signal, isTemporary = isLost) {
  const task = {};
  try {
    for (let failures = 0; ; failures++) {
      try {
        return await send();
      } catch (error) {
        signal.throwIfAborted();
        if (!isTemporary(error)) throw error;
        markLost(task, error);
        await pause(retryDelay(failures, error), signal);
      }
    }
  } finally {
    markAnswered(task);
  }
}

/** Wait; rejects when `signal` is aborted. */
export function pause(milliseconds, signal) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, milliseconds);
    const giveUp = () => {
      clearTimeout(timer);
      reject(new DOMException("given up", "AbortError"));
    };
    signal.addEventListener("abort", giveUp, { once: true });
  });
}

/** Wait until a part is visible in the window, or for `milliseconds` at most; rejects when `signal` is aborted. */
export async function untilSeen(part, milliseconds, signal) {
  const { promise: seen, resolve } = Promise.withResolvers();
  const observer = new IntersectionObserver((entries) => entries.at(-1).isIntersecting && resolve());
  observer.observe(part);
  await Promise.race([seen, pause(milliseconds, signal)]).finally(() => observer.disconnect());
}

function show() {
  const [message] = lost.values();
  announceAway(message ? `${message} Trying again.` : "");
  note.textContent = message ? `${message} Trying again. Grey results are for the previous inputs.` : "";
}
