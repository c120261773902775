/** Which point of one stored shape is which point of another. */

import { ApiError, getBytes, getJson, send, sendJson, type Job, type JobSummary, type Shape } from "../api/client";
import { finished } from "../jobs";
import type { View } from "../main";
import { at, radius, type Point } from "../scene/geometry";
import { readGlb } from "../scene/glb";
import { Matching, type Found } from "../scene/matching";
import { button, field, figure, h, percent, select } from "../ui/dom";
import { describe, notify, report } from "../ui/notices";
import { saveButton } from "../ui/save";
import { pictureOf, stage } from "../ui/stage";
import { waiting } from "../ui/waiting";

const TURNS = [
  ["keep", "Left is left"], ["reverse", "Left is right (mirrored)"], ["any", "Either"],
] as const;
const MOST_FACES = 1_000_000;
/** Shapes of one kind have a smaller residual, different kinds a larger one. */
const LARGE_RESIDUAL = 0.025;

/** Jobs of this session that have succeeded: the server keeps their files for a day. */
const done = new Map<string, string>();

export async function matchView(parts: string[], query: URLSearchParams, signal: AbortSignal): Promise<View> {
  const [first, second] = await Promise.all(parts.slice(0, 2).map((id) => getJson<Shape>(`shapes/${id}`, {}, signal)));
  if (!first || !second) throw new Error("This address needs the ids of two shapes.");
  const place = h("div", {});
  let running = new AbortController();
  signal.addEventListener("abort", () => running.abort());

  async function run(turn: string): Promise<void> {
    running.abort();
    running = new AbortController();
    const mine = running.signal;
    const stopped = (): void => {
      running.abort();
      place.replaceChildren(h("p", { class: "hint" }, "The match was cancelled."), button("Match again", () => void run(turn), { class: "plain" }));
    };
    const wait = waiting(`Matching ${first!.name} with ${second!.name} …`, stopped, true);
    place.replaceChildren(wait.element);
    try {
      const job = await matched(first!.id, second!.id, turn, wait.update, mine);
      const found = await getJson<Found>(`jobs/${job}/file`, {}, mine);
      const shown = await show(first!, second!, found, job, query, mine);
      if (!mine.aborted) place.replaceChildren(shown);
    } catch (error) {
      if (mine.aborted) return;
      place.replaceChildren(h("p", { class: "error" }, describe(error)), button("Match again", () => void run(turn), { class: "plain" }));
      if (!(error instanceof ApiError)) report(error);
    }
  }

  void run("keep");
  const link = ({ id, name, label }: Shape): HTMLElement => h("a", { href: `#/shape/${id}` }, label ? `${name} (${label})` : name);
  const element = h(
    "section",
    { class: "match" },
    h("h1", {}, "Which point is which?"),
    h("p", {}, "Each vertex of ", link(first), " has its point on ", link(second), "."),
    h(
      "div",
      { class: "row" },
      field("Sides", select(TURNS, "keep", (turn) => void run(turn))),
      h("a", { href: `#/match/${second.id}/${first.id}`, class: "quiet" }, "The other way round"),
      h("a", { href: `#/pair/${first.id}/${second.id}`, class: "quiet" }, "Compare signatures"),
    ),
    place,
  );
  return { title: `${first.name} and ${second.name}, point by point`, element };
}

/** Return the id of the succeeded job of a match. An unfinished job is cancelled when nobody waits for it. */
async function matched(a: string, b: string, orientation: string, progress: (job: JobSummary) => void, signal: AbortSignal): Promise<string> {
  const name = `${a} ${b} ${orientation}`;
  const known = done.get(name);
  if (known) {
    const still = await getJson<Job>(`jobs/${known}`, {}, signal).catch(() => null);
    if (still?.state === "succeeded") return known;
    signal.throwIfAborted();
  }
  const job = await sendJson<Job>("POST", "matches", { a, b, orientation });
  const cancel = (): void => void send(`jobs/${job.id}`, { method: "DELETE" }).catch(() => null);
  if (signal.aborted) cancel();
  signal.throwIfAborted();
  signal.addEventListener("abort", cancel);
  const ended = await finished(job, progress, signal);
  signal.removeEventListener("abort", cancel);
  if (ended.error) throw new ApiError(422, ended.error.code, ended.error.message, ended.error.advice);
  if (ended.state !== "succeeded") throw new Error("The match was cancelled.");
  done.set(name, job.id);
  return job.id;
}

async function show(a: Shape, b: Shape, found: Found, job: string, query: URLSearchParams, signal: AbortSignal): Promise<HTMLElement> {
  const [first, second] = (await Promise.all([a, b].map(({ id }) => getBytes(`shapes/${id}/view`, {}, signal)))).map(readGlb);
  const { faces = 0, full_faces: full = 0 } = second!.about;
  // The corners of triangles are vertices of the whole surface.
  const whole = full > faces ? readGlb(await getBytes(`shapes/${b.id}/view`, { faces: MOST_FACES }, signal)) : second!;
  const matching = new Matching(first!, second!, whole, found);
  const sizes = [first!, second!].map(({ positions }) => radius(positions) || 1); // both are shown equally large
  const contents = [first!, second!].map(({ positions, faces }, pane) => ({ positions: positions.map((v) => v / sizes[pane]!), faces }));
  const label = `${a.name} and ${b.name} in equal colours at equal places. Arrow keys turn them.`;
  const pictures = async (): Promise<HTMLElement> =>
    h("div", { class: "row" }, await Promise.all([a, b].map(({ id, name }) => pictureOf(id, name, { width: 480, height: 480 }))));
  const { element, viewer } = await stage(contents, first!.about.up ?? "z", label, pictures, signal, [a.name, b.name]);
  const maps = viewer && (await import("../scene/colours"));

  let colour = "place";
  const legend = h("div", { class: "legend", hidden: true }, h("span", {}, "0"), h("span", { class: "strip" }), h("span", {}, "1"));
  const paint = (): void => {
    if (!viewer || !maps) return;
    const rgb = matching.colours();
    rgb.forEach((each, pane) => viewer.colour({ kind: "colours", rgb: each }, pane));
    legend.hidden = colour !== "confidence";
    if (colour !== "confidence") return;
    viewer.colour({ kind: "field", values: matching.confidence, low: 0, high: 1, map: maps.SEQUENTIAL, contours: 0 }, 0);
    legend.querySelector<HTMLElement>(".strip")!.style.background = maps.SEQUENTIAL.css;
  };

  const words = h("output", { class: "lengths", "aria-live": "polite" });
  const number = h("input", { type: "number", min: 0, step: 1, placeholder: "vertex", "aria-label": `Vertex of ${a.name}` });

  function mark(vertex: number | null): void {
    if (vertex === null) {
      viewer?.mark(0, [], []);
      viewer?.mark(1, [], []);
      words.textContent = `No point of ${a.name} is matched here.`;
      return;
    }
    const own = first!.numbers![vertex]!;
    number.value = String(own);
    viewer?.mark(0, [vertex], []);
    const there = matching.has(vertex);
    viewer?.mark(1, there ? [at(matching.images, vertex).map((v) => v / sizes[1]!) as Point] : [], []);
    const corners = found.corners[own]!;
    const weights = found.barycentric[own]!;
    const nearest = corners[weights.indexOf(Math.max(...weights))];
    words.replaceChildren(
      ...(there
        ? [h("span", {}, `Vertex ${own} of ${a.name} is at vertex ${nearest} of ${b.name}.`), h("span", {}, "Confidence ", h("b", {}, figure(matching.confidence[vertex])))]
        : [`Vertex ${own} of ${a.name} has no point on ${b.name}.`]),
    );
  }

  const choose = (vertex: number, pane: number): void => mark(pane === 0 ? vertex : matching.back(vertex));
  function byNumber(): void {
    const wanted = number.valueAsNumber;
    const vertex = first!.numbers!.indexOf(wanted);
    if (vertex >= 0) mark(vertex);
    else notify(`${a.name} has no vertex ${number.value} in this view.`, undefined, "error");
  }

  if (viewer) {
    viewer.onpick = choose;
    viewer.onhover = choose;
  }
  paint();
  const asked = query.get("vertex");
  if (asked) {
    number.value = asked;
    byNumber();
  }
  return h(
    "div",
    {},
    judgement(a, b, matching),
    element,
    legend,
    words,
    viewer && h("p", { class: "hint" }, "Equal colours are equal places. Point at a place, or click it: the same place is marked on the other surface."),
    h(
      "div",
      { class: "controls" },
      h(
        "form",
        { class: "row measure", onsubmit: (event) => (event.preventDefault(), byNumber()) },
        field(`Vertex of ${a.name}`, number),
        h("button", { class: "plain" }, "Show its point"),
        viewer && field("Colour", select([["place", "Equal places"], ["confidence", `Confidence on ${a.name}`]], colour, (value) => ((colour = value), paint()))),
        saveButton("The points (json)", `jobs/${job}/file`),
      ),
    ),
  );
}

/** Say in words how far the match can be trusted. */
function judgement(a: Shape, b: Shape, { found, confidence, share }: Matching): HTMLElement {
  const mean = confidence.reduce((sum, value) => sum + value, 0) / (confidence.length || 1);
  const warnings = [
    found.residual > LARGE_RESIDUAL &&
      `Distances change much between the two (residual ${figure(found.residual)}): they may be different kinds of things, or one may be a part of the other.`,
    !found.oriented && "The sides of the triangles did not tell left from right: left and right may be swapped.",
    found.ambiguous && "Another match is nearly as good, as for a symmetric or round body. The page shows one of them.",
  ].filter((text) => text !== false);
  return h(
    "div",
    {},
    h("p", {}, `Mean confidence ${figure(mean)}, residual ${figure(found.residual)} (0 if distances are kept exactly).`),
    share < 1 && h("p", {}, `The points of ${a.name} cover ${percent(share)} of ${b.name}; the rest is grey.`),
    warnings.map((text) => h("p", { class: "warning" }, text)),
  );
}
