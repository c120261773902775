/** Two shapes side by side under one camera, with points that correspond coloured alike. */

import { align } from "../scene/align";
import { centred, radius } from "../scene/geometry";
import type { Mesh } from "../scene/glb";
import { h, type Child } from "./dom";
import { stage } from "./stage";

/** Show two meshes with forms; `fallback` is shown where WebGL is missing. */
export async function beside(
  first: Mesh,
  second: Mesh,
  label: string,
  fallback: () => Promise<HTMLElement>,
  signal: AbortSignal,
  captions: readonly Child[],
): Promise<HTMLElement> {
  const contents = [first, second].map(({ positions, faces, form }) => {
    const size = radius(positions) || 1; // shapes of different size are shown equally large
    return { positions: positions.map((v) => v / size), faces, form: centred(form!).map((v) => v / size) };
  });
  const { element, viewer } = await stage(contents, first.about.up ?? "z", label, fallback, signal, captions);
  if (!viewer) return element;
  const { placeColours } = await import("../scene/colours");
  align(first.form!, second.form!).forEach((form, pane) => viewer.colour({ kind: "colours", rgb: placeColours(form, 1.7) }, pane));
  const bend = h("input", {
    type: "range", min: 0, max: 1, step: 0.01, value: 0, "aria-label": "Bend both into their signatures",
    oninput: () => [0, 1].forEach((pane) => viewer.bend(pane, Number(bend.value))),
  });
  const words = "Equal colours are equal places in the two signatures, laid on each other. Left and right may be swapped: a signature does not tell them apart.";
  return h("div", {}, element, h("p", { class: "hint" }, words), h("label", { class: "field" }, h("span", {}, "Bend both into their signatures"), bend));
}
