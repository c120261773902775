/** One shape: its surface beside its signature, bent into each other, with distances and paths on both. */

import { getBytes, getJson, sendJson, type Distances, type Ranking, type Shape } from "../api/client";
import type { View } from "../main";
import { at, centred, distance, vertexAreas, type Point } from "../scene/geometry";
import { readGlb } from "../scene/glb";
import { cutOff } from "../scene/patch";
import { button, coded, field, figure, h, percent, plural, select } from "../ui/dom";
import { hand } from "../ui/handed";
import { matchAddress, measures, rankByShape, rankedList } from "../ui/nearest";
import { notify, report } from "../ui/notices";
import { saveButton } from "../ui/save";
import { pictureOf, stage } from "../ui/stage";

const UNKNOWN = 3.4e38; // the shader leaves such values uncoloured
const CONTOURS = 18;
const NEAREST = 12;
const MOST_FACES = 1_000_000; // of a view from which a patch is cut
const MEANINGS: Record<string, string> = {
  Stress: "How much distances in the signature differ from those along the surface: 0 if not at all",
  "Energy captured": "Share of the squared distances that the signature's dimensions represent",
  "Effective dimension": "Dimensions that the surface would need for an error of 5 %",
  Samples: "Points of the surface between which distances were measured",
  Method: "How points in space are found whose distances are those along the surface",
};
const METHODS: Record<string, string> = { least_squares: "Least squares", classical: "Classical scaling", fast: "Fast embedding" };
const AXES = ["y", "z", "x", "-y", "-z", "-x"];

export async function shapeView(parts: string[], query: URLSearchParams, signal: AbortSignal): Promise<View> {
  const id = parts[0] ?? "";
  const shape = await getJson<Shape>(`shapes/${id}`, {}, signal);
  const place = h("div", { class: "stage-place" }, h("p", { class: "hint loading" }, "Loading the surface and its signature …"));
  const element = h(
    "section",
    { class: "shape" },
    heading(shape),
    h("div", { class: "columns" }, place, h("div", { class: "side" }, facts(shape), await numbers(shape, signal), downloads(shape))),
    nearest(shape, query, signal),
  );
  void show(shape, place, query, signal).catch((error: unknown) => {
    if (signal.aborted) return;
    place.replaceChildren(h("p", { class: "error" }, error instanceof Error ? error.message : "The surface could not be shown."));
    report(error);
  });
  return { title: shape.name, element };
}

function heading(shape: Shape): HTMLElement {
  const name = h("input", { type: "text", value: shape.name, "aria-label": "Name", class: "title", maxlength: 200 });
  const label = h("input", { type: "text", value: shape.label ?? "", "aria-label": "Class", placeholder: "no class", class: "class", maxlength: 200 });
  const title = h("h1", { class: "hidden" }, shape.name);
  const save = async (changes: { name?: string; label?: string | null }, undo = true): Promise<void> => {
    const before = { name: shape.name, label: shape.label };
    try {
      const record = await sendJson<Shape>("PATCH", `shapes/${shape.id}`, changes);
      Object.assign(shape, { name: record.name, label: record.label });
      if (undo) notify("Saved.", { text: "Undo", run: () => void save(before, false) });
    } catch (error) {
      report(error);
    }
    name.value = shape.name;
    label.value = shape.label ?? "";
    title.textContent = shape.name;
  };
  name.addEventListener("change", () => void save({ name: name.value.trim() || shape.name }));
  label.addEventListener("change", () => void save({ label: label.value.trim() || null }));
  const back = h("a", { href: "#/library", class: "quiet" }, "← Library");
  return h("div", { class: "heading" }, back, title, name, h("div", { class: "row" }, h("span", { class: "hint" }, "class"), label));
}

async function show(shape: Shape, place: HTMLElement, query: URLSearchParams, signal: AbortSignal): Promise<void> {
  const mesh = readGlb(await getBytes(`shapes/${shape.id}/view`, {}, signal));
  const form = centred(mesh.form!);
  const contents = [
    { positions: mesh.positions, faces: mesh.faces, form },
    { positions: mesh.positions, faces: mesh.faces, form, bend: 1 },
  ];
  // Files do not say which axis points upwards: a person's choice counts more than a guess.
  const up = localStorage.getItem(`unbend.up.${shape.id}`) ?? mesh.about.up ?? "z";
  const label = `The surface of ${shape.name} beside its signature. Arrow keys turn them.`;
  const both = (): Promise<HTMLElement> => pictureOf(shape.id, label, { subject: "both", width: 960, height: 540 });
  const { element, viewer } = await stage(contents, up, label, both, signal, ["surface", "signature"]);

  const stand = (axis: string): void => {
    localStorage.setItem(`unbend.up.${shape.id}`, axis);
    viewer?.setUp(axis);
  };
  const byNumber = new Map<number, number>();
  mesh.numbers!.forEach((number, vertex) => byNumber.set(number, vertex));
  const areas = vertexAreas(mesh.positions, mesh.faces);
  const whole = areas.reduce((sum, area) => sum + area, 0);

  let source: number | null = null; // vertices of the view
  let target: number | null = null;
  let distances: Float32Array | null = null; // from the source
  let ofFile = new Float32Array(); // the same, by the numbers of the file
  let shows = "distance";
  let contours = true;

  const lengths = h("output", { class: "lengths", "aria-live": "polite" });
  const legend = h("div", { class: "legend", hidden: true });
  const patch = h("input", {
    type: "range", min: 0, max: 1, step: 0.005, value: 1, disabled: true, "aria-label": "Radius of the patch around the first point",
    oninput: () => (recolour(), sayPatch()),
  });
  const patchWords = h("output", { class: "hint" });
  const askButton = button("Ask with this patch", () => act(askWithPatch()), { class: "plain", disabled: true });
  const bend = h("input", {
    type: "range", min: 0, max: 1, step: 0.01, value: 0, "aria-label": "Bend the surface into its signature",
    oninput: () => viewer?.bend(0, Number(bend.value)),
  });
  const dimensions = mesh.about.dimensions ?? 3;
  const further = Array.from({ length: Math.max(0, Math.min(dimensions, 6) - 3) }, (_, i) => 4 + i);
  const colouring = select(
    [
      ["distance", "Distance from the first point"],
      ["place", "Place in the signature"],
      ["none", "Nothing"],
      ...further.map((number) => [`d${number}`, `Dimension ${number} of the signature`] as const),
    ],
    shows,
    (value) => ((shows = value), recolour()),
  );
  const lines = h("input", { type: "checkbox", checked: true, onchange: () => ((contours = lines.checked), recolour()) });
  const from = vertexInput("First vertex");
  const to = vertexInput("Second vertex");

  function vertexInput(text: string): HTMLInputElement {
    return h("input", { type: "number", min: 0, step: 1, placeholder: "vertex", "aria-label": text });
  }

  async function choose(vertex: number): Promise<void> {
    if (source === null || target !== null) await begin(vertex);
    else await end(vertex);
  }

  async function begin(vertex: number): Promise<void> {
    source = vertex;
    target = null;
    distances = null;
    const number = mesh.numbers![vertex]!;
    from.value = String(number);
    to.value = "";
    lengths.textContent = "Measuring …";
    mark([]);
    ofFile = new Float32Array(await getBytes(`shapes/${shape.id}/geodesics`, { source: number, format: "f32" }, signal));
    distances = atVertices(mesh.numbers!);
    if (shows === "none" || shows === "place") colouring.value = shows = "distance";
    patch.disabled = false;
    patch.value = "1";
    sayPatch();
    lengths.textContent = `Distances from vertex ${number}. Choose another point for the shortest path.`;
    recolour();
  }

  function atVertices(numbers: Float32Array, values = ofFile): Float32Array {
    return numbers.map((each) => (Number.isFinite(values[each]) ? values[each]! : UNKNOWN));
  }

  async function end(vertex: number): Promise<void> {
    if (source === null) return;
    target = vertex;
    const [a, b] = [mesh.numbers![source]!, mesh.numbers![vertex]!];
    to.value = String(b);
    lengths.textContent = "Measuring …";
    const found = await getJson<Distances>(`shapes/${shape.id}/geodesics`, { source: a, target: b, distances: false }, signal);
    const centre = mesh.about.centre ?? [0, 0, 0];
    mark((found.path ?? []).map((point): Point => [point[0]! - centre[0], point[1]! - centre[1], point[2]! - centre[2]]));
    const straight = distance(at(form, source), at(form, vertex));
    lengths.replaceChildren(
      h("span", {}, "On the surface: ", h("b", { "data-length": String(found.length) }, figure(found.length))),
      h("span", {}, "Straight in the signature: ", h("b", { "data-length": String(straight) }, figure(straight))),
    );
  }

  function mark(path: Point[]): void {
    const vertices = [source, target].filter((vertex) => vertex !== null);
    viewer?.mark(0, vertices, path);
    viewer?.mark(1, vertices, path.length && target !== null && source !== null ? [at(form, source), at(form, target)] : []);
  }

  function recolour(): void {
    legend.hidden = true;
    if (!viewer) return;
    if (shows === "distance" && distances) {
      const known = distances.filter((value) => value < UNKNOWN);
      const high = known.reduce((most, value) => Math.max(most, value), 0);
      const limit = Number(patch.value) < 1 ? Number(patch.value) * high : -1;
      viewer.colour({ kind: "field", values: distances, low: 0, high, map: maps!.SEQUENTIAL, contours: contours ? CONTOURS : 0, limit });
      showLegend(0, high, maps!.SEQUENTIAL.css);
    } else if (shows === "place") {
      const most = form.reduce((largest, value) => Math.max(largest, Math.abs(value)), 0);
      viewer.colour({ kind: "colours", rgb: maps!.placeColours(form, most) });
    } else if (shows.startsWith("d") && mesh.more) {
      const axis = Number(shows.slice(1)) - 4;
      const values = Float32Array.from({ length: mesh.more.length / 3 }, (_, vertex) => mesh.more![3 * vertex + axis]!);
      const most = values.reduce((largest, value) => Math.max(largest, Math.abs(value)), 0);
      viewer.colour({ kind: "field", values, low: -most, high: most, map: maps!.DIVERGING, contours: contours ? CONTOURS : 0 });
      showLegend(-most, most, maps!.DIVERGING.css);
    } else viewer.colour({ kind: "plain" });
  }

  function showLegend(low: number, high: number, css: string): void {
    const strip = h("span", { class: "strip" });
    strip.style.background = css;
    legend.replaceChildren(h("span", {}, figure(low)), strip, h("span", {}, figure(high)));
    legend.hidden = false;
  }

  /** Radius of the patch, null if there is none. */
  function patchRadius(): number | null {
    if (!distances || Number(patch.value) >= 1 || Number(patch.value) <= 0) return null;
    return Number(patch.value) * distances.reduce((most, value) => (value < UNKNOWN ? Math.max(most, value) : most), 0);
  }

  function sayPatch(): void {
    const limit = patchRadius();
    askButton.disabled = limit === null;
    patchWords.textContent = "";
    if (limit === null) return;
    const inside = distances!.reduce((sum, value, vertex) => (value <= limit ? sum + areas[vertex]! : sum), 0);
    patchWords.textContent = `radius ${figure(limit)}, ${percent(inside / whole)} of the area`;
  }

  /** Cut the patch out, from the whole surface, and ask the library with it alone. */
  async function askWithPatch(): Promise<void> {
    const limit = patchRadius();
    if (limit === null || source === null) return;
    const number = mesh.numbers![source]!;
    const values = ofFile;
    const all = full > faces ? readGlb(await getBytes(`shapes/${shape.id}/view`, { faces: MOST_FACES }, signal)) : mesh;
    hand(new File([cutOff(all.positions, all.faces, atVertices(all.numbers!, values), limit)], `${shape.name}, patch at ${number}.off`));
    location.hash = "#/ask?measure=partial";
  }

  /** Find the vertex of the view for one of the file, the nearest shown one where it was merged. */
  function shown(input: HTMLInputElement): number | null {
    const number = input.valueAsNumber;
    if (!Number.isInteger(number) || number < 0) return null;
    const exact = byNumber.get(number);
    if (exact !== undefined) return exact;
    notify(`Vertex ${number} is not in this view, which is simplified.`, undefined, "error");
    return null;
  }

  async function measure(): Promise<void> {
    const first = shown(from);
    if (first === null) return;
    const second = to.value ? shown(to) : null;
    await begin(first);
    if (second !== null) await end(second);
  }

  const act = (work: Promise<void>): void => void work.catch((error: unknown) => ((lengths.textContent = ""), report(error)));
  const maps = viewer && (await import("../scene/colours"));
  if (viewer) viewer.onpick = (vertex) => act(choose(vertex));
  const { faces = 0, full_faces: full = 0 } = mesh.about;
  const panel = h(
    "div",
    { class: "controls" },
    viewer && field("Bend into the signature", bend),
    viewer && h("div", { class: "row" }, field("Colour", colouring), h("label", { class: "choice" }, lines, h("span", {}, "Contours"))),
    h(
      "form",
      { class: "row measure", onsubmit: (event) => (event.preventDefault(), act(measure())) },
      field("From vertex", from),
      field("to vertex", to),
      h("button", { class: "plain" }, "Measure"),
      button("Clear", clear, { class: "quiet" }),
    ),
    viewer && h("div", { class: "row" }, field("Patch around the first point", patch), askButton, patchWords),
    viewer &&
      h(
        "div",
        { class: "row" },
        button("Reset the view", () => viewer.reset(), { class: "quiet" }),
        select(AXES.map((axis) => [axis, `${axis.toUpperCase()} is up`] as const), up, stand, { "aria-label": "Upright axis" }),
        h("a", { href: `#/flatten/${shape.id}`, class: "quiet" }, "Flatten it"),
      ),
  );

  function clear(): void {
    source = target = distances = null;
    from.value = to.value = lengths.textContent = patchWords.textContent = "";
    patch.disabled = askButton.disabled = true;
    mark([]);
    recolour();
  }

  signal.throwIfAborted();
  place.replaceChildren(h(
    "div",
    {},
    element,
    legend,
    lengths,
    full > faces && h("p", { class: "hint" }, `Simplified for this view: ${faces.toLocaleString("en")} of ${plural(full, "face")}. Distances are those of the whole surface.`),
    viewer && h("p", { class: "hint" }, "Click a point for the distances from it, and another for the shortest path."),
    panel,
  ));
  const [a, b] = [query.get("from"), query.get("to")];
  if (a) {
    from.value = a;
    to.value = b ?? "";
    act(measure());
  }
}

function facts(shape: Shape): HTMLElement {
  const notes = (shape.report["notes"] as string[] | undefined) ?? [];
  const rows: [string, string][] = [
    ["Added", new Date(shape.created_at).toLocaleString()],
    ["File", `${(shape.report["file_type"] as string | undefined) ?? ""}, ${(shape.size / 1024).toFixed(0)} kB`],
    ["Vertices", figure(shape.report["vertices"] as number | undefined)],
    ["Faces", figure(shape.report["faces"] as number | undefined)],
    ["Area", figure(shape.area)],
  ];
  return h(
    "section",
    {},
    h("h2", {}, "Shape"),
    table(rows.filter(([, value]) => value !== "–")),
    shape.warnings.map((text) => h("p", { class: "warning" }, coded(text))),
    notes.length > 0 && h("details", {}, h("summary", {}, "What reading found and repaired"), h("ul", {}, notes.map((note) => h("li", {}, note)))),
    Object.keys(shape.metadata).length > 0 && h("details", {}, h("summary", {}, "Metadata"), h("pre", {}, JSON.stringify(shape.metadata, null, 2))),
  );
}

async function numbers(shape: Shape, signal: AbortSignal): Promise<HTMLElement> {
  const { descriptors } = await getJson<{ descriptors: Record<string, number[]> }>(`shapes/${shape.id}/descriptors`, {}, signal);
  const errors = descriptors["dimension"]?.slice(1);
  const dimensions = shape.parameters["dimensions"];
  const error = typeof dimensions === "number" ? errors?.[dimensions - 1] : undefined;
  return h(
    "section",
    {},
    h("h2", {}, "Signature"),
    table([
      ["Stress", figure(shape.stress)],
      ["Energy captured", error === undefined ? "–" : percent(1 - error)],
      ["Effective dimension", figure(shape.dimension)],
      ["Samples", String(shape.parameters["samples"])],
      ["Method", METHODS[String(shape.parameters["method"])] ?? String(shape.parameters["method"])],
    ]),
  );
}

function table(rows: [string, string][]): HTMLElement {
  return h("dl", {}, rows.map(([name, value]) => h("div", { title: MEANINGS[name] }, h("dt", {}, name), h("dd", {}, value))));
}

function downloads(shape: Shape): HTMLElement {
  const path = `shapes/${shape.id}`;
  return h(
    "section",
    {},
    h("h2", {}, "Downloads"),
    h(
      "div",
      { class: "row" },
      saveButton("The file", `${path}/mesh`),
      saveButton("Signature (ply)", `${path}/signature`, { format: "ply" }),
      saveButton("Signature (json)", `${path}/signature`, { format: "json" }),
      saveButton("Whole form (ply)", `${path}/signature`, { format: "ply", whole: true }),
    ),
  );
}

function nearest(shape: Shape, query: URLSearchParams, signal: AbortSignal): HTMLElement {
  const list = h("div", { "aria-live": "polite" }, h("p", { class: "hint loading" }, "Searching …"));
  const load = async (measure: string | undefined): Promise<void> => {
    const ranking: Ranking = await rankByShape(shape.id, measure, NEAREST);
    if (signal.aborted) return;
    const none = h("p", { class: "hint" }, "There is no other shape that was computed with the same parameters.");
    const links = (other: Ranking["shapes"][number]): HTMLElement =>
      h(
        "div",
        { class: "links" },
        h("a", { href: `#/pair/${shape.id}/${other.id}`, class: "quiet", "aria-label": `Compare with ${other.name}` }, "Compare"),
        h("a", { href: matchAddress(shape.id, other), class: "quiet", "aria-label": `Match points with ${other.name}` }, "Match points"),
      );
    list.replaceChildren(
      ...(ranking.warnings ?? []).map((text) => h("p", { class: "warning" }, coded(text))),
      ranking.shapes.length ? rankedList(ranking.shapes, links) : none,
    );
  };
  const fail = (error: unknown): void => {
    if (!signal.aborted) list.replaceChildren(h("p", { class: "error" }, error instanceof Error ? error.message : ""));
  };
  const chosen = query.get("measure") ?? "spectrum";
  const choice = measures(null, chosen, (name) => {
    list.replaceChildren(h("p", { class: "hint loading" }, "Searching …"));
    void load(name).catch(fail);
  });
  void load(query.get("measure") ?? undefined).catch(fail);
  return h("section", { class: "nearest" }, h("div", { class: "row" }, h("h2", {}, "Nearest shapes"), choice), list);
}
