// Requests of a TypeScript program to the service: types from the contract, calls by openapi-fetch.
//
// tests/api/test_typescript_client.py copies this file beside the package and compiles it with the same settings.
// Fields with a default may be left out of a request.

import assert from "node:assert/strict";

import { createClient, type Schemas } from "ricochet-client";

const [, , baseUrl] = process.argv;
const client = createClient({ baseUrl: baseUrl ?? "http://127.0.0.1:8000" });

const paper: Schemas["CriticalAngleCase"] = {
  projectile: {
    nose: { shape: "ogive", caliber_radius_head: 3.0 },
    diameter_m: 0.08,
    length_m: 0.53,
    mass_kg: 13.0,
  },
  target: { compressive_strength_pa: 39e6, density_kg_m3: 2250.0 },
  impact: { velocity_m_s: 238.0 },
};

function rough(velocity: number, customId: string): Schemas["CriticalAngleCase"] {
  const search = { lower_deg: 40.0, upper_deg: 80.0, tolerance_deg: 1.0 };
  return { ...paper, impact: { velocity_m_s: velocity }, search, custom_id: customId };
}

function given<T>(answer: { data?: T; error?: Schemas["Problem"] | undefined; response: Response }): T {
  assert.ok(answer.data !== undefined, `${answer.response.status}: ${JSON.stringify(answer.error)}`);
  return answer.data;
}

function refused(answer: { error?: Schemas["Problem"] | undefined; response: Response }, status: number) {
  assert.ok(answer.error, "an answer where a problem was due");
  assert.equal(answer.response.status, status);
  assert.equal(answer.error.status, status);
  return answer.error;
}

const jobOf = (id: string) => ({ path: { job_id: id } });

/** Submit cases as JSON lines, to be computed as a job. */
async function submitLines(cases: Schemas["CriticalAngleCase"][], idempotencyKey: string): Promise<Schemas["Job"]> {
  const answer = await client.POST("/cra/batch", {
    params: { header: { Prefer: "respond-async", "Idempotency-Key": idempotencyKey } },
    headers: { "Content-Type": "application/jsonl" },
    body: cases.map((each) => JSON.stringify(each) + "\n").join(""),
    bodySerializer: (lines) => lines as string,
  });
  assert.equal(answer.response.status, 202);
  const job = given(answer);
  assert.ok("links" in job);
  assert.equal(answer.response.headers.get("Location"), job.links.self);
  return job;
}

/** Yield every state of a job until its end, as the service reports them. */
async function* follow(id: string, lastEventId = ""): AsyncGenerator<[string, Schemas["Job"]]> {
  const params = { ...jobOf(id), header: { "Last-Event-ID": lastEventId } };
  const { data } = await client.GET("/jobs/{job_id}/events", { params, parseAs: "stream" });
  assert.ok(data);
  let text = "";
  for await (const chunk of data.pipeThrough(new TextDecoderStream())) {
    const events = (text + chunk).replaceAll("\r", "").split("\n\n");
    text = events.pop() ?? "";
    for (const event of events) {
      const eventId = /^id: (.*)$/m.exec(event)?.[1];
      const content = /^data: (.*)$/m.exec(event)?.[1];
      if (eventId !== undefined && content !== undefined) yield [eventId, JSON.parse(content)];
    }
  }
}

async function findOneAngle(): Promise<void> {
  const found = given(await client.POST("/cra", { body: paper }));
  assert.equal(found.status, "converged");
  assert.ok(Math.abs((found.critical_angle_deg ?? NaN) - 48.63) < 0.05, `${found.critical_angle_deg}`);
  assert.equal(found.iterations[0]?.outcome, "embedded");
  const again = given(await client.GET("/results/{key}", { params: { path: { key: found.key } } }));
  assert.deepEqual(again, found);
}

async function findSomeAtOnce(): Promise<void> {
  const answer = await client.POST("/cra/batch", { body: { cases: [rough(238.0, "slow"), rough(300.0, "fast")] } });
  const some = given(answer);
  assert.ok("results" in some);
  assert.deepEqual(some.results.map(({ index, custom_id }) => [index, custom_id]), [[0, "slow"], [1, "fast"]]);
  for (const { result, problem } of some.results) {
    assert.equal(problem, undefined);
    assert.equal(result?.status, "converged");
  }
}

async function sweepTwoAxes(): Promise<void> {
  const axes: Schemas["Axis"][] = [
    { field: "target.compressive_strength_pa", values: [39e6, 60e6] },
    { field: "impact.velocity_m_s", start: 230.0, stop: 238.0, count: 3 },
  ];
  const { custom_id: _, ...base } = rough(238.0, "");
  const swept = given(await client.POST("/cra/sweep", { body: { base, axes } }));
  assert.ok("results" in swept);
  assert.deepEqual(swept.results.map(({ index }) => index), [0, 1, 2, 3, 4, 5]);
}

async function calibrate(): Promise<void> {
  const { impact: _, ...shared } = paper;
  const tests: Schemas["DepthTest"][] = [
    { velocity_m_s: 238.1, depth_m: 0.3 },
    { velocity_m_s: 275.7, depth_m: 0.38 },
    { velocity_m_s: 314.0, depth_m: 0.45 },
    { velocity_m_s: 369.5, depth_m: 0.53 },
  ];
  const deep = given(await client.POST("/calibration/depth", { body: { ...shared, tests } }));
  assert.ok(Math.abs(deep.strength_factor - 8.44) < 0.02, `${deep.strength_factor}`);
  assert.equal(deep.residuals.length, tests.length);

  const impact = { velocity_m_s: 238.0, oblique_angle_deg: 40.0 };
  const shot = given(await client.POST("/trajectory", { body: { ...shared, impact } }));
  assert.ok(shot.history);
  const [first = NaN] = shot.history.axis_angle_deg;
  const history = { time_s: shot.history.time_s, rotation_deg: shot.history.axis_angle_deg.map((angle) => angle - first) };
  const oblique = given(await client.POST("/calibration/motion", { body: { ...shared, impact, history } }));
  assert.equal(oblique.residuals?.rotation_deg?.length, history.time_s.length);

  const points = [
    { oblique_angle_deg: 0.0, strength_factor: deep.strength_factor, standard_error: 0.1 },
    { oblique_angle_deg: 40.0, strength_factor: oblique.strength_factor, standard_error: 0.1 },
  ];
  const fit = given(await client.POST("/calibration/obliquity", { body: { points, order: 1 } }));
  const resistance = { strength_factor: fit.strength_factor_model };
  const found = given(await client.POST("/cra", { body: { ...paper, resistance } }));
  assert.ok(found.critical_angle_standard_error_deg);
  const again = given(await client.GET("/results/{key}", { params: { path: { key: fit.key } } }));
  assert.deepEqual(again, fit);
}

async function followAJob(): Promise<void> {
  const cases = Array.from({ length: 24 }, (_, number) => rough(239.0 + 0.01 * number, `case-${number}`));
  const token = `conversation-${process.pid}-${Date.now()}`;
  const job = await submitLines(cases, token);
  assert.equal((await submitLines(cases, token)).id, job.id);

  let last: [string, Schemas["Job"]] | undefined;
  for await (last of follow(job.id)) assert.equal(last[1].id, job.id);
  assert.ok(last);
  assert.equal(last[1].status, "successful");
  assert.deepEqual(given(await client.GET("/jobs/{job_id}", { params: jobOf(job.id) })), last[1]);
  for await (const [eventId, state] of follow(job.id, last[0])) assert.deepEqual([eventId, state], last);

  const items: Schemas["JobItem"][] = [];
  let cursor: string | undefined = "";
  while (cursor !== undefined) {
    const params = { ...jobOf(job.id), query: { cursor, limit: 10 } };
    const page: Schemas["JobResults"] = given(await client.GET("/jobs/{job_id}/results", { params }));
    items.push(...page.results);
    cursor = page.next;
  }
  assert.deepEqual(items.map(({ custom_id }) => custom_id), cases.map(({ custom_id }) => custom_id));
  for (const { result } of items) assert.ok(result && "critical_angle_deg" in result);
  await readOtherForms(job.id, items);

  const { jobs } = given(await client.GET("/jobs"));
  assert.ok(jobs.some(({ id }) => id === job.id));
}

async function readOtherForms(id: string, items: Schemas["JobItem"][]): Promise<void> {
  const ask = { params: jobOf(id) };
  const path = "/jobs/{job_id}/results";
  const csv = given(await client.GET(path, { ...ask, headers: { Accept: "text/csv" }, parseAs: "text" }));
  const [names, ...rows] = csv.trimEnd().split("\r\n");
  assert.ok(names?.split(",").includes("critical_angle_deg"), names);
  assert.equal(rows.length, items.length);
  const jsonl = given(await client.GET(path, { ...ask, headers: { Accept: "application/jsonl" }, parseAs: "text" }));
  assert.deepEqual(jsonl.trimEnd().split("\n").map((line) => JSON.parse(line)), items);
  const headers = { Accept: "application/x-hdf5" };
  const hdf5 = given(await client.GET(path, { ...ask, headers, parseAs: "arrayBuffer" }));
  assert.ok(Buffer.from(hdf5).includes("\x89HDF\r\n\x1a\n", 0, "latin1"));
}

async function cancelAJob(): Promise<void> {
  const { impact, ...strike } = paper;
  const cases: Schemas["TrajectoryCase"][] = Array.from({ length: 200 }, (_, number) => ({
    ...strike,
    impact: { ...impact, velocity_m_s: 260.0 + 1e-3 * number, oblique_angle_deg: 50.0 },
    numerics: { method: "panels", panels: 20_000 }, // It is slow, so that it still runs when it is cancelled.
  }));
  const params = { header: { Prefer: "respond-async" } };
  const job = given(await client.POST("/trajectory/batch", { params, body: { cases } }));
  assert.ok("links" in job);
  const cancelled = given(await client.POST("/jobs/{job_id}/cancel", { params: jobOf(job.id) }));
  assert.equal(cancelled.status, "dismissed");
  assert.ok(cancelled.counts.done < cancelled.counts.total);
  assert.deepEqual(given(await client.POST("/jobs/{job_id}/cancel", { params: jobOf(job.id) })), cancelled);
  const partial = given(await client.GET("/jobs/{job_id}/results", { params: jobOf(job.id) }));
  assert.ok(partial.results.length <= cancelled.counts.done);
  assert.equal((await client.DELETE("/jobs/{job_id}", { params: jobOf(job.id) })).response.status, 204);
  refused(await client.GET("/jobs/{job_id}", { params: jobOf(job.id) }), 404);
}

async function getProblems(): Promise<void> {
  const short = { ...paper, projectile: { ...paper.projectile, length_m: 0.1 } };
  const one = refused(await client.POST("/cra", { body: short }), 422);
  assert.deepEqual(one.errors.map(({ pointer }) => pointer), ["/projectile/length_m"]);
  const batch = refused(await client.POST("/cra/batch", { body: { cases: [paper, short] } }), 422);
  assert.deepEqual(batch.errors.map(({ pointer }) => pointer), ["/cases/1/projectile/length_m"]);
  const axes = [{ field: "impact.velocity", values: [238.0] }];
  const sweep = refused(await client.POST("/cra/sweep", { body: { base: paper, axes } }), 422);
  assert.deepEqual(sweep.errors.map(({ pointer }) => pointer), ["/axes/0/field"]);
  // @ts-expect-error: the compiler refuses a wrong type before the service does
  const fish = { ...paper, impact: { velocity_m_s: "fast" } } satisfies Schemas["CriticalAngleRequest"];
  const lines = await client.POST("/cra/batch", {
    headers: { "Content-Type": "application/jsonl" },
    body: [paper, fish].map((each) => JSON.stringify(each)).join("\n"),
    bodySerializer: (text) => text as string,
  });
  const line = refused(lines, 422);
  assert.deepEqual(line.errors.map(({ pointer }) => pointer), ["/1/impact/velocity_m_s"]);
  assert.match(line.detail, /line 2/);
}

for (const part of [findOneAngle, findSomeAtOnce, sweepTwoAxes, calibrate, followAJob, cancelAJob, getProblems]) {
  await part();
  console.log(part.name);
}
