/** Two stored shapes side by side. */

import { getBytes, getJson, type Shape } from "../api/client";
import type { View } from "../main";
import { readGlb } from "../scene/glb";
import { beside } from "../ui/beside";
import { h } from "../ui/dom";
import { pictureOf } from "../ui/stage";

export async function pairView(parts: string[], _: URLSearchParams, signal: AbortSignal): Promise<View> {
  const shapes = await Promise.all(parts.slice(0, 2).map((id) => getJson<Shape>(`shapes/${id}`, {}, signal)));
  const [first, second] = shapes;
  if (!first || !second) throw new Error("This address needs the ids of two shapes.");
  const views = await Promise.all(shapes.map(({ id }) => getBytes(`shapes/${id}/view`, {}, signal)));
  const title = `${first.name} and ${second.name}`;
  const fallback = async (): Promise<HTMLElement> =>
    h("div", { class: "row" }, await Promise.all(shapes.map(({ id, name }) => pictureOf(id, name, { width: 480, height: 480 }))));
  const captions = shapes.map(({ id, name, label }) => h("a", { href: `#/shape/${id}` }, label ? `${name} (${label})` : name));
  const shown = await beside(readGlb(views[0]!), readGlb(views[1]!), title, fallback, signal, captions);
  const match = h("a", { href: `#/match/${first.id}/${second.id}`, class: "quiet" }, "Which point is which");
  return { title, element: h("section", { class: "pair" }, h("h1", {}, title), shown, h("p", {}, match)) };
}
