// A job as it goes: submitted, followed to its end, its results read as they become ready.

import { ask, isAbort, isLost } from "./service.js";

const PAGE = 1000; // results requested at once
const PAUSE_MS = 1000; // before a broken stream is opened anew
const MOST_TRIES = 5;

/** Tell whether a job has ended. */
export function isFinal(job) {
  return !["accepted", "running"].includes(job.status);
}

/**
 * Make a job.
 *
 * A busy service is asked again when it says so. All tries have one key, so they make one job. Given up while the service
 * takes it on, the job is cancelled: nobody would know of it.
 *
 * @returns {Promise<object>} the job
 */
export async function submit(path, body, signal) {
  const key = Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0"));
  const headers = { Prefer: "respond-async", "Idempotency-Key": key.join("") };
  for (let tries = 1; ; tries++) {
    try {
      const { data: job } = await ask(path, { body, headers });
      if (!signal.aborted) return job;
      ask(job.links.cancel, { method: "POST" }).catch(() => {});
      throw signal.reason;
    } catch (problem) {
      signal.throwIfAborted();
      const isBusy = [0, 409, 429, 503].includes(problem.status);
      if (!isBusy || tries === MOST_TRIES) throw problem;
      await pause((problem.retryAfter ?? 1) * 1000, signal);
    }
  }
}

/**
 * Yield a job as it is and whenever it changes, until it has ended.
 *
 * Server-sent events report it, read with fetch because an EventSource sends no key; while they fail it is polled.
 *
 * @param {string} id
 * @param {AbortSignal} signal
 * @param {(error: Error) => void} onLost called whenever the service does not answer
 * @throws {Problem} if the service does not know the job
 */
export async function* statesOf(id, signal, onLost = () => {}) {
  let last = "";
  for (;;) {
    try {
      const headers = last ? { "Last-Event-ID": last } : {};
      const { data } = await ask(`jobs/${id}/events`, { headers, signal, as: "stream" });
      for await (const event of eventsOf(data)) {
        last = event.id;
        const job = JSON.parse(event.data);
        yield job;
        if (isFinal(job)) return;
      }
    } catch (error) {
      if (signal.aborted || isRefusal(error)) throw error;
      if (isLost(error)) onLost(error);
    }
    await pause(PAUSE_MS, signal);
    const job = await ask(`jobs/${id}`, { signal }).then(({ data }) => data, unlessRefused);
    if (job) yield job;
    if (job && isFinal(job)) return;
  }
}

/** Return a function that yields, page by page, the results that have become ready since it was last called. */
export function resultsOf(id, signal) {
  let cursor = "";
  return async function* ready() {
    while (cursor !== undefined) {
      const path = `jobs/${id}/results?limit=${PAGE}&cursor=${cursor}`;
      const { results, next } = (await ask(path, { signal })).data;
      cursor = next;
      if (!results.length) return;
      yield results;
    }
  };
}

/** Yield the events of a stream: their `id` and `data`. */
async function* eventsOf(stream) {
  const reader = stream.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const blocks = (text + value).split(/\r?\n\r?\n/);
    text = blocks.pop();
    for (const block of blocks) {
      const fields = Object.fromEntries(block.split(/\r?\n/).map((line) => line.split(/: ?(.*)/s)));
      if ("data" in fields) yield fields;
    }
  }
}

function isRefusal({ status }) {
  return status >= 400 && status < 500 && status !== 429;
}

function unlessRefused(error) {
  if (isAbort(error) || isRefusal(error)) throw error;
}

/** Wait; rejects when given up. */
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
