/** Ask what a mesh is, and what is like it. */

import { ApiError, getBytes, send, type Job, type Ranking, type Shape } from "../api/client";
import { finished, upload } from "../jobs";
import type { View } from "../main";
import { readGlb } from "../scene/glb";
import { beside } from "../ui/beside";
import { pick, takesDrops } from "../ui/drop";
import { button, coded, field, figure, h, percent, select } from "../ui/dom";
import { take } from "../ui/handed";
import { matchAddress, measures, PART_MEASURES, rankedList } from "../ui/nearest";
import { ask as question, describe, notify, report } from "../ui/notices";
import { hasWebGl, pictureOf } from "../ui/stage";
import { waiting, type Waiting } from "../ui/waiting";

const CLASSIFIERS = [
  ["nearest", "Nearest member"], ["vote", "Vote of neighbours"], ["mean", "Class mean"], ["discriminants", "Discriminants"],
] as const;
const SHOWN_CLASSES = 6;

export function askView(_: string[], query: URLSearchParams, signal: AbortSignal): View {
  let file: File | null = null;
  let guess = ""; // the class of the mesh, if it is known
  let measure = query.get("measure") ?? "spectrum";
  let classifier = query.get("classifier") ?? "nearest";
  let running = new AbortController();
  let comparing = new AbortController();
  let looking = new AbortController();
  let surface: Promise<ArrayBuffer> | null = null; // the view of the mesh

  const drop = h(
    "div",
    { class: "drop" },
    h("p", {}, "Drop a mesh here, or choose one, to ask what it is. It is not stored."),
    button("Choose a mesh", () => void pick(false).then((found) => begin(found[0]?.file)), { class: "primary" }),
  );
  const answer = h("div", { class: "answer", "aria-live": "polite" });
  const portrait = h("div", { class: "portrait" });
  const comparison = h("div", { class: "comparison" });
  const classes = select(CLASSIFIERS, classifier, (name) => ((classifier = name), void ask()));
  const options = h(
    "div",
    { class: "row" },
    field("Measure", measures(null, measure, (name) => ((measure = name), limit(), void ask()))),
    field("Classes by", classes),
  );
  const partHint = h("p", { class: "hint" }, "For a piece of a shape: which whole is it a part of, and how much of it? “In any unit” also tries other sizes.");
  const element = h("section", { class: "ask" }, h("h1", {}, "What is this?"), drop, options, partHint, answer, comparison);
  takesDrops(element, (found) => begin(found[0]?.file), signal);
  signal.addEventListener("abort", () => (running.abort(), looking.abort()));
  limit();

  /** Parts have no classifier but the nearest member. */
  function limit(): void {
    const parts = PART_MEASURES.includes(measure);
    classes.disabled = parts;
    if (parts) classes.value = classifier = "nearest";
    partHint.hidden = !parts;
  }

  function begin(chosen: File | undefined): void {
    if (!chosen) return;
    file = chosen;
    comparing.abort();
    comparison.replaceChildren();
    looking.abort();
    looking = new AbortController();
    surface = null;
    portrait.replaceChildren();
    void ask();
  }

  async function viewOf(mesh: File, signal: AbortSignal): Promise<ArrayBuffer> {
    return (await send("views", { method: "POST", body: form(mesh), signal })).arrayBuffer();
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
    const wait = waiting(`Reading ${file.name} …`, () => running.abort());
    answer.replaceChildren(wait.element);
    const data = form(file);
    data.set("measure", measure);
    data.set("classifier", classifier);
    data.set("k", "12");
    try {
      const response = await send("queries", { method: "POST", body: data, headers: { Prefer: "wait=1" }, signal: mine });
      if (response.status === 200) return show((await response.json()) as Ranking);
      const job = await finished((await response.json()) as Job, wait.update, mine);
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
    guess = best && ranking.known !== false ? best.label : "";
    answer.replaceChildren(
      h("h2", {}, file?.name ?? ""),
      h("div", { class: "row" }, portrait, verdict(ranking)),
      h("div", {}, (ranking.warnings ?? []).map((text) => h("p", { class: "warning" }, coded(text)))),
      addForm(),
      ranking.classes.length ? classTable(ranking) : "",
      h("h2", {}, "Nearest shapes"),
      ranking.shapes.length
        ? rankedList(ranking.shapes, (shape) =>
            h(
              "div",
              { class: "links" },
              button("Compare", () => void compare(shape), { class: "quiet", "aria-label": `Compare ${shape.name} with the mesh` }),
              button("Match points", () => void match(shape), { class: "quiet", "aria-label": `Match points of ${shape.name} with the mesh` }),
            ),
          )
        : h("p", { class: "hint" }, "There are none."),
    );
    void look();
  }

  /** Show the mesh beside the answer. The answer stands without it, so a failure is not reported. */
  async function look(): Promise<void> {
    if (!file || surface || !hasWebGl()) return;
    const asked = file;
    const mine = looking.signal;
    surface = viewOf(asked, mine);
    try {
      const { positions, faces, about } = readGlb(await surface);
      const { Viewer } = await import("../scene/viewer");
      if (mine.aborted) return;
      const viewer = new Viewer([{ positions, faces }], about.up ?? "z", `Picture of ${asked.name}`);
      mine.addEventListener("abort", () => viewer.dispose());
      viewer.canvas.tabIndex = -1; // a picture: “Compare” shows a view that can be turned
      portrait.replaceChildren(viewer.canvas);
    } catch {
      if (!mine.aborted) surface = null; // “Compare” asks again, and says what went wrong
    }
  }

  function addForm(): HTMLElement {
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
        surface ?? viewOf(asked, mine),
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

  /** Matches are of stored shapes: store the mesh if the person agrees, and open the match. */
  async function match(shape: Ranking["shapes"][number]): Promise<void> {
    if (!file) return;
    const asked = file;
    const label = h("input", { type: "text", value: guess, maxlength: 200, placeholder: "no class" });
    const text = `Points are matched between two shapes of the library. ${asked.name} is not one yet. “Add and match” stores it in the library, with this class; you can change or remove it later.`;
    if (!(await question("Match points", "Add and match", h("p", {}, text), field("Class", label)))) return;
    running.abort();
    running = new AbortController();
    const mine = running.signal;
    const before = [...answer.childNodes];
    const wait = waiting(`Storing ${asked.name} …`, () => running.abort());
    answer.replaceChildren(wait.element);
    try {
      const id = await store(asked, label.value.trim(), wait.update, mine);
      location.hash = matchAddress(id, shape);
    } catch (error) {
      if (running.signal === mine) answer.replaceChildren(...before);
      if (!mine.aborted) report(error);
    }
  }

  /** Store a mesh, and return its id. */
  async function store(of: File, label: string, progress: Waiting["update"], until: AbortSignal): Promise<string> {
    const data = form(of);
    if (label) data.set("label", label);
    const response = await send("shapes", { method: "POST", body: data, signal: until });
    if (response.status === 200) return ((await response.json()) as Shape).id;
    const sent = (await response.json()) as Job;
    const cancel = (): void => void send(`jobs/${sent.id}`, { method: "DELETE" }).catch(() => null);
    until.addEventListener("abort", cancel);
    const job = await finished(sent, progress, until);
    until.removeEventListener("abort", cancel);
    if (job.error) throw new ApiError(422, job.error.code, job.error.message, job.error.advice);
    if (!job.shape_id) throw new Error("The upload was cancelled.");
    return job.shape_id;
  }

  begin(take() ?? undefined);
  return { title: "Ask", element };
}

function verdict(ranking: Ranking): HTMLElement {
  const best = ranking.classes[0];
  if (!best) {
    const words = ranking.shapes.length
      ? "The library has no classes yet, but it has shapes to compare with."
      : "The library has nothing to compare this mesh with.";
    return h("p", { class: "verdict" }, words);
  }
  const parts = PART_MEASURES.includes(ranking.measure);
  if (ranking.known === false) {
    const doubt = parts
      ? "It fits the nearest shape less well than the same place of other members of that class does, or it fits several classes equally well."
      : "It is too far from the nearest class, for the distances between the shapes of that class.";
    return h(
      "div",
      { class: "verdict unknown" },
      h("strong", {}, "Unknown"),
      h("p", {}, `${doubt} The nearest class is ${best.label}, at a distance of ${figure(best.distance)}.`),
    );
  }
  const words =
    ranking.known === null
      ? "This class has too few members to tell whether the mesh really belongs to it."
      : parts
        ? "It fits the nearest shape about as well as the same place of other members of the class does."
        : "The mesh is near enough to this class, for the distances between the shapes of the class.";
  return h("div", { class: "verdict" }, h("strong", {}, best.label), h("span", {}, ` confidence ${percent(best.confidence)}`), h("p", {}, words));
}

function classTable(ranking: Ranking): HTMLElement {
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
