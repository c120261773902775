/** A picture of a shape that loads when it comes into view. */

import { picture, type Drawing } from "../api/pictures";
import { h } from "./dom";

export function thumbnail(shapeId: string, alternative: string, drawing: Drawing = {}): HTMLElement {
  const image = h("img", { alt: "", width: drawing.width ?? 256, height: drawing.height ?? 256, draggable: "false" });
  const frame = h("span", { class: "thumbnail", role: "img", "aria-label": alternative }, image);
  const load = async (): Promise<void> => {
    try {
      const link = await picture(shapeId, drawing, () => frame.isConnected);
      if (link) image.src = link;
    } catch {
      frame.classList.add("broken"); // the reason is shown where the shape is opened
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
