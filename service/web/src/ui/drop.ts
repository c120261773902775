/** Files and whole folders, dropped or picked, and the question how to label them. */

import { isMesh, upload, type Upload } from "../jobs";
import { button, h, plural } from "./dom";
import { ask, notify } from "./notices";

interface Found {
  file: File;
  /** The folder that contains it; empty if none is known. */
  folder: string;
}

/** Ask for files, or for a folder. */
export function pick(folder: boolean): Promise<Found[]> {
  const { promise, resolve } = Promise.withResolvers<Found[]>();
  const input = h("input", { type: "file", multiple: true, accept: folder ? undefined : ".off,.obj,.ply,.stl,.glb" });
  input.webkitdirectory = folder;
  input.addEventListener("change", () => {
    resolve([...(input.files ?? [])].map((file) => ({ file, folder: parent(file.webkitRelativePath) })));
  });
  input.click();
  return promise;
}

function parent(path: string): string {
  return path.split("/").at(-2) ?? "";
}

/** Return all files of a drop, also those in folders. */
export async function dropped(transfer: DataTransfer): Promise<Found[]> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  const files = [...transfer.files];
  if (!entries.length) return files.map((file) => ({ file, folder: "" }));
  return (await Promise.all(entries.map((entry) => walk(entry, "")))).flat();
}

async function walk(entry: FileSystemEntry, folder: string): Promise<Found[]> {
  if (entry.isFile) {
    const { promise, resolve, reject } = Promise.withResolvers<File>();
    (entry as FileSystemFileEntry).file(resolve, reject);
    return [{ file: await promise, folder }];
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  const found: Found[] = [];
  for (;;) {
    const { promise, resolve, reject } = Promise.withResolvers<FileSystemEntry[]>();
    reader.readEntries(resolve, reject);
    const batch = await promise; // at most 100 at a time
    if (!batch.length) return found;
    found.push(...(await Promise.all(batch.map((each) => walk(each, entry.name)))).flat());
  }
}

/** Ask how to label files, and send them. */
export async function offer(found: Found[]): Promise<void> {
  const { compare } = new Intl.Collator("en", { numeric: true });
  const meshes = found.filter(({ file }) => isMesh(file));
  meshes.sort((a, b) => compare(a.folder, b.folder) || compare(a.file.name, b.file.name));
  if (!meshes.length) {
    if (found.length) notify("None of these files is a mesh: off, obj, ply, stl and glb are read.", undefined, "error");
    return;
  }
  const folders = counts(meshes.map(({ folder }) => folder).filter(Boolean));
  const label = h("input", { type: "text", "aria-label": "Class of all files", maxlength: 200 });
  const choice = (value: string, text: string, checked: boolean): HTMLElement =>
    h("label", { class: "choice" }, h("input", { type: "radio", name: "labels", value, checked }), h("span", {}, text));
  const several = folders.size > 1;
  const byFolder = [...folders].slice(0, 12).map(([name, count]) => `${name} (${count})`).join(", ");
  const one = choice("one", "One class for all:", false);
  label.addEventListener("input", () => (one.querySelector("input")!.checked = true));
  const form = h(
    "fieldset",
    {},
    h("legend", {}, "Class of each shape, if you know it"),
    folders.size > 0 && choice("folder", `The name of its folder: ${byFolder}${folders.size > 12 ? ", …" : ""}`, several),
    choice("none", "No class", !several),
    h("div", { class: "row" }, one, label),
  );
  const others = found.filter(({ file }) => !isMesh(file)).map(({ file }) => file.name);
  const named = others.slice(0, 3).join(", ") + (others.length > 3 ? ` and ${others.length - 3} more` : "");
  const remark = others.length > 0 && h("p", { class: "hint" }, `Not a mesh, and not sent: ${named}.`);
  if (!(await ask(`Add ${plural(meshes.length, "mesh", "meshes")} to the library`, "Add", remark, form))) return;
  const chosen = form.querySelector<HTMLInputElement>("input:checked")?.value;
  const uploads = meshes.map(({ file, folder }): Upload => {
    if (chosen === "folder") return { file, label: folder || null };
    return { file, label: chosen === "one" ? label.value.trim() || null : null };
  });
  upload(uploads);
}

function counts(names: string[]): Map<string, number> {
  const found = new Map<string, number>();
  for (const name of names) found.set(name, (found.get(name) ?? 0) + 1);
  return found;
}

/** Make an element take dropped files. */
export function takesDrops(element: HTMLElement, receive: (found: Found[]) => void, signal: AbortSignal): void {
  const options = { signal };
  element.addEventListener(
    "dragover",
    (event) => {
      if (!event.dataTransfer?.types.includes("Files")) return;
      event.preventDefault();
      element.classList.add("over");
    },
    options,
  );
  element.addEventListener("dragleave", () => element.classList.remove("over"), options);
  element.addEventListener(
    "drop",
    (event) => {
      event.preventDefault();
      element.classList.remove("over");
      if (event.dataTransfer) void dropped(event.dataTransfer).then(receive);
    },
    options,
  );
}

/** Two buttons that add files, and a folder. */
export function addButtons(): HTMLElement[] {
  return [
    button("Add files", () => void pick(false).then(offer), { class: "primary" }),
    button("Add a folder", () => void pick(true).then(offer), { class: "plain" }),
  ];
}

export type { Found };
