/** Textures that show how a surface was flattened. */

import { h } from "../ui/dom";

const SIZE = 1024;

function drawn(paint: (context: CanvasRenderingContext2D) => void): HTMLCanvasElement {
  const canvas = h("canvas", { width: SIZE, height: SIZE });
  const context = canvas.getContext("2d")!;
  context.fillStyle = "#f4f1ea";
  context.fillRect(0, 0, SIZE, SIZE);
  paint(context);
  return canvas;
}

export const TEXTURES: Record<string, () => HTMLCanvasElement> = {
  checks: () =>
    drawn((context) => {
      const count = 24;
      const step = SIZE / count;
      context.fillStyle = "#c8553d";
      for (let row = 0; row < count; row++) {
        for (let column = row % 2; column < count; column += 2) context.fillRect(column * step, row * step, step, step);
      }
    }),
  rings: () =>
    drawn((context) => {
      context.strokeStyle = "#28666e";
      context.lineWidth = 10;
      for (let ring = 0; ring < 40; ring++) {
        context.beginPath();
        context.arc(SIZE / 2, SIZE / 2, 10 + 22 * ring, 0, 2 * Math.PI);
        context.stroke();
      }
    }),
  letters: () =>
    drawn((context) => {
      context.fillStyle = "#2b2d42";
      context.font = "bold 60px sans-serif";
      const words = "UNBEND ";
      for (let row = 0; row < 15; row++) {
        for (let column = 0; column < 20; column++) context.fillText(words[(row + column) % words.length]!, column * 56, 60 + row * 70);
      }
    }),
};
