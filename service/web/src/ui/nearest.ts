/** The shapes nearest to another, as pictures with distances. */

import { sendJson, type Ranking } from "../api/client";
import { figure, h, select, type Child } from "./dom";
import { thumbnail } from "./thumbnail";

export const MEASURES = [
  ["spectrum", "Spectrum (recommended)"], ["combined", "Combined"], ["moments", "Moments (the paper's)"], ["distribution", "Distribution"],
  ["dimension", "Effective dimension"],
  ["surface_moments", "Moments of the surface as it stands"], ["rigid", "Best alignment of the forms"], ["hausdorff", "Modified Hausdorff distance"],
  ["max_hausdorff", "Hausdorff distance"], ["reeb", "Reeb graph"],
] as const;

/** The measures of vectors: fast enough for a map and an evaluation. */
export const VECTOR_MEASURES = ["spectrum", "combined", "moments", "distribution", "dimension", "surface_moments"];

export function measures(allowed: readonly string[] | null, chosen: string, change: (name: string) => void): HTMLSelectElement {
  const names = new Map<string, string>(MEASURES);
  const shown = allowed ?? [...names.keys()];
  return select(shown.map((name) => [name, names.get(name) ?? name] as const), chosen, change, { "aria-label": "Measure" });
}

export function rankByShape(shapeId: string, measure: string | undefined, k: number): Promise<Ranking> {
  return sendJson<Ranking>("POST", "queries", { shape_id: shapeId, k, ...(measure ? { measure } : {}) });
}

/** A list of ranked shapes; `extra` adds to each. */
export function rankedList(shapes: Ranking["shapes"], extra: (shape: Ranking["shapes"][number]) => Child = () => null): HTMLElement {
  return h(
    "ol",
    { class: "ranked" },
    shapes.map((shape) =>
      h(
        "li",
        {},
        h(
          "a",
          { href: `#/shape/${shape.id}` },
          thumbnail(shape.id, "", { width: 160, height: 160 }),
          h("span", { class: "name" }, shape.name),
        ),
        h("span", { class: shape.label ? "label" : "label none" }, shape.label ?? "no class"),
        h("span", { class: "distance" }, `distance ${figure(shape.distance)}`),
        extra(shape),
      ),
    ),
  );
}
