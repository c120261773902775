/** Short messages, and questions in a dialog. */

import { ApiError } from "../api/client";
import { button, h, type Child } from "./dom";

const SECONDS = 8;
/** Time in which an action can be taken. */
export const ACTION_SECONDS = 20;

const stack = h("div", { class: "notices", role: "status", "aria-live": "polite" });
document.body.append(stack);

export interface Action {
  text: string;
  run: () => void;
}

/** Show a message for some seconds, and longer under the pointer or with the focus; `closed` is called once it is gone. */
export function notify(message: string, action?: Action, kind: "plain" | "error" = "plain", closed?: () => void): void {
  const close = (): void => {
    clearTimeout(timer);
    notice.remove();
    closed?.();
  };
  const notice = h(
    "div",
    { class: `notice ${kind}` },
    h("span", {}, message),
    action && button(action.text, () => (action.run(), close()), { class: "quiet" }),
    button("×", close, { class: "quiet", "aria-label": "Close this message" }),
  );
  stack.append(notice);
  const wait = (): ReturnType<typeof setTimeout> => setTimeout(close, (action ? ACTION_SECONDS : SECONDS) * 1000);
  let timer = wait();
  for (const event of ["pointerenter", "focusin"]) notice.addEventListener(event, () => clearTimeout(timer));
  for (const event of ["pointerleave", "focusout"]) {
    notice.addEventListener(event, () => {
      clearTimeout(timer);
      if (notice.isConnected) timer = wait();
    });
  }
}

/** Show what went wrong, in the words of the service. */
export function report(error: unknown): void {
  if (error instanceof DOMException && error.name === "AbortError") return;
  if (error instanceof ApiError && (error.code === "away" || error.status === 401)) return; // shown elsewhere
  notify(describe(error), undefined, "error");
  if (!(error instanceof ApiError)) console.error(error);
}

export function describe(error: unknown): string {
  if (error instanceof ApiError) return [error.message, error.advice].filter(Boolean).join(" – ");
  return error instanceof Error ? error.message : String(error);
}

/** Show a dialog with a form; resolve with true if it was submitted. */
export function ask(title: string, submit: string, ...content: Child[]): Promise<boolean> {
  const { promise, resolve } = Promise.withResolvers<boolean>();
  const dialog = h(
    "dialog",
    { "aria-labelledby": "dialog-title", onclose: () => (resolve(dialog.returnValue === "yes"), dialog.remove()) },
    h(
      "form",
      { method: "dialog" },
      h("h2", { id: "dialog-title" }, title),
      content,
      h(
        "div",
        { class: "row end" },
        button("Cancel", () => dialog.close("no"), { class: "plain" }),
        h("button", { value: "yes", class: "primary" }, submit),
      ),
    ),
  );
  document.body.append(dialog);
  dialog.showModal();
  return promise;
}
