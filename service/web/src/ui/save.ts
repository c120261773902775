/** Downloads: by fetch, because a link cannot send the key. */

import { send, type Query } from "../api/client";
import { button, h } from "./dom";
import { report } from "./notices";

/** Download a file of the API under the name that the server gives it. */
export async function save(path: string, query: Query = {}): Promise<void> {
  const response = await send(path, {}, query);
  const given = response.headers.get("Content-Disposition") ?? "";
  const encoded = /filename\*=UTF-8''([^;]+)/.exec(given)?.[1];
  const name = encoded ? decodeURIComponent(encoded) : (/filename="([^"]+)"/.exec(given)?.[1] ?? "file");
  const link = URL.createObjectURL(await response.blob());
  const anchor = h("a", { href: link, download: name });
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(link), 60_000);
}

export function saveButton(text: string, path: string, query: Query = {}): HTMLButtonElement {
  return button(text, () => void save(path, query).catch(report), { class: "plain" });
}
