// A client of the ricochet service: types from its contract, calls by openapi-fetch.
//
//     const client = createClient({ baseUrl: "http://127.0.0.1:8000" });
//     const { data, error } = await client.POST("/cra", { body });

import createFetchClient, { type Client, type ClientOptions } from "openapi-fetch";

import type { components, paths } from "./contract.js";

export type { components, operations, paths } from "./contract.js";

/** Schemas of the contract, by name. */
export type Schemas = components["schemas"];
/** Media type of JSON answers and problems; `parseAs` requests other formats. */
export type Json = `application/${string}json`;

/** Return a client with one method per HTTP verb; the first argument is a path of the contract. */
export function createClient(options: ClientOptions): Client<paths, Json> {
  return createFetchClient<paths, Json>(options);
}
