/** The jobs of this session: uploads and queries on their way, one stream of progress for all, and a panel. */

import { ApiError, followJobs, getJson, key, send, server, type Job, type JobSummary, type Shape } from "./api/client";
import { describe } from "./ui/notices";
import { button, h, plural } from "./ui/dom";

const UPLOADS_AT_ONCE = 3;
const FILES = /\.(off|obj|ply|stl|glb)$/i;

export interface Upload {
  file: File;
  label: string | null;
}

interface Entry {
  name: string;
  state: "waiting" | "sending" | JobSummary["state"] | "known";
  job: JobSummary | null;
  message: string;
  remarks: string[];
  shapeId: string | null;
  sending: AbortController | null;
}

const entries: Entry[] = [];
const byJob = new Map<string, Entry>();
const pending: { entry: Entry; upload: Upload }[] = [];
let sending = 0;
let stream: AbortController | null = null;

/** Dispatches "stored" when a shape was added to the library. */
export const library = new EventTarget();

export function isMesh(file: File): boolean {
  return FILES.test(file.name);
}

/** Send files to the library. */
export function upload(uploads: Upload[]): void {
  follow();
  for (const each of uploads) {
    const entry: Entry = {
      name: each.file.name, state: "waiting", job: null, message: "", remarks: [], shapeId: null, sending: null,
    };
    entries.push(entry);
    pending.push({ entry, upload: each });
  }
  panel.hidden = false;
  details.open = true;
  draw();
  void next();
}

async function next(): Promise<void> {
  while (sending < UPLOADS_AT_ONCE && pending.length) {
    const { entry, upload: each } = pending.shift()!;
    if (entry.state === "cancelled") continue;
    sending++;
    entry.state = "sending";
    entry.sending = new AbortController();
    draw();
    void post(entry, each).finally(() => {
      sending--;
      draw();
      void next();
    });
  }
}

async function post(entry: Entry, each: Upload): Promise<void> {
  const form = new FormData();
  form.set("file", each.file);
  if (each.label) form.set("label", each.label);
  try {
    const response = await send("shapes", { method: "POST", body: form, signal: entry.sending?.signal });
    if (response.status === 200) {
      const shape = (await response.json()) as Shape & { ignored: string[] };
      entry.state = "known";
      entry.shapeId = shape.id;
      entry.message = shape.ignored.length
        ? `already stored as ${shape.name}; its ${shape.ignored.join(" and ")} stayed as it was`
        : `already stored as ${shape.name}`;
    } else {
      const job = (await response.json()) as Job;
      byJob.set(job.id, entry);
      receive(early.get(job.id) ?? job);
      early.delete(job.id);
    }
  } catch (error) {
    if (entry.sending?.signal.aborted) {
      entry.state = "cancelled";
    } else if (error instanceof ApiError && error.code === "away") {
      entry.state = "waiting"; // until the server is back
      pending.unshift({ entry, upload: each });
      await new Promise((resolve) => server.addEventListener("back", resolve, { once: true }));
    } else {
      entry.state = "failed";
      entry.message = describe(error);
    }
  }
}

/** Events of jobs whose upload has not been answered yet. */
const early = new Map<string, JobSummary>();

/** Jobs that somebody waits for. */
const waiters = new Map<string, (job: JobSummary) => void>();

/** Call `progress` with each event of a job until it ends; resolve with the ended job. */
export async function finished(job: Job, progress: (job: JobSummary) => void, signal: AbortSignal): Promise<Job> {
  follow();
  waiters.set(job.id, progress);
  try {
    for (;;) {
      const now = await getJson<Job>(`jobs/${job.id}`, { wait: 20 }, signal);
      progress(now);
      if (isFinal(now)) return now;
    }
  } finally {
    waiters.delete(job.id);
  }
}

export function isFinal(job: JobSummary): boolean {
  return job.state === "succeeded" || job.state === "failed" || job.state === "cancelled";
}

/** Open the stream of all jobs. */
function follow(): void {
  if (stream) return;
  stream = new AbortController();
  let isFirst = true;
  const opened = (): void => {
    if (!isFirst) library.dispatchEvent(new Event("stored")); // others may have stored shapes while no stream was open
    isFirst = false;
    void catchUp();
  };
  void followJobs(receive, opened, stream.signal).finally(() => (stream = null));
}

/** Read the jobs that ended while no stream was open. */
async function catchUp(): Promise<void> {
  for (const [id, entry] of byJob) {
    if (entry.job && isFinal(entry.job)) continue;
    try {
      receive(await getJson<Job>(`jobs/${id}`));
    } catch (error) {
      if (error instanceof ApiError && error.status === 404) {
        entry.state = "failed";
        entry.message = "the server does not know this job any more";
        byJob.delete(id);
      }
    }
  }
  draw();
}

function receive(job: JobSummary): void {
  waiters.get(job.id)?.(job);
  const entry = byJob.get(job.id);
  if (!entry) {
    if (job.kind === "shape") early.set(job.id, job);
    if (early.size > 500) early.delete(early.keys().next().value!);
    if (job.kind === "shape" && job.state === "succeeded") library.dispatchEvent(new Event("stored"));
    return;
  }
  if (entry.job && isFinal(entry.job)) return;
  entry.job = job;
  entry.state = job.state;
  if (job.error) entry.message = [job.error.message, job.error.advice].filter(Boolean).join(" – ");
  if (job.state === "succeeded" && job.shape_id) {
    entry.shapeId = job.shape_id;
    entry.remarks = job.warnings;
    library.dispatchEvent(new Event("stored"));
    void remark(entry, job.shape_id);
  }
  draw();
}

/** Add what reading the file found and repaired. */
async function remark(entry: Entry, shapeId: string): Promise<void> {
  try {
    const shape = await getJson<Shape>(`shapes/${shapeId}`);
    entry.remarks = [...shape.warnings, ...((shape.report["notes"] as string[] | undefined) ?? [])];
    draw();
  } catch {
    // The shape may have been removed meanwhile.
  }
}

async function cancel(entry: Entry): Promise<void> {
  entry.sending?.abort();
  if (entry.job) await send(`jobs/${entry.job.id}`, { method: "DELETE" }).catch(() => null);
  entry.state = "cancelled";
  draw();
}

const list = h("ul", { class: "jobs" });
const summary = h("summary", {}, "Uploads");
const details = h("details", { open: true }, summary, list);
const panel = h(
  "aside",
  { class: "panel", "aria-label": "Uploads", hidden: true },
  details,
  button("Clear finished uploads", clear, { class: "quiet" }),
);
document.body.append(panel);

const MOST_SHOWN = 200;
let drawing = false;
let allDone = false;

/** Draw the panel once a frame at most. */
function draw(): void {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    const failed = entries.filter((entry) => entry.state === "failed").length;
    const done = entries.filter(isDone).length - failed;
    const state = `${done} of ${plural(entries.length, "upload")} done`;
    summary.textContent = failed ? `${state}, ${failed} failed` : state;
    // The first that still run, and those that failed, are shown above all.
    const order = [...entries].sort((a, b) => rank(a) - rank(b)).slice(0, MOST_SHOWN);
    list.replaceChildren(...order.map(row));
    panel.hidden = entries.length === 0;
    const ended = entries.length > 0 && entries.every(isDone);
    if (ended && !allDone) {
      // Messages stay in sight; without any, the panel makes room for the library.
      if (!entries.some((entry) => entry.message) && !list.contains(document.activeElement)) details.open = false;
      library.dispatchEvent(new Event("stored")); // an event may have been missed
    }
    allDone = ended;
  });
}

function rank(entry: Entry): number {
  if (entry.state === "failed") return 0;
  if (entry.state === "running" || entry.state === "sending") return 1;
  return isDone(entry) ? 3 : 2;
}

function isDone(entry: Entry): boolean {
  return ["succeeded", "failed", "cancelled", "known"].includes(entry.state);
}

function row(entry: Entry): HTMLElement {
  const link = entry.shapeId && h("a", { href: `#/shape/${entry.shapeId}` }, entry.name);
  return h(
    "li",
    { class: entry.state },
    h(
      "div",
      { class: "row" },
      link || h("span", { class: "grow" }, entry.name),
      h("span", { class: "state" }, words(entry)),
      !isDone(entry) && button("Cancel", () => void cancel(entry), { class: "quiet", "aria-label": `Cancel ${entry.name}` }),
    ),
    entry.state === "running" &&
      h("progress", { max: 1, value: entry.job?.progress ?? 0, "aria-label": `Progress of ${entry.name}` }),
    entry.message && h("p", { class: entry.state === "failed" ? "error" : "hint" }, entry.message),
    entry.remarks.map((text) => h("p", { class: "hint" }, text)),
  );
}

function words(entry: Entry): string {
  switch (entry.state) {
    case "queued":
      return "queued"; // its place changes with every job that ends, and no event says so
    case "running":
      return entry.job?.stage ?? "running";
    case "succeeded":
      return "done";
    default:
      return entry.state;
  }
}

function clear(): void {
  for (const [id, entry] of byJob) if (isDone(entry)) byJob.delete(id);
  entries.splice(0, entries.length, ...entries.filter((entry) => !isDone(entry)));
  draw();
}

/** Follow the jobs again, with another key. */
export function restart(): void {
  stream?.abort();
  stream = null;
  if (key() || entries.length) follow();
}

export { follow };
