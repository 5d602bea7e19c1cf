// Requests to the service: they use relative addresses, send the API key if there is one, and throw problems as errors.

import { keep, kept } from "./storage.js";

const KEY = "ricochet-key";

/** Fires `needed` when the service answers 401. */
export const keyNeeds = new EventTarget();

/** A problem that the service returns instead of an answer (RFC 9457). */
export class Problem extends Error {
  constructor({ type, status, title, detail = "", errors = [], stopped_at_s: stoppedAt }, retryAfter) {
    super(detail || title);
    Object.assign(this, { name: "Problem", type, status, title, detail, errors, stoppedAt, retryAfter });
  }
}

/** Return the absolute address of a path of the service, including the prefix that a proxy may add. */
export function locate(path) {
  return new URL(path.replace(/^\//, ""), document.baseURI).href.split("#")[0];
}

/** Keep the API key until the tab is closed. */
export function useKey(key) {
  keep(KEY, key.trim(), "sessionStorage");
}

/**
 * Send a request to the service.
 *
 * @param {string} path
 * @param {{method?: string, body?: object, headers?: object, signal?: AbortSignal, as?: "data"|"blob"|"stream"}} options
 *   `body` is sent as JSON, by POST unless `method` is given; `as` selects the type of `data`: JSON or text, a Blob,
 *   or the stream of the body
 * @returns {Promise<{status: number, headers: Headers, data: any}>}
 * @throws {Problem} for a status of 400 or above, or if there is no answer (status 0)
 */
export async function request(path, { method, body, headers = {}, signal, as = "data" } = {}) {
  const key = kept(KEY, "sessionStorage");
  const authorization = /^[\x21-\x7e]+$/.test(key ?? "") ? { Authorization: `Bearer ${key}` } : {};
  const response = await reach(path, {
    method: method ?? (body === undefined ? "GET" : "POST"),
    headers: { ...authorization, ...(body === undefined ? {} : { "Content-Type": "application/json" }), ...headers },
    body: body === undefined ? undefined : JSON.stringify(body),
    signal,
  });
  if (!response.ok) throw await problemOf(response);
  return { status: response.status, headers: response.headers, data: await contentOf(response, as) };
}

/** Return whether an error only means that its request was aborted. */
export const isAbort = (error) => error?.name === "AbortError";

/** Return whether an error means that the service is unreachable or busy, so that the same request may succeed later. */
export function isLost({ status }) {
  return [0, 429, 502, 503, 504].includes(status);
}

async function reach(path, options) {
  try {
    return await fetch(locate(path), options);
  } catch (error) {
    if (isAbort(error)) throw error;
    throw new Problem({ status: 0, title: "The service does not answer", detail: "The service does not answer." });
  }
}

async function problemOf(response) {
  if (response.status === 401) keyNeeds.dispatchEvent(new Event("needed"));
  const problem = await response.json().catch(() => ({ title: response.statusText }));
  const retryAfter = Number(response.headers.get("Retry-After")) || undefined;
  return new Problem({ ...problem, status: response.status }, retryAfter);
}

async function contentOf(response, as) {
  if (response.status === 204) return undefined;
  if (as === "blob") return response.blob();
  if (as === "stream") return response.body;
  const isJson = /\bjson\b/.test(response.headers.get("Content-Type") ?? "");
  return isJson ? response.json() : response.text();
}
