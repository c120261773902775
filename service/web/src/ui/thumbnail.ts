/** A picture of a shape that loads when it comes into view. */

import { pause } from "../api/client";
import { picture, type Drawing } from "../api/pictures";
import { h } from "./dom";

const RETRY_MS = 2000;
const MOST_ATTEMPTS = 4;

export function thumbnail(shapeId: string, alternative: string, drawing: Drawing = {}): HTMLElement {
  const image = h("img", { alt: "", width: drawing.width ?? 256, height: drawing.height ?? 256, draggable: "false" });
  const frame = h("span", alternative ? { class: "thumbnail", role: "img", "aria-label": alternative } : { class: "thumbnail" }, image);
  const load = async (attempt = 0): Promise<void> => {
    try {
      const link = await picture(shapeId, drawing, () => frame.isConnected);
      if (link) image.src = link;
      frame.classList.toggle("broken", !link);
    } catch {
      frame.classList.add("broken"); // the reason is shown where the shape is opened
      await pause(RETRY_MS * 2 ** attempt);
      if (attempt < MOST_ATTEMPTS && frame.isConnected) await load(attempt + 1);
    }
  };
  const observer = new IntersectionObserver((entries) => {
    if (entries.some((entry) => entry.isIntersecting)) {
      observer.disconnect();
      void load();
    }
  });
  observer.observe(frame);
  return frame;
}
