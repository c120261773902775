/** How well the library finds its own classes: metrics, confusions, precision over recall. */

import { ApiError, getJson, type Evaluation, type ShapePage } from "../api/client";
import type { View } from "../main";
import { field, h, percent, plural, svg } from "../ui/dom";
import { MEASURES, measures, rankByShape, VECTOR_MEASURES } from "../ui/nearest";
import { report } from "../ui/notices";
import { thumbnail } from "../ui/thumbnail";

const METRICS = [
  ["nn", "Nearest neighbour", "the share of shapes whose nearest other shape is of their class"],
  ["ft", "First tier", "the share of the C others of a class that is among the C nearest shapes"],
  ["st", "Second tier", "the share of them that is among the 2 C nearest"],
  ["e", "E-measure", "the harmonic mean of precision and recall among the 32 nearest; with fewer than 32 others in a class it cannot reach 1, even if every answer is right"],
  ["dcg", "DCG", "discounted cumulative gain: early places count more; divided by that of the best ranking"],
  ["map", "Mean average precision", "the mean of the precisions at the places of the others of a class"],
] as const;
const NAMES = new Map<string, string>(MEASURES);
const MOST_CLASSES = 60;
const AT_ONCE = 2;

export function evaluationView(_: string[], query: URLSearchParams, signal: AbortSignal): View {
  let measure = query.get("measure") ?? "spectrum";
  const overview = h("tbody");
  const details = h("div", { class: "details" });
  const mistakes = h("div", { class: "mistakes", "aria-live": "polite" });
  const table = h(
    "table",
    { class: "metrics" },
    h("caption", {}, "Retrieval metrics of the Princeton Shape Benchmark, each labelled shape asked for among the others"),
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Measure"), METRICS.map(([, text, meaning]) => h("th", { scope: "col", title: meaning }, text)))),
    overview,
  );
  const element = h(
    "section",
    { class: "evaluation" },
    h("h1", {}, "Evaluation"),
    h("p", {}, "How often does the library find the class of its own shapes?"),
    h("div", { class: "row" }, field("By the measure", measures(VECTOR_MEASURES, measure, (name) => ((measure = name), void detail())))),
    details,
    mistakes,
    h("h2", {}, "All measures"),
    h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Metrics" }, table),
    h("details", {}, h("summary", {}, "What the metrics mean"), h("dl", {}, METRICS.flatMap(([, name, words]) => [h("dt", {}, name), h("dd", {}, words)]))),
  );

  const known = new Map<string, Promise<Evaluation>>();
  const evaluation = (name: string): Promise<Evaluation> => {
    const found = known.get(name) ?? getJson<Evaluation>("evaluation", { measure: name }, signal);
    known.set(name, found);
    return found;
  };

  async function all(): Promise<void> {
    for (const name of VECTOR_MEASURES) {
      const words = NAMES.get(name) ?? name;
      const row = h("tr", {}, h("th", { scope: "row" }, words), h("td", { colspan: METRICS.length, class: "hint" }, "computing …"));
      overview.append(row);
      const found = await evaluation(name);
      row.replaceChildren(h("th", { scope: "row" }, words), ...METRICS.map(([key]) => h("td", {}, found[key]?.toFixed(3) ?? "–")));
    }
  }

  async function detail(): Promise<void> {
    details.replaceChildren(h("p", { class: "hint loading" }, "Computing …"));
    history.replaceState(null, "", `#/evaluation?measure=${measure}`);
    mistakes.replaceChildren();
    const found = await evaluation(measure);
    if (signal.aborted) return;
    details.replaceChildren(
      h("p", {}, `${percent(found.accuracy)} of ${plural(found.queries, "query", "queries")} have a nearest other shape of their own class.`),
      curve(found),
      confusion(found),
    );
  }

  function confusion(found: Evaluation): HTMLElement {
    if (!found.confusion) return h("p", { class: "hint" }, "There are too many classes for a table of confusions.");
    const { counts } = found.confusion;
    const wrong = (row: number): number => counts[row]!.reduce((sum, count, column) => sum + (row === column ? 0 : count), 0);
    // In a library of many classes, those with mistakes are shown.
    let rows = found.confusion.labels.map((_label, number) => number);
    if (rows.length > MOST_CLASSES) rows = rows.sort((a, b) => wrong(b) - wrong(a)).slice(0, MOST_CLASSES).sort((a, b) => a - b);
    const labels = found.confusion.labels;
    const head = h("tr", {}, h("td", {}), rows.map((row) => h("th", { scope: "col" }, h("span", {}, labels[row]!))));
    const body = rows.map((row) => {
      const total = counts[row]!.reduce((sum, count) => sum + count, 0) || 1;
      return h(
        "tr",
        {},
        h("th", { scope: "row" }, labels[row]!),
        rows.map((column) => {
          const count = counts[row]![column]!;
          const cell = h("td", {}, count > 0 && cellButton(row, column, count, labels));
          if (count) cell.style.setProperty("--share", String(count / total));
          if (count) cell.className = row === column ? "right" : "wrong";
          return cell;
        }),
      );
    });
    return h(
      "div",
      { class: "scroll", tabindex: 0, role: "region", "aria-label": "Confusions" },
      h("table", { class: "confusion" }, h("caption", {}, "Class of each shape (row) and of its nearest other shape (column). Press a number to see the shapes."), h("thead", {}, head), h("tbody", {}, body)),
    );
  }

  function cellButton(row: number, column: number, count: number, labels: string[]): HTMLElement {
    const words = `${count} of ${labels[row]!} nearest to ${labels[column]!}: show them`;
    const press = (): void => void list(labels[row]!, labels[column]!).catch(report);
    return h("button", { type: "button", class: "cell", "aria-label": words, onclick: press }, count);
  }

  /** Show the shapes of one class whose nearest other shape is of another. */
  async function list(label: string, nearest: string): Promise<void> {
    const title = h("h2", {}, `${label} nearest to ${nearest}`);
    const shown = h("ul", { class: "pairs" });
    const state = h("p", { class: "hint loading" }, "Asking for each …");
    mistakes.replaceChildren(title, state, shown);
    mistakes.scrollIntoView({ block: "nearest" });
    const page = await getJson<ShapePage>("shapes", { label, limit: 500 }, signal);
    const queue = [...page.items];
    const work = async (): Promise<void> => {
      for (let shape = queue.shift(); shape; shape = queue.shift()) {
        const found = await rankByShape(shape.id, measure, 10).catch((error: unknown) => {
          if (error instanceof ApiError && error.status === 404) return null;
          throw error;
        });
        const first = found?.shapes.find((each) => each.label !== null);
        if (first?.label !== nearest) continue;
        shown.append(
          h(
            "li",
            {},
            h("a", { href: `#/shape/${shape.id}` }, thumbnail(shape.id, "", { width: 128, height: 128 }), shape.name),
            h("a", { href: `#/shape/${first.id}` }, thumbnail(first.id, "", { width: 128, height: 128 }), first.name),
            h("a", { href: `#/pair/${shape.id}/${first.id}`, class: "quiet", "aria-label": `Compare ${shape.name} and ${first.name}` }, "Compare"),
          ),
        );
      }
    };
    await Promise.all(Array.from({ length: AT_ONCE }, work));
    state.remove();
  }

  const fail = (error: unknown): void => {
    if (signal.aborted) return;
    details.replaceChildren(h("p", { class: "error" }, error instanceof Error ? error.message : ""));
    overview.replaceChildren();
    if (!(error instanceof ApiError && error.status === 409)) report(error);
  };
  void detail().then(all).catch(fail);
  return { title: "Evaluation", element };
}

/** Precision over recall. */
function curve(found: Evaluation): HTMLElement {
  const { recall, precision } = found.precision_recall;
  const [width, height, edge] = [420, 260, 36];
  const x = (value: number): number => edge + value * (width - edge - 12);
  const y = (value: number): number => height - edge - value * (height - edge - 26);
  const ticks = [0, 0.25, 0.5, 0.75, 1];
  const grid = ticks.flatMap((tick) => [
    svg("line", { x1: x(0), x2: x(1), y1: y(tick), y2: y(tick), class: "grid" }),
    text(x(0) - 6, y(tick) + 4, String(tick), "end"),
    text(x(tick), y(0) + 16, String(tick), "middle"),
  ]);
  const points = recall.map((value, i) => `${x(value)},${y(precision[i]!)}`).join(" ");
  const drawing = svg(
    "svg",
    { viewBox: `0 0 ${width} ${height}`, class: "curve", role: "img", "aria-label": "Mean precision over recall" },
    ...grid,
    svg("polyline", { points, class: "line" }),
    text(x(0.5), height - 4, "recall", "middle"),
    text(4, 12, "precision", "start"),
  );
  const figureElement = h("figure", {});
  figureElement.append(drawing);
  return figureElement;
}

function text(x: number, y: number, words: string, anchor: string): SVGElement {
  const element = svg("text", { x, y, "text-anchor": anchor });
  element.textContent = words;
  return element;
}
