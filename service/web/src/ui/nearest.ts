/** The shapes nearest to another, as pictures with distances. */

import { sendJson, type Part, type Ranking } from "../api/client";
import { figure, h, select, type Child } from "./dom";
import { thumbnail } from "./thumbnail";

export const MEASURES = [
  ["spectrum", "Spectrum (recommended)"], ["combined", "Combined"], ["moments", "Moments (the paper's)"], ["distribution", "Distribution"],
  ["dimension", "Effective dimension"],
  ["surface_moments", "Moments of the surface as it stands"], ["rigid", "Best alignment of the forms"], ["hausdorff", "Modified Hausdorff distance"],
  ["max_hausdorff", "Hausdorff distance"], ["reeb", "Reeb graph"],
  ["partial", "Part against wholes"], ["partial_any_scale", "Part against wholes, in any unit"],
] as const;

/** The measures that find the wholes of a part, and the parts of a whole. */
export const PART_MEASURES: readonly string[] = ["partial", "partial_any_scale"];

/** A smaller share of circles in their places is worth a remark. */
const FEW_MATCHED = 0.8;

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

/** What the query is to a shape. */
function partWords({ relation, covered, matched, scale }: Part): string {
  const share = `${(100 * covered).toFixed(0)} %`;
  const what = {
    part: `Part of it, ${share} of its area`, contains: `Contains it, as ${share} of the query's area`, whole: "Neither is a part of the other",
  }[relation];
  const units = scale === 1 ? "" : `; at ${figure(scale)} times the size of the query`;
  const doubt = matched < FEW_MATCHED ? `, but only ${(100 * matched).toFixed(0)} % of the compared circles keep their distances` : "";
  return `${what}${units}${doubt}`;
}

/** The address of the match of a shape with a ranked one; a part comes first. */
export function matchAddress(shapeId: string, other: Ranking["shapes"][number]): string {
  const order = other.part?.relation === "contains" ? [other.id, shapeId] : [shapeId, other.id];
  return `#/match/${order.join("/")}`;
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
        shape.part ? h("span", { class: "part" }, partWords(shape.part)) : null,
        extra(shape),
      ),
    ),
  );
}
