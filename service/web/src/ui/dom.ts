/** Small helpers that build elements. */

const LEAST_SHARE = 0.001; // the smallest that is written as a number

export type Child = Node | string | number | null | undefined | false | Child[];

type Handlers = { [K in keyof HTMLElementEventMap as `on${K}`]?: (event: HTMLElementEventMap[K]) => void };
export type Attributes = Handlers & { [name: string]: unknown };

/** Make an element. `on…` attributes are listeners; true and false set and leave out an attribute. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on") && typeof value === "function") {
      element.addEventListener(name.slice(2), value as EventListener);
    } else if (name === "value" || name === "checked") {
      (element as unknown as Record<string, unknown>)[name] = value;
    } else {
      element.setAttribute(name, value === true ? "" : String(value));
    }
  }
  append(element, children);
  return element;
}

/** Make an SVG element. */
export function svg(tag: string, attributes: Record<string, string | number> = {}, ...children: Node[]): SVGElement {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(...children);
  return element;
}

function append(parent: Element, children: Child[]): void {
  for (const child of children) {
    if (Array.isArray(child)) append(parent, child);
    else if (child !== null && child !== undefined && child !== false) {
      parent.append(child instanceof Node ? child : String(child));
    }
  }
}

/** Return text in which words between backticks are code. */
export function coded(text: string): Child[] {
  const parts = text.split("`");
  if (parts.length % 2 === 0) return [text]; // a single backtick encloses nothing
  return parts.map((part, place) => (place % 2 ? h("code", {}, part) : part));
}

/** Make a labelled field: its label is read with it. */
export function field(label: string, input: HTMLElement, hint?: string): HTMLLabelElement {
  return h("label", { class: "field" }, h("span", {}, label), input, hint ? h("small", {}, hint) : null);
}

export function select(
  options: readonly (readonly [value: string, text: string])[],
  chosen: string,
  change: (value: string) => void,
  attributes: Attributes = {},
): HTMLSelectElement {
  const element = h(
    "select",
    { ...attributes, onchange: () => change(element.value) },
    options.map(([value, text]) => h("option", { value, selected: value === chosen }, text)),
  );
  return element;
}

export function button(text: string, press: () => void, attributes: Attributes = {}): HTMLButtonElement {
  return h("button", { type: "button", ...attributes, onclick: press }, text);
}

/** Format a number with three significant digits. */
export function figure(value: number | null | undefined): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value !== 0 && (Math.abs(value) < 0.001 || Math.abs(value) >= 1e6)) return value.toExponential(2);
  return Number(value.toPrecision(3)).toLocaleString("en");
}

export function percent(value: number | null | undefined): string {
  if (value === null || value === undefined) return "–";
  return value > 0 && value < LEAST_SHARE ? "< 0.1 %" : `${(100 * value).toFixed(1)} %`;
}

export function plural(count: number, one: string, many = `${one}s`): string {
  return `${count.toLocaleString("en")} ${count === 1 ? one : many}`;
}
