/** The HTTP API: requests, errors, the key of this session, and whether the server answers. */

import type { components } from "./schema";

type Schemas = components["schemas"];
export type Shape = Schemas["Shape"];
export type ShapePage = Schemas["ShapePage"];
export type Job = Schemas["Job"];
export type JobSummary = Schemas["JobSummary"];
export type Part = Schemas["Part"];
export type Ranking = Schemas["Ranking"];
export type ShapeMap = Schemas["ShapeMap"];
export type Evaluation = Schemas["EvaluationResult"];
export type Distances = Schemas["Distances"];

/** The path of the API, found from that of this script, so that any path prefix works. */
const BASE = import.meta.env.DEV ? new URL("/v1/", location.href) : new URL("../v1/", import.meta.url);
const KEY = "unbend.key";
const RETRY_MS = 1000;
const MOST_RETRIES = 30;
const MOST_LATE = 3; // a first start compiles kernels, which may take longer than a request

export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly code: string,
    message: string,
    readonly advice = "",
  ) {
    super(message);
  }
}

/** Dispatches "away" and "back" when the server stops and begins to answer, and "key" when it asks for a key. */
export const server = new EventTarget();

let away = false;

export function key(): string | null {
  return sessionStorage.getItem(KEY);
}

export function setKey(value: string | null): void {
  if (value) sessionStorage.setItem(KEY, value);
  else sessionStorage.removeItem(KEY);
}

export type Query = Record<string, string | number | boolean | null | undefined>;

export function url(path: string, query: Query = {}): string {
  const target = new URL(path, BASE);
  for (const [name, value] of Object.entries(query)) {
    if (value !== null && value !== undefined) target.searchParams.set(name, String(value));
  }
  return target.href;
}

/** Send a request; wait and repeat while the server is busy. Throws ApiError for every other failure. */
export async function send(path: string, init: RequestInit = {}, query: Query = {}): Promise<Response> {
  const headers = new Headers(init.headers);
  const secret = key();
  if (secret) headers.set("Authorization", `Bearer ${secret}`);
  for (let attempt = 0; ; attempt++) {
    let response: Response;
    try {
      response = await fetch(url(path, query), { ...init, headers });
    } catch (error) {
      if (error instanceof DOMException) throw error; // aborted
      lost();
      throw new ApiError(0, "away", "The server does not answer.");
    }
    if (response.ok) return response;
    if (response.status === 429 && attempt < MOST_RETRIES) {
      const seconds = Number(response.headers.get("Retry-After"));
      await pause(Math.min(10_000, (seconds || 1) * RETRY_MS), init.signal);
      continue;
    }
    if (response.status === 504 && attempt < MOST_LATE && (init.method ?? "GET") === "GET") continue;
    // An answer that comes late, to a request without the newest key, says nothing about that key.
    if (response.status === 401 && key() === secret) server.dispatchEvent(new Event("key"));
    throw await problem(response);
  }
}

async function problem(response: Response): Promise<ApiError> {
  const text = await response.text();
  let body: Partial<Schemas["Problem"]> = {};
  try {
    body = JSON.parse(text) as typeof body;
  } catch {
    // A proxy may answer in its own words.
  }
  const fields = (body.errors ?? []).map((each) => `${each.field}: ${each.message}`);
  const message = fields.length ? fields.join("; ") : (body.detail ?? `The server answered ${response.status}.`);
  return new ApiError(response.status, body.code ?? "unknown", message, body.advice ?? "");
}

export async function getJson<T>(path: string, query: Query = {}, signal?: AbortSignal): Promise<T> {
  return (await (await send(path, { signal }, query)).json()) as T;
}

export async function getBytes(path: string, query: Query = {}, signal?: AbortSignal): Promise<ArrayBuffer> {
  return (await send(path, { signal }, query)).arrayBuffer();
}

export async function sendJson<T>(method: string, path: string, body: unknown): Promise<T> {
  const headers = { "Content-Type": "application/json" };
  return (await (await send(path, { method, headers, body: JSON.stringify(body) })).json()) as T;
}

export function pause(milliseconds: number, signal?: AbortSignal | null): Promise<void> {
  const { promise, resolve, reject } = Promise.withResolvers<void>();
  const timer = setTimeout(resolve, milliseconds);
  signal?.addEventListener("abort", () => (clearTimeout(timer), reject(signal.reason as Error)));
  return promise;
}

/** Say that the server is away, and ask until it is back. */
function lost(): void {
  if (away) return;
  away = true;
  server.dispatchEvent(new Event("away"));
  const probe = async (): Promise<void> => {
    try {
      if ((await fetch(url("readyz"), { cache: "no-store" })).ok) {
        away = false;
        server.dispatchEvent(new Event("back"));
        return;
      }
    } catch {
      // Still away.
    }
    setTimeout(() => void probe(), 2 * RETRY_MS);
  };
  setTimeout(() => void probe(), RETRY_MS);
}

/** Read the events of all jobs until `signal`; connects again by itself. A key cannot be sent by EventSource. */
export async function followJobs(receive: (job: JobSummary) => void, opened: () => void, signal: AbortSignal): Promise<void> {
  while (!signal.aborted) {
    try {
      const response = await send("jobs/events", { signal });
      opened();
      let rest = "";
      for await (const piece of response.body!.pipeThrough(new TextDecoderStream())) {
        const blocks = (rest + piece).split("\n\n");
        rest = blocks.pop() ?? "";
        for (const block of blocks) {
          if (block.startsWith("data: ")) receive(JSON.parse(block.slice(6)) as JobSummary);
        }
      }
    } catch (error) {
      if (signal.aborted) return;
      if (error instanceof ApiError && error.status === 401) return; // starts again with a key
      if (!(error instanceof ApiError)) lost(); // the connection broke
    }
    await pause(2 * RETRY_MS);
  }
}
