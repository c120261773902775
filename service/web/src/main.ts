/** The page: its frame, its addresses, and what holds for all views. */

import { getJson, key, server, setKey } from "./api/client";
import { follow, restart } from "./jobs";
import { ask, describe, report } from "./ui/notices";
import { button, field, h } from "./ui/dom";

export interface View {
  title: string;
  element: HTMLElement;
}

type Make = (parts: string[], query: URLSearchParams, signal: AbortSignal) => Promise<View> | View;

/** The views by the first part of their address; each is loaded when first needed. */
const VIEWS: Record<string, () => Promise<Make>> = {
  library: async () => (await import("./views/library")).libraryView,
  shape: async () => (await import("./views/shape")).shapeView,
  pair: async () => (await import("./views/pair")).pairView,
  match: async () => (await import("./views/match")).matchView,
  flatten: async () => (await import("./views/flatten")).flattenView,
  ask: async () => (await import("./views/ask")).askView,
  map: async () => (await import("./views/map")).mapView,
  evaluation: async () => (await import("./views/evaluation")).evaluationView,
};
const LINKS = [
  ["library", "Library"],
  ["ask", "Ask"],
  ["map", "Map"],
  ["evaluation", "Evaluation"],
] as const;

const nav = h("nav", { "aria-label": "Views" }, LINKS.map(([name, text]) => h("a", { href: `#/${name}` }, text)));
const keyButton = button("Key", () => void askForKey(), { class: "quiet", hidden: key() === null });
const themeButton = button("Theme", switchTheme, { class: "quiet" });
const header = h(
  "header",
  { class: "top" },
  h("a", { class: "brand", href: "#/library" }, "unbend"),
  nav,
  h("div", { class: "row end" }, h("a", { class: "quiet", href: "./docs" }, "API"), keyButton, themeButton),
);
const banner = h("div", { class: "banner", role: "alert", hidden: true });
const main = h("main", { id: "main", tabindex: -1 });
const skip = h("a", { class: "skip", href: "#main" }, "Skip to the content");
skip.addEventListener("click", (event) => (event.preventDefault(), main.focus()));
document.body.prepend(skip, header, banner, main);

const SLOW_MS = 150;

// Style rules place sticky elements below the header by its height.
new ResizeObserver(() => document.documentElement.style.setProperty("--header", `${header.offsetHeight}px`)).observe(header);

let current = new AbortController();

async function show(): Promise<void> {
  current.abort();
  current = new AbortController();
  const { signal } = current;
  const [path = "", search = ""] = location.hash.replace(/^#\/?/, "").split("?");
  const [name = "", ...parts] = path.split("/").map(decodeURIComponent);
  const load = VIEWS[name] ?? VIEWS["library"]!;
  for (const link of nav.children) {
    if (link.getAttribute("href") === `#/${name || "library"}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  main.setAttribute("aria-busy", "true");
  const slow = setTimeout(() => main.replaceChildren(h("p", { class: "hint loading" }, "Loading …")), SLOW_MS);
  try {
    const view = await (await load())(parts, new URLSearchParams(search), signal);
    if (signal.aborted) return;
    document.title = `${view.title} · unbend`;
    main.replaceChildren(view.element);
    scrollTo(0, 0);
  } catch (error) {
    if (signal.aborted) return;
    main.replaceChildren(failure(error));
  } finally {
    clearTimeout(slow);
    if (!signal.aborted) main.removeAttribute("aria-busy");
  }
}

function failure(error: unknown): HTMLElement {
  return h(
    "section",
    { class: "empty" },
    h("h1", {}, "This could not be shown"),
    h("p", {}, describe(error)),
    h("div", { class: "row" }, button("Try again", () => void show(), { class: "primary" }), h("a", { href: "#/library" }, "To the library")),
  );
}

let asking = false;

async function askForKey(): Promise<void> {
  if (asking) return;
  asking = true;
  const input = h("input", { type: "password", autocomplete: "off", spellcheck: "false" });
  const text =
    "A key from “unbend keys create”. This page keeps it until you close the tab. A read key can look and ask; " +
    "adding, changing and removing shapes needs a write key.";
  const had = key() !== null;
  if (had) input.placeholder = "A key is in use; leave this empty to forget it";
  const given = await ask("API key", "Use", h("p", {}, text), field("Key", input));
  asking = false;
  if (!given) return;
  setKey(input.value.trim() || null);
  restart();
  void getJson("classes").then(show, (error: unknown) => (report(error), show()));
}

server.addEventListener("key", () => {
  keyButton.hidden = false;
  setKey(null);
  void askForKey();
});
server.addEventListener("away", () => {
  banner.textContent = "The server does not answer. This page tries again until it does.";
  banner.hidden = false;
});
server.addEventListener("back", () => {
  banner.hidden = true;
  void show();
});

function switchTheme(): void {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  const now = document.documentElement.dataset["theme"] ?? (dark ? "dark" : "light");
  setTheme(now === "dark" ? "light" : "dark");
}

function setTheme(name: string): void {
  document.documentElement.dataset["theme"] = name;
  localStorage.setItem("unbend.theme", name);
  dispatchEvent(new Event("themechange"));
}

const theme = localStorage.getItem("unbend.theme");
if (theme) document.documentElement.dataset["theme"] = theme;

addEventListener("hashchange", () => void show());
void show().then(() => setTimeout(follow, 500));
