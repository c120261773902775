/** Ask what a mesh is, and what is like it. */

import { ApiError, getBytes, send, type Job, type JobSummary, type Ranking } from "../api/client";
import { finished, upload } from "../jobs";
import type { View } from "../main";
import { readGlb } from "../scene/glb";
import { beside } from "../ui/beside";
import { pick, takesDrops } from "../ui/drop";
import { button, field, figure, h, percent, select } from "../ui/dom";
import { measures, rankedList } from "../ui/nearest";
import { describe, notify, report } from "../ui/notices";
import { pictureOf } from "../ui/stage";

const CLASSIFIERS = [
  ["nearest", "Nearest member"], ["vote", "Vote of neighbours"], ["mean", "Class mean"], ["discriminants", "Discriminants"],
] as const;
const SHOWN_CLASSES = 6;

export function askView(_: string[], query: URLSearchParams, signal: AbortSignal): View {
  let file: File | null = null;
  let measure = query.get("measure") ?? "spectrum";
  let classifier = query.get("classifier") ?? "nearest";
  let running = new AbortController();
  let comparing = new AbortController();

  const drop = h(
    "div",
    { class: "drop" },
    h("p", {}, "Drop a mesh here, or choose one, to ask what it is. It is not stored."),
    button("Choose a mesh", () => void pick(false).then((found) => begin(found[0]?.file)), { class: "primary" }),
  );
  const answer = h("div", { class: "answer", "aria-live": "polite" });
  const comparison = h("div", { class: "comparison" });
  const options = h(
    "div",
    { class: "row" },
    field("Measure", measures(null, measure, (name) => ((measure = name), void ask()))),
    field("Classes by", select(CLASSIFIERS, classifier, (name) => ((classifier = name), void ask()))),
  );
  const element = h("section", { class: "ask" }, h("h1", {}, "What is this?"), drop, options, answer, comparison);
  takesDrops(element, (found) => begin(found[0]?.file), signal);
  signal.addEventListener("abort", () => running.abort());

  function begin(chosen: File | undefined): void {
    if (!chosen) return;
    file = chosen;
    comparing.abort();
    comparison.replaceChildren();
    void ask();
  }

  function form(of: File): FormData {
    const data = new FormData();
    data.set("file", of);
    return data;
  }

  async function ask(): Promise<void> {
    if (!file) return;
    running.abort();
    running = new AbortController();
    const mine = running.signal;
    const bar = h("progress", { max: 1, "aria-label": "Progress" });
    const state = h("p", { class: "hint" }, `Reading ${file.name} …`);
    answer.replaceChildren(state, bar, button("Cancel", () => running.abort(), { class: "quiet" }));
    const data = form(file);
    data.set("measure", measure);
    data.set("classifier", classifier);
    data.set("k", "12");
    try {
      const response = await send("queries", { method: "POST", body: data, headers: { Prefer: "wait=1" }, signal: mine });
      if (response.status === 200) return show((await response.json()) as Ranking);
      const progress = (job: JobSummary): void => {
        state.textContent = job.state === "queued" ? `${job.position ?? 0} jobs before it` : job.stage;
        bar.value = job.progress;
      };
      const job = await finished((await response.json()) as Job, progress, mine);
      if (job.error) throw new ApiError(422, job.error.code, job.error.message, job.error.advice);
      if (job.result) show(job.result);
    } catch (error) {
      if (mine.aborted) {
        if (running.signal === mine) answer.replaceChildren();
        return;
      }
      answer.replaceChildren(h("p", { class: "error" }, describe(error)));
      report(error);
    }
  }

  function show(ranking: Ranking): void {
    const best = ranking.classes[0];
    answer.replaceChildren(
      h("h2", {}, file?.name ?? ""),
      verdict(ranking),
      h("div", {}, (ranking.warnings ?? []).map((text) => h("p", { class: "warning" }, text))),
      addForm(best && ranking.known !== false ? best.label : ""),
      ranking.classes.length ? classes(ranking) : "",
      h("h2", {}, "Nearest shapes"),
      ranking.shapes.length
        ? rankedList(ranking.shapes, (shape) => button("Compare", () => void compare(shape), { class: "quiet", "aria-label": `Compare ${shape.name} with the mesh` }))
        : h("p", { class: "hint" }, "The library has no shape to compare with."),
    );
  }

  function addForm(guess: string): HTMLElement {
    const label = h("input", { type: "text", value: guess, "aria-label": "Class of the new shape", maxlength: 200 });
    const add = (): void => {
      if (!file) return;
      upload([{ file, label: label.value.trim() || null }]);
      notify(`${file.name} is on its way to the library.`);
    };
    return h("form", { class: "row", onsubmit: (event) => (event.preventDefault(), add()) }, h("button", { class: "plain" }, "Add it to the library as"), label);
  }

  async function compare(shape: Ranking["shapes"][number]): Promise<void> {
    if (!file) return;
    const asked = file; // another may be asked about before the views are here
    comparing.abort();
    comparing = new AbortController();
    const mine = comparing.signal;
    signal.addEventListener("abort", () => comparing.abort());
    comparison.replaceChildren(h("p", { class: "hint loading" }, "Computing the view …"));
    comparison.scrollIntoView({ block: "nearest" });
    try {
      const [own, other] = await Promise.all([
        send("views", { method: "POST", body: form(asked), signal: mine }).then((response) => response.arrayBuffer()),
        getBytes(`shapes/${shape.id}/view`, {}, mine),
      ]);
      const title = `${asked.name} and ${shape.name}`;
      const fallback = (): Promise<HTMLElement> => pictureOf(shape.id, shape.name, { width: 480, height: 480 });
      const shown = await beside(readGlb(own), readGlb(other), title, fallback, mine, [asked.name, shape.name]);
      if (mine.aborted) return;
      comparison.replaceChildren(h("h2", {}, title), shown);
      comparison.scrollIntoView({ block: "nearest" });
    } catch (error) {
      if (mine.aborted) return;
      comparison.replaceChildren();
      report(error);
    }
  }

  return { title: "Ask", element };
}

function verdict(ranking: Ranking): HTMLElement {
  const best = ranking.classes[0];
  if (!best) return h("p", { class: "verdict" }, "The library has no classes yet, but it has shapes to compare with.");
  if (ranking.known === false) {
    return h(
      "div",
      { class: "verdict unknown" },
      h("strong", {}, "Unknown"),
      h("p", {}, `It is farther from every class than members of a class are from each other. The nearest class is ${best.label}, at a distance of ${figure(best.distance)}.`),
    );
  }
  const words =
    ranking.known === null
      ? "This class has too few members to tell whether the mesh really belongs to it."
      : "It is as near to this class as its members are to each other.";
  return h("div", { class: "verdict" }, h("strong", {}, best.label), h("span", {}, ` confidence ${percent(best.confidence)}`), h("p", {}, words));
}

function classes(ranking: Ranking): HTMLElement {
  return h(
    "table",
    { class: "classes" },
    h("caption", {}, "Classes, the nearest first. Confidence is the probability of a class, if the mesh belongs to any of them."),
    h("thead", {}, h("tr", {}, ["Class", "Confidence", "Distance"].map((text) => h("th", { scope: "col" }, text)))),
    h(
      "tbody",
      {},
      ranking.classes.slice(0, SHOWN_CLASSES).map((each) =>
        h(
          "tr",
          {},
          h("th", { scope: "row" }, each.label),
          h("td", {}, h("meter", { min: 0, max: 1, value: each.confidence, "aria-label": `Confidence of ${each.label}` }), ` ${percent(each.confidence)}`),
          h("td", {}, figure(each.distance)),
        ),
      ),
    ),
  );
}
