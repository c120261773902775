/** The place of a viewer: loads the 3-D part when first needed, or shows a picture where WebGL is missing. */

import { picture, type Drawing } from "../api/pictures";
import type { Content, Viewer } from "../scene/viewer";
import { h, type Child } from "./dom";

export interface Stage {
  element: HTMLElement;
  viewer: Viewer | null;
}

export function hasWebGl(): boolean {
  return document.createElement("canvas").getContext("webgl2") !== null;
}

/** Make a viewer, or show `fallback` in its place. */
export async function stage(
  contents: Content[],
  up: string,
  label: string,
  fallback: () => Promise<HTMLElement>,
  signal: AbortSignal,
  captions: readonly Child[] = [],
): Promise<Stage> {
  const element = h("div", { class: "stage" });
  if (!hasWebGl()) {
    const remark = "This browser does not draw in 3-D (WebGL is missing or turned off): here is a picture instead.";
    element.append(h("p", { class: "hint" }, remark), await fallback());
    return { element, viewer: null };
  }
  const { Viewer } = await import("../scene/viewer");
  signal.throwIfAborted();
  const viewer = new Viewer(contents, up, label);
  element.append(viewer.canvas, h("div", { class: "captions" }, captions.map((caption) => h("div", {}, caption))));
  signal.addEventListener("abort", () => viewer.dispose());
  (element as HTMLElement & { viewer?: Viewer }).viewer = viewer; // for measurements and tests
  return { element, viewer };
}

/** A large picture of a stored shape. */
export async function pictureOf(shapeId: string, alternative: string, drawing: Drawing): Promise<HTMLElement> {
  const link = await picture(shapeId, drawing, () => true);
  return h("img", { src: link, alt: alternative, class: "fallback" });
}
