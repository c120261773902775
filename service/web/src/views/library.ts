/** The library: a grid of all shapes, of which only the visible ones are in the document. */

import { getJson, send, sendJson, url, key, type Shape, type ShapePage } from "../api/client";
import { library } from "../jobs";
import type { View } from "../main";
import { save } from "../ui/save";
import { addButtons, offer, takesDrops } from "../ui/drop";
import { button, field, h, plural, select } from "../ui/dom";
import { ask, notify, report } from "../ui/notices";
import { thumbnail } from "../ui/thumbnail";

const FIRST_PAGE = 60;
const PAGE = 500;
const MOST = 20_000;
const CARD = { width: 176, height: 236, gap: 12 };

/** What the grid needs of a shape. */
interface Card {
  id: string;
  name: string;
  label: string | null;
  warned: boolean;
  place: number;
}

const ORDERS = [
  ["newest", "Newest first"],
  ["oldest", "Oldest first"],
  ["name", "By name"],
  ["label", "By class"],
] as const;
type Order = (typeof ORDERS)[number][0];

/** Shapes that were removed on this page, and that the server removes in a few seconds. */
const removing = new Set<string>();

export async function libraryView(_: string[], query: URLSearchParams, signal: AbortSignal): Promise<View> {
  const cards = new Map<string, Card>();
  const selected = new Set<string>();
  let order = (query.get("order") ?? "newest") as Order;
  let label = query.get("label");
  let text = query.get("name") ?? "";
  let shown: Card[] = [];
  let complete = false;
  let columns = 1;
  let anchor: string | null = null;

  const count = h("p", { class: "count", "aria-live": "polite" });
  const search = h("input", {
    type: "search", value: text, placeholder: "Search by name", "aria-label": "Search by name",
    oninput: () => ((text = search.value), remember(), arrange()),
  });
  const classes = h("select", {
    "aria-label": "Class",
    onchange: () => ((label = classes.value === "*" ? null : classes.value.slice(1)), remember(), arrange()),
  });
  const sorting = select(ORDERS, order, (value) => ((order = value as Order), remember(), arrange()), { "aria-label": "Order" });
  const bar = h("div", { class: "selection", role: "region", "aria-label": "Selected shapes", hidden: true });
  const grid = h("ul", { class: "grid", "aria-label": "Shapes" });
  const empty = h("div");
  const element = h(
    "section",
    { class: "library" },
    h("h1", { class: "hidden" }, "Library"),
    h("div", { class: "toolbar" }, search, classes, sorting, count, h("div", { class: "row end" }, addButtons())),
    bar,
    empty,
    grid,
  );

  function remember(): void {
    const wanted = new URLSearchParams();
    if (order !== "newest") wanted.set("order", order);
    if (label !== null) wanted.set("label", label);
    if (text) wanted.set("name", text);
    const address = wanted.size ? `#/library?${wanted}` : "#/library";
    history.replaceState(null, "", address);
  }

  function keep(shape: Shape, place: number): void {
    if (removing.has(shape.id)) return;
    const { id, name } = shape;
    cards.set(id, { id, name, label: shape.label, warned: shape.warnings.length > 0, place });
  }

  /** Read the newest shapes, and then all others. */
  async function load(): Promise<void> {
    let cursor: string | null = null;
    let place = 0;
    do {
      const page: ShapePage = await getJson("shapes", { order: "newest", cursor, limit: place ? PAGE : FIRST_PAGE }, signal);
      for (const shape of page.items) keep(shape, -place++);
      cursor = page.next_cursor;
      arrange();
    } while (cursor && place < MOST);
    complete = cursor === null;
    arrange();
  }

  /** Read the shapes that were added since. */
  async function refresh(): Promise<void> {
    let cursor: string | null = null;
    const found: Shape[] = [];
    do {
      const page: ShapePage = await getJson("shapes", { order: "newest", cursor, limit: FIRST_PAGE }, signal);
      const fresh = page.items.filter((shape) => !cards.has(shape.id));
      found.push(...fresh);
      cursor = fresh.length === page.items.length ? page.next_cursor : null;
    } while (cursor);
    const top = Math.max(0, ...[...cards.values()].map((card) => card.place));
    found.reverse().forEach((shape, number) => keep(shape, top + 1 + number));
    arrange();
    void loadClasses();
  }

  async function loadClasses(): Promise<void> {
    const found = await getJson<{ items: { label: string; count: number }[] }>("classes", {}, signal);
    classes.replaceChildren(
      h("option", { value: "*", selected: label === null }, "All classes"),
      h("option", { value: "=", selected: label === "" }, "Without a class"),
      ...found.items.map((each) =>
        h("option", { value: `=${each.label}`, selected: label === each.label }, `${each.label} (${each.count})`),
      ),
    );
  }

  /** Choose and order the shapes to show. */
  function arrange(): void {
    const words = text.toLowerCase();
    shown = [...cards.values()].filter(
      (card) => (label === null || (card.label ?? "") === label) && card.name.toLowerCase().includes(words),
    );
    const by = new Intl.Collator("en", { numeric: true }).compare;
    shown.sort((a, b) => {
      if (order === "newest") return b.place - a.place;
      if (order === "oldest") return a.place - b.place;
      if (order === "label") return by(a.label ?? "\uffff", b.label ?? "\uffff") || by(a.name, b.name);
      return by(a.name, b.name);
    });
    const all = cards.size;
    const more = complete ? "" : "+";
    count.textContent =
      shown.length === all ? `${plural(all, "shape")}${more}` : `${shown.length.toLocaleString("en")} of ${plural(all, "shape")}${more}`;
    empty.replaceChildren(...(all || !complete ? [] : [invitation()]));
    if (all && !shown.length) empty.replaceChildren(h("p", { class: "hint" }, "No shape fits this search."));
    for (const id of selected) if (!cards.has(id)) selected.delete(id);
    draw();
  }

  function invitation(): HTMLElement {
    return h(
      "div",
      { class: "empty" },
      h("h2", {}, "This library is empty"),
      h("p", {}, "unbend recognises shapes however they bend: add some, then ask what another mesh is."),
      h("p", {}, "Drop mesh files or a whole folder here: off, obj, ply, stl or glb."),
      h(
        "div",
        { class: "row" },
        addButtons(),
        button("Load the demo shapes", (): void => {
          send("demo", { method: "POST" }).then(() => notify("The demo shapes appear as they are computed."), report);
        }, { class: "plain" }),
      ),
    );
  }

  const drawn = new Map<string, HTMLLIElement>();

  /** Put the visible cards into the document, and take out all others. */
  function draw(): void {
    const width = grid.clientWidth || element.clientWidth || innerWidth - 32;
    columns = Math.max(1, Math.floor((width + CARD.gap) / (CARD.width + CARD.gap)));
    const step = CARD.height + CARD.gap;
    const size = (width - (columns - 1) * CARD.gap) / columns;
    grid.style.height = `${Math.ceil(shown.length / columns) * step}px`;
    const top = grid.getBoundingClientRect().top;
    const first = Math.max(0, Math.floor((-top - step) / step)) * columns;
    const last = Math.min(shown.length, (Math.ceil((innerHeight - top) / step) + 1) * columns);
    const visible = new Set(shown.slice(first, last).map((card) => card.id));
    for (const [id, item] of drawn) {
      if (!visible.has(id)) {
        item.remove();
        drawn.delete(id);
      }
    }
    for (let place = first; place < last; place++) {
      const { id } = shown[place]!;
      const card = drawn.get(id) ?? make(shown[place]!);
      if (!drawn.has(id)) {
        drawn.set(id, card);
        grid.append(card);
      }
      card.setAttribute("aria-setsize", String(shown.length));
      card.setAttribute("aria-posinset", String(place + 1));
      card.style.width = `${size}px`;
      card.style.left = `${(place % columns) * (size + CARD.gap)}px`;
      card.style.top = `${Math.floor(place / columns) * step}px`;
    }
  }

  function make(card: Card): HTMLLIElement {
    const box = h("input", {
      type: "checkbox", checked: selected.has(card.id), "aria-label": `Select ${card.name}`,
      onclick: (event) => choose(card, box.checked, event.shiftKey),
    });
    const caption = h("div", { class: "caption" });
    const item = h(
      "li",
      { class: "card" },
      box,
      h("a", { href: `#/shape/${card.id}`, class: "picture", tabindex: -1, "aria-hidden": "true" }, thumbnail(card.id, "")),
      caption,
    );
    describe(card, caption);
    return item;
  }

  function describe(card: Card, caption: HTMLElement): void {
    caption.replaceChildren(
      h("a", { href: `#/shape/${card.id}`, class: "name", title: card.name }, card.name),
      h(
        "div",
        { class: "row" },
        h("span", { class: card.label ? "label" : "label none" }, card.label ?? "no class"),
        card.warned && h("span", { class: "warned", title: "It has warnings: open it to read them" }, "!"),
        button("Edit", () => edit(card, caption), { class: "quiet", "aria-label": `Edit the name and class of ${card.name}` }),
      ),
    );
  }

  /** Change the name and the label in place. */
  function edit(card: Card, caption: HTMLElement): void {
    const name = h("input", { type: "text", value: card.name, "aria-label": "Name", maxlength: 200 });
    const to = h("input", { type: "text", value: card.label ?? "", "aria-label": "Class", placeholder: "class", maxlength: 200 });
    const form = h(
      "form",
      {
        class: "edit",
        onsubmit: (event) => {
          event.preventDefault();
          const changes = { name: name.value.trim() || card.name, label: to.value.trim() || null };
          void change([card], () => changes).then(() => drawn.get(card.id)?.querySelector<HTMLElement>("a.name")?.focus());
        },
        onkeydown: (event) => event.key === "Escape" && (describe(card, caption), caption.querySelector("button")?.focus()),
      },
      name,
      to,
      h("div", { class: "row" }, h("button", { class: "primary" }, "Save"), button("Cancel", () => describe(card, caption), { class: "quiet" })),
    );
    caption.replaceChildren(form);
    name.select();
  }

  /** Change shapes on the server, and offer to undo it. */
  async function change(of: Card[], changes: (card: Card) => Partial<Pick<Card, "name" | "label">>, undo = true): Promise<void> {
    const before = new Map(of.map((card) => [card.id, { name: card.name, label: card.label }]));
    let done = 0;
    for (const card of of) {
      try {
        const record = await sendJson<Shape>("PATCH", `shapes/${card.id}`, changes(card));
        Object.assign(card, { name: record.name, label: record.label });
        redraw(card.id);
        done++;
      } catch (error) {
        report(error);
        break;
      }
    }
    arrange();
    void loadClasses();
    if (done && undo) {
      const back = (): void => void change(of.slice(0, done), (card) => before.get(card.id)!, false);
      notify(`${plural(done, "shape")} changed.`, { text: "Undo", run: back });
    }
  }

  /** Draw a card again, with its changes. */
  function redraw(id: string): void {
    drawn.get(id)?.remove();
    drawn.delete(id);
  }

  /** Show in the boxes of all cards what is selected. */
  function check(): void {
    for (const [id, item] of drawn) item.querySelector<HTMLInputElement>("input[type=checkbox]")!.checked = selected.has(id);
  }

  function choose(card: Card, on: boolean, range: boolean): void {
    const from = range && anchor ? shown.findIndex((each) => each.id === anchor) : -1;
    const to = shown.indexOf(card);
    const chosen = from < 0 ? [card] : shown.slice(Math.min(from, to), Math.max(from, to) + 1);
    for (const each of chosen) {
      if (on) selected.add(each.id);
      else selected.delete(each.id);
    }
    anchor = card.id;
    check();
    drawBar();
  }

  function drawBar(): void {
    bar.hidden = selected.size === 0;
    const here = (): Card[] => [...selected].flatMap((id) => cards.get(id) ?? []);
    bar.replaceChildren(
      h("strong", {}, `${selected.size} selected`),
      button("Select all shown", () => (shown.forEach((card) => selected.add(card.id)), check(), drawBar()), { class: "quiet" }),
      button("Set class", () => void relabel(here()), { class: "plain" }),
      button("Download", () => void download(here()), { class: "plain" }),
      button("Remove", () => remove(here()), { class: "plain danger" }),
      button("Clear", () => (selected.clear(), check(), drawBar()), { class: "quiet" }),
    );
  }

  async function relabel(of: Card[]): Promise<void> {
    const input = h("input", { type: "text", maxlength: 200 });
    if (!(await ask(`Class of ${plural(of.length, "shape")}`, "Set", field("Class", input, "Leave it empty for none.")))) return;
    await change(of, () => ({ label: input.value.trim() || null }));
  }

  async function download(of: Card[]): Promise<void> {
    try {
      for (const card of of) await save(`shapes/${card.id}/mesh`);
    } catch (error) {
      report(error);
    }
  }

  /** Take shapes off the page; the server removes them when the time to undo is over. */
  function remove(of: Card[]): void {
    for (const card of of) {
      removing.add(card.id);
      cards.delete(card.id);
    }
    selected.clear();
    drawBar();
    arrange();
    const finish = (): void => {
      removeEventListener("pagehide", finish);
      for (const card of of) {
        const headers: HeadersInit = key() ? { Authorization: `Bearer ${key()}` } : {};
        fetch(url(`shapes/${card.id}`), { method: "DELETE", keepalive: true, headers })
          .then((answer) => {
            if (!answer.ok && answer.status !== 404) throw new Error(`${card.name} was not removed: the server answered ${answer.status}.`);
          })
          .catch((error: unknown) => (report(error), removing.delete(card.id)));
      }
    };
    addEventListener("pagehide", finish);
    let undone = false;
    const undo = (): void => {
      undone = true;
      removeEventListener("pagehide", finish);
      for (const card of of) {
        removing.delete(card.id);
        cards.set(card.id, card);
      }
      arrange();
    };
    notify(`${plural(of.length, "shape")} removed.`, { text: "Undo", run: undo }, "plain", () => undone || finish());
  }

  takesDrops(element, (found) => void offer(found), signal);
  addEventListener("scroll", draw, { signal, passive: true });
  addEventListener("resize", draw, { signal });
  let refreshing: ReturnType<typeof setTimeout> | undefined;
  library.addEventListener(
    "stored",
    () => {
      clearTimeout(refreshing);
      refreshing = setTimeout(() => void refresh().catch(report), 400);
    },
    { signal },
  );
  new ResizeObserver(draw).observe(grid);
  const loading = load();
  loading.catch(report);
  void loadClasses().catch(report);
  await Promise.race([loading, new Promise((resolve) => setTimeout(resolve, 150))]);
  return { title: "Library", element };
}
