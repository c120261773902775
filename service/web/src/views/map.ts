/** The map of the library (the paper's Fig. 8): shapes by their signatures, beside the same by their surfaces. */

import { getJson, sendJson, type Shape, type ShapeMap } from "../api/client";
import type { View } from "../main";
import { classColours } from "../scene/colours";
import { button, field, figure, h, plural, select } from "../ui/dom";
import { measures, VECTOR_MEASURES } from "../ui/nearest";
import { ask, notify, report } from "../ui/notices";
import { thumbnail } from "../ui/thumbnail";

const MOST = 5000;
const MOST_LISTED = 200;
const NEAR = 12;

type Item = ShapeMap["items"][number];

interface Plot {
  element: HTMLElement;
  draw: () => void;
}

export function mapView(_: string[], query: URLSearchParams, signal: AbortSignal): View {
  let measure = query.get("measure") ?? "spectrum";
  let dimensions = Number(query.get("dimensions") ?? 2) === 3 ? 3 : 2;
  const plots = h("div", { class: "plots" });
  const selecting = h("input", { type: "checkbox" });
  const legend = h("ul", { class: "classes-legend" });
  const words = h("p", { class: "hint", "aria-live": "polite" });
  const picked = h("div", { class: "selection", hidden: true, role: "region", "aria-label": "Selected shapes" });
  const list = h("details", { class: "listing" });
  const element = h(
    "section",
    { class: "map" },
    h("h1", {}, "Map of the library"),
    h(
      "div",
      { class: "row" },
      field("Measure", measures(VECTOR_MEASURES, measure, (name) => ((measure = name), reload()))),
      field("Dimensions", select([["2", "2"], ["3", "3"]], String(dimensions), (value) => ((dimensions = Number(value)), reload()))),
      h("label", { class: "choice" }, selecting, h("span", {}, "Select by dragging")),
      h("p", { class: "hint" }, "A drag moves or turns, or selects with Shift; the wheel zooms; a click opens a shape."),
    ),
    words,
    legend,
    picked,
    plots,
    list,
  );
  let version = 0;

  function reload(): void {
    const address = new URLSearchParams({ measure, dimensions: String(dimensions) });
    history.replaceState(null, "", `#/map?${address}`);
    load().catch((error: unknown) => ((words.textContent = error instanceof Error ? error.message : ""), report(error)));
  }

  async function load(): Promise<void> {
    const mine = ++version;
    words.textContent = "Computing the map …";
    const found = await getJson<ShapeMap>("map", { measure, dimensions, limit: MOST }, signal);
    if (mine !== version) return;
    const labels = [...new Set(found.items.map((item) => item.label ?? ""))].sort();
    const colours = classColours(labels);
    const state = { colours, hidden: new Set<string>(), selected: new Set<string>(), hovered: null as Item | null };
    const shownWords = found.items.length < found.count ? `, ${plural(found.items.length, "of them", "of them")} shown` : "";
    if (!found.items.length) {
      const { shapes } = await getJson<{ shapes: number }>("classes", {}, signal);
      if (mine !== version) return;
      words.textContent = shapes
        ? `The map shows shapes that were computed with the default parameters. The library has ${plural(shapes, "shape")}, but all with others.`
        : "There are no shapes to show yet.";
      return plots.replaceChildren();
    }
    words.textContent = `${plural(found.count, "shape")}${shownWords}.`;
    const redraw = (): void => all.forEach((plot) => plot.draw());
    const choose = (ids: string[]): void => ((state.selected = new Set(ids)), redraw(), showSelection(found.items, state.selected, redraw));
    const hover = (item: Item | null): void => ((state.hovered = item), redraw());
    const all = [
      scatter(`By their signatures (stress ${figure(found.stress)})`, found.items, (item) => item.point, state, hover, choose, () => selecting.checked, signal),
      scatter(`By their surfaces as they stand (stress ${figure(found.original_stress)})`, found.items, (item) => item.original, state, hover, choose, () => selecting.checked, signal),
    ];
    plots.replaceChildren(...all.map((plot) => plot.element));
    picked.hidden = true;
    legend.replaceChildren(
      ...labels.slice(0, 60).map((label) => {
        const swatch = h("span", { class: "swatch" });
        swatch.style.background = colours.get(label) ?? "currentColor";
        const box = h("input", {
          type: "checkbox", checked: true,
          onchange: () => (box.checked ? state.hidden.delete(label) : state.hidden.add(label), redraw()),
        });
        return h("li", {}, h("label", { class: "choice" }, box, swatch, h("span", {}, label || "no class")));
      }),
    );
    const listed = found.items.slice(0, MOST_LISTED);
    list.replaceChildren(
      h("summary", {}, "The shapes as a list"),
      h("ul", {}, listed.map((item) => h("li", {}, h("a", { href: `#/shape/${item.id}` }, item.name), ` ${item.label ?? ""}`))),
    );
    requestAnimationFrame(redraw);
  }

  function showSelection(items: Item[], ids: Set<string>, redraw: () => void): void {
    const chosen = items.filter((item) => ids.has(item.id));
    picked.hidden = !chosen.length;
    picked.replaceChildren(
      h("strong", {}, `${plural(chosen.length, "shape")} selected`),
      button("Set class", () => void relabel(chosen, redraw), { class: "plain" }),
      h("div", { class: "row" }, chosen.slice(0, 12).map((item) => h("a", { href: `#/shape/${item.id}`, class: "small" }, thumbnail(item.id, item.name, { width: 96, height: 96 })))),
    );
  }

  async function relabel(items: Item[], redraw: () => void): Promise<void> {
    const input = h("input", { type: "text", maxlength: 200 });
    if (!(await ask(`Class of ${plural(items.length, "shape")}`, "Set", field("Class", input, "Leave it empty for none.")))) return;
    const before = items.map((item) => item.label);
    const label = input.value.trim() || null;
    if (await change(items, items.map(() => label), redraw)) {
      notify(`${plural(items.length, "shape")} changed.`, { text: "Undo", run: () => void change(items, before, redraw) });
    }
  }

  async function change(items: Item[], labels: (string | null)[], redraw: () => void): Promise<boolean> {
    try {
      for (const [number, item] of items.entries()) {
        item.label = (await sendJson<Shape>("PATCH", `shapes/${item.id}`, { label: labels[number]! })).label;
      }
      return true;
    } catch (error) {
      report(error);
      return false;
    } finally {
      redraw();
    }
  }

  load().catch((error: unknown) => {
    if (signal.aborted) return;
    words.textContent = error instanceof Error ? error.message : "";
    report(error);
  });
  return { title: "Map", element };
}

interface State {
  colours: Map<string, string>;
  hidden: Set<string>;
  selected: Set<string>;
  hovered: Item | null;
}

/** A plot of points that is moved, turned, zoomed, and selected from. */
function scatter(
  title: string,
  items: Item[],
  place: (item: Item) => number[],
  state: State,
  hover: (item: Item | null) => void,
  choose: (ids: string[]) => void,
  selects: () => boolean,
  signal: AbortSignal,
): Plot {
  const canvas = h("canvas", { role: "img", "aria-label": `${title}: ${plural(items.length, "shape")}. The list below has them all.` });
  const card = h("div", { class: "hover", hidden: true });
  const element = h("figure", {}, h("figcaption", {}, title), h("div", { class: "canvas" }, canvas, card));
  const solid = (items[0] ? place(items[0]).length : 2) > 2;
  const middle = [0, 1, 2].map((axis) => mean(items.map((item) => place(item)[axis] ?? 0)));
  const spread = Math.max(1e-9, ...items.map((item) => Math.hypot(...place(item).map((value, axis) => value - middle[axis]!))));
  let [zoom, left, top, yaw, pitch] = [1, 0, 0, 0.6, 0.4];
  const screen = new Float32Array(2 * items.length);
  let lasso: [number, number][] | null = null;
  let shown: Item | null = null;

  function project(): void {
    const { clientWidth: width, clientHeight: height } = canvas;
    const scale = (0.46 * Math.min(width, height) * zoom) / spread;
    const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
    items.forEach((item, number) => {
      const point = place(item);
      let [x, y] = [point[0]! - middle[0]!, (point[1] ?? 0) - middle[1]!];
      if (solid) {
        const z = point[2]! - middle[2]!;
        [x, y] = [cy * x + sy * z, cp * y - sp * (cy * z - sy * x)];
      }
      screen[2 * number] = width / 2 + left + scale * x;
      screen[2 * number + 1] = height / 2 + top - scale * y;
    });
  }

  let waiting = false;
  function draw(): void {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      paint();
    });
  }

  function paint(): void {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width) return;
    const ratio = Math.min(devicePixelRatio, 2);
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d")!;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    project();
    const size = items.length > 1500 ? 2.5 : items.length > 300 ? 4 : 6;
    const ink = getComputedStyle(canvas).color;
    items.forEach((item, number) => {
      if (state.hidden.has(item.label ?? "")) return;
      const chosen = state.selected.has(item.id) || state.hovered === item;
      context.beginPath();
      context.arc(screen[2 * number]!, screen[2 * number + 1]!, chosen ? size + 3 : size, 0, 2 * Math.PI);
      context.fillStyle = state.colours.get(item.label ?? "") ?? ink;
      context.fill();
      if (chosen) {
        context.strokeStyle = ink;
        context.lineWidth = 1.5;
        context.stroke();
      }
    });
    if (lasso) {
      context.beginPath();
      lasso.forEach(([x, y]) => context.lineTo(x, y));
      context.closePath();
      context.strokeStyle = ink;
      context.setLineDash([4, 3]);
      context.stroke();
      context.setLineDash([]);
    }
  }

  function under(x: number, y: number): Item | null {
    let [found, least]: [Item | null, number] = [null, NEAR];
    items.forEach((item, number) => {
      const away = Math.hypot(screen[2 * number]! - x, screen[2 * number + 1]! - y);
      if (away < least && !state.hidden.has(item.label ?? "")) [found, least] = [item, away];
    });
    return found;
  }

  let start: { x: number; y: number; moved: boolean } | null = null;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    start = { x: event.offsetX, y: event.offsetY, moved: false };
    if (event.shiftKey || selects()) lasso = [[event.offsetX, event.offsetY]];
  });
  canvas.addEventListener("pointermove", (event) => {
    const [x, y] = [event.offsetX, event.offsetY];
    if (!start) return show(under(x, y), x, y);
    const [dx, dy] = [x - start.x, y - start.y];
    if (!start.moved && Math.hypot(dx, dy) < 4) return;
    start = { x, y, moved: true };
    if (lasso) lasso.push([x, y]);
    else if (solid) [yaw, pitch] = [yaw + dx / 120, pitch + dy / 120];
    else [left, top] = [left + dx, top + dy];
    draw();
  });
  canvas.addEventListener("pointerup", (event) => {
    const moved = start?.moved;
    start = null;
    if (lasso) {
      const outline = lasso;
      lasso = null;
      choose(items.filter((item, number) => !state.hidden.has(item.label ?? "") && within(outline, screen[2 * number]!, screen[2 * number + 1]!)).map((item) => item.id));
    } else if (!moved) {
      const item = under(event.offsetX, event.offsetY);
      if (item) location.hash = `#/shape/${item.id}`;
    }
    draw();
  });
  canvas.addEventListener("pointerleave", () => show(null, 0, 0));
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const factor = Math.exp(-event.deltaY / 400);
      const [x, y] = [event.offsetX - canvas.clientWidth / 2, event.offsetY - canvas.clientHeight / 2];
      [left, top, zoom] = [x - factor * (x - left), y - factor * (y - top), zoom * factor];
      draw();
    },
    { passive: false },
  );

  function show(item: Item | null, x: number, y: number): void {
    if (item === shown) return;
    shown = item;
    card.hidden = !item;
    canvas.style.cursor = item ? "pointer" : "";
    if (item) {
      card.replaceChildren(thumbnail(item.id, "", { width: 120, height: 120 }), h("span", {}, item.name), h("span", { class: "label" }, item.label ?? "no class"));
      card.style.left = `${Math.min(x + 14, canvas.clientWidth - 140)}px`;
      card.style.top = `${Math.min(y + 14, canvas.clientHeight - 170)}px`;
    }
    hover(item);
  }

  new ResizeObserver(draw).observe(canvas);
  addEventListener("themechange", draw, { signal });
  return { element, draw };
}

function mean(values: number[]): number {
  return values.reduce((sum, value) => sum + value, 0) / Math.max(1, values.length);
}

/** Return whether a point is inside an outline: whether a ray from it crosses the outline an odd number of times. */
function within(outline: [number, number][], x: number, y: number): boolean {
  let inside = false;
  outline.forEach(([ax, ay], number) => {
    const [bx, by] = outline[(number + 1) % outline.length]!;
    if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) inside = !inside;
  });
  return inside;
}
