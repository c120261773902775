/** What is shown while a job is on its way. */

import type { JobSummary } from "../api/client";
import { button, h, plural } from "./dom";

export interface Waiting {
  element: HTMLElement;
  update: (job: JobSummary) => void;
}

/** `steady` stays while the job runs, with its seconds, for jobs that have a single stage. */
export function waiting(first: string, cancel: () => void, steady = false): Waiting {
  const bar = h("progress", { max: 1, "aria-label": "Progress" });
  const state = h("p", { class: "hint" }, first);
  const update = (job: JobSummary): void => {
    if (job.state === "queued") state.textContent = job.position ? `${plural(job.position, "job")} before it` : "Next in the queue";
    else if (steady) state.textContent = `${first} ${(job.detail["seconds"] ?? 0).toFixed(0)} s`;
    else {
      state.textContent = job.stage;
      bar.value = job.progress;
    }
  };
  return { element: h("div", { class: "waiting" }, state, bar, button("Cancel", cancel, { class: "quiet" })), update };
}
