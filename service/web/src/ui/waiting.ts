/** What is shown while a job is on its way. */

import type { JobSummary } from "../api/client";
import { button, h } from "./dom";

export interface Waiting {
  element: HTMLElement;
  update: (job: JobSummary) => void;
}

export function waiting(first: string, cancel: () => void): Waiting {
  const bar = h("progress", { max: 1, "aria-label": "Progress" });
  const state = h("p", { class: "hint" }, first);
  const update = (job: JobSummary): void => {
    state.textContent = job.state === "queued" ? `${job.position ?? 0} jobs before it` : job.stage;
    bar.value = job.progress;
  };
  return { element: h("div", { class: "waiting" }, state, bar, button("Cancel", cancel, { class: "quiet" })), update };
}
