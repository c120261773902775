/** The flattening of a shape (the paper's Fig. 1), with a texture, or its distortion as colour. */

import { getBytes, getJson, type Shape } from "../api/client";
import type { View } from "../main";
import { at, centred, distance, FIRST_DIRECTION, radius, type Point } from "../scene/geometry";
import { readGlb, type Mesh } from "../scene/glb";
import { field, h, percent, select } from "../ui/dom";
import { notify } from "../ui/notices";
import { saveButton } from "../ui/save";
import { pictureOf, stage } from "../ui/stage";
import { TEXTURES } from "../scene/textures";

const MOST_PIXELS = 2048;

export async function flattenView(parts: string[], _: URLSearchParams, signal: AbortSignal): Promise<View> {
  const id = parts[0] ?? "";
  const shape = await getJson<Shape>(`shapes/${id}`, {}, signal);
  const mesh = readGlb(await getBytes(`shapes/${id}/flattening`, { format: "glb" }, signal));
  const uv = mesh.uv!;
  const flat = new Float32Array(mesh.positions.length);
  for (let vertex = 0; vertex < uv.length / 2; vertex++) flat.set([uv[2 * vertex]!, uv[2 * vertex + 1]!, 0], 3 * vertex);
  const { stretch, mean } = distortion(mesh, flat);
  const surface = standing(centred(mesh.positions));
  const size = radius(surface) || 1;
  const contents = [
    { positions: surface.map((value) => value / size), faces: mesh.faces, uv },
    { positions: facing(centred(flat)), faces: mesh.faces, uv },
  ];
  const label = `${shape.name} and its flattening`;
  const fallback = (): Promise<HTMLElement> => pictureOf(id, shape.name, { width: 640, height: 480 });
  const { element, viewer } = await stage(contents, "y", label, fallback, signal, ["surface", "in the plane"]);
  const { DIVERGING } = await import("../scene/colours");

  const explained = h("span", {}, " Red edges are longer in the plane than on the surface, blue ones shorter.");
  const paint = (name: string): void => {
    explained.hidden = name !== "stretch";
    if (name === "stretch") viewer?.colour({ kind: "field", values: stretch, low: -0.5, high: 0.5, map: DIVERGING, contours: 0 });
    else if (name !== "file") viewer?.colour({ kind: "texture", image: TEXTURES[name]!() });
  };
  const own = h("input", { type: "file", accept: "image/*", "aria-label": "A picture of your own", hidden: true });
  own.addEventListener("change", () => void load(own.files?.[0]));
  const load = async (file: File | undefined): Promise<void> => {
    if (!file) return;
    try {
      const bitmap = await createImageBitmap(file);
      const share = Math.min(1, MOST_PIXELS / Math.max(bitmap.width, bitmap.height));
      const canvas = h("canvas", { width: Math.round(bitmap.width * share), height: Math.round(bitmap.height * share) });
      canvas.getContext("2d")!.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
      viewer?.colour({ kind: "texture", image: canvas });
    } catch {
      notify("This file is no picture that the browser can read.", undefined, "error");
    }
  };
  const choice = select(
    [["checks", "Checks"], ["rings", "Rings"], ["letters", "Letters"], ["stretch", "Distortion of lengths"], ["file", "A picture of your own …"]],
    "checks",
    (name) => (name === "file" ? own.click() : paint(name)),
  );
  paint("checks");
  const words = `Mean distortion of edges: ${percent(mean)}.`;
  return {
    title: `${shape.name}, flattened`,
    element: h(
      "section",
      { class: "flatten" },
      h("a", { href: `#/shape/${id}`, class: "quiet" }, "← The shape"),
      h("h1", {}, `${shape.name}, flattened`),
      element,
      h("p", { class: "hint" }, words, explained),
      h("div", { class: "row" }, field("Texture", choice), own, saveButton("Download with texture coordinates", `shapes/${id}/flattening`, { format: "obj" })),
      closed(mesh) && h("p", { class: "warning" }, "This surface is closed, so its flattening folds over itself. An open patch flattens well."),
    ),
  };
}

/** Turn the z axis upwards: most files of open patches are so. */
function standing(points: Float32Array): Float32Array {
  return points.map((_, i) => (i % 3 === 0 ? points[i]! : i % 3 === 1 ? points[i + 1]! : -points[i - 1]!));
}

/** Turn the plane so that it faces the camera in its first place. */
function facing(points: Float32Array): Float32Array {
  const size = radius(points) || 1;
  const front = FIRST_DIRECTION;
  const across = Math.hypot(front[0], front[2]);
  const right: Point = [front[2] / across, 0, -front[0] / across];
  const up: Point = [(-front[1] * front[0]) / across, across, (-front[1] * front[2]) / across];
  return points.map((_, i) => {
    const vertex = i - (i % 3);
    return (points[vertex]! * right[i % 3]! + points[vertex + 1]! * up[i % 3]!) / size;
  });
}

/** Return, for each vertex, the logarithm of how much longer its edges are in the plane, and the mean of all edges. */
function distortion(mesh: Mesh, flat: Float32Array): { stretch: Float32Array; mean: number } {
  const ratios: number[] = [];
  const edges: [number, number][] = [];
  for (let face = 0; face < mesh.faces.length; face += 3) {
    for (const [i, j] of [[0, 1], [1, 2], [2, 0]] as const) {
      const [a, b] = [mesh.faces[face + i]!, mesh.faces[face + j]!];
      const there = distance(at(mesh.positions, a), at(mesh.positions, b));
      const here = distance(at(flat, a), at(flat, b));
      if (there > 0 && here > 0) {
        ratios.push(Math.log(here / there));
        edges.push([a, b]);
      }
    }
  }
  const scale = [...ratios].sort((x, y) => x - y)[Math.floor(ratios.length / 2)] ?? 0; // texture coordinates have a unit of their own
  const stretch = new Float32Array(mesh.positions.length / 3);
  const counts = new Float32Array(stretch.length);
  edges.forEach(([a, b], number) => {
    for (const vertex of [a, b]) {
      stretch[vertex]! += ratios[number]! - scale;
      counts[vertex]! += 1;
    }
  });
  const mean = ratios.reduce((sum, ratio) => sum + Math.abs(Math.exp(ratio - scale) - 1), 0) / Math.max(1, ratios.length);
  return { stretch: stretch.map((value, vertex) => value / Math.max(1, counts[vertex]!)), mean };
}

/** Return whether every edge has two faces. */
function closed(mesh: Mesh): boolean {
  const counts = new Map<string, number>();
  for (let face = 0; face < mesh.faces.length; face += 3) {
    for (const [i, j] of [[0, 1], [1, 2], [2, 0]] as const) {
      const [a, b] = [mesh.faces[face + i]!, mesh.faces[face + j]!];
      const edge = a < b ? `${a} ${b}` : `${b} ${a}`;
      counts.set(edge, (counts.get(edge) ?? 0) + 1);
    }
  }
  return [...counts.values()].every((count) => count > 1);
}
