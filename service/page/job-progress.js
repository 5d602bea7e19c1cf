// Submits a job, follows it to its end, and reads its results as they become ready.

import { markAnswered, markLost, pause, untilAnswered } from "./lost.js";
import { isAbort, isLost, request } from "./service.js";
import { digits, grouped } from "./words.js";

const PAGE = 1000; // results requested at once
const PAUSE_MS = 1000; // pause before a broken stream is reopened

/** Return whether a job has ended. */
export const isFinal = (job) => !["accepted", "running"].includes(job.status);

/** Describe the progress of a job, its rate and the time left. */
export function progressWords({ counts, status, started }) {
  const { total, done, cached = 0, failed } = counts;
  const rate = (1e3 * (done - cached)) / (Date.now() - Date.parse(started)); // [1/s]
  const left = (total - done) / rate;
  const isKnown = status === "running" && done > cached;
  return [
    `${grouped(done)} of ${grouped(total)} cases`,
    cached && `${grouped(cached)} from cache`,
    failed && `${grouped(failed)} failed`,
    isKnown && `${digits(rate, 2)} a second`,
    isKnown && `about ${left < 90 ? `${Math.ceil(left)} s` : `${Math.ceil(left / 60)} min`} left`,
  ].filter(Boolean).join(", ");
}

/**
 * Submit a job.
 *
 * The request is repeated until the service answers; all attempts share one idempotency key, so they create one job. A job that
 * is accepted after `signal` was aborted is cancelled, because nothing would show it.
 *
 * @returns {Promise<object>} the job
 */
export async function submit(path, body, signal) {
  const key = Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0"));
  const headers = { Prefer: "respond-async", "Idempotency-Key": key.join("") };
  const isTemporary = (error) => isLost(error) || error.status === 409; // an earlier attempt is still being accepted
  const { data: job } = await untilAnswered(() => request(path, { body, headers }), signal, isTemporary);
  if (!signal.aborted) return job;
  request(`jobs/${job.id}/cancel`, { method: "POST" }).catch(() => {});
  throw signal.reason;
}

/**
 * Yield the state of a job now and whenever it changes, until it has ended.
 *
 * Changes arrive as server-sent events, read with `fetch` because an EventSource cannot send a key; while these fail, the job is polled.
 *
 * @throws {Problem} if the service does not know the job
 */
export async function* statesOf(id, signal) {
  let last = "";
  const task = {};
  try {
    for (;;) {
      try {
        const headers = last ? { "Last-Event-ID": last } : {};
        const { data } = await request(`jobs/${id}/events`, { headers, signal, as: "stream" });
        markAnswered(task);
        for await (const event of eventsOf(data)) {
          last = event.id;
          const job = JSON.parse(event.data);
          yield job;
          if (isFinal(job)) return;
        }
      } catch (error) {
        if (signal.aborted || isRefusal(error)) throw error;
        if (isLost(error)) markLost(task, error);
      }
      await pause(PAUSE_MS, signal);
      const job = await request(`jobs/${id}`, { signal }).then(({ data }) => data, unlessRefused);
      if (job) yield job;
      if (job && isFinal(job)) return;
    }
  } finally {
    markAnswered(task);
  }
}

/** Return a function that yields, page by page, the results that have become ready since it was last called. */
export function resultsOf(id, signal) {
  let cursor = "";
  return async function* ready() {
    while (cursor !== undefined) {
      const path = `jobs/${id}/results?limit=${PAGE}&cursor=${cursor}`;
      const { results, next } = (await untilAnswered(() => request(path, { signal }), signal)).data;
      cursor = next;
      if (!results.length) return;
      yield results;
    }
  };
}

/** Yield the events of a stream, each with its `id` and `data`. */
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
