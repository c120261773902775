/** Colours of fields, classes and points that correspond. */

export interface Map {
  bytes: Uint8Array<ArrayBuffer>;
  css: string;
}

function blend(stops: string[]): Map {
  const colours = stops.map((stop) => [1, 3, 5].map((i) => parseInt(stop.slice(i, i + 2), 16)));
  const bytes = new Uint8Array(4 * 256);
  for (let i = 0; i < 256; i++) {
    const place = (i / 255) * (colours.length - 1);
    const left = Math.min(Math.floor(place), colours.length - 2);
    for (let channel = 0; channel < 3; channel++) {
      const [a, b] = [colours[left]![channel]!, colours[left + 1]![channel]!];
      bytes[4 * i + channel] = Math.round(a + (place - left) * (b - a));
    }
    bytes[4 * i + 3] = 255;
  }
  return { bytes, css: `linear-gradient(to right, ${stops.join(", ")})` };
}

/** Viridis, for values that grow. */
export const SEQUENTIAL = blend([
  "#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725",
]);

/** Blue, grey and red (Moreland 2009), for values on both sides of a middle. */
export const DIVERGING = blend(["#3b4cc0", "#6f92f3", "#aac7fd", "#dddcdc", "#f7b89c", "#e7745b", "#b40426"]);

/** A colour for each class: neighbours in the list differ in hue and in lightness. */
export function classColours(labels: readonly string[]): globalThis.Map<string, string> {
  return new globalThis.Map(
    labels.filter(Boolean).map((label, number) => {
      const hue = Math.round((number * 137.508) % 360);
      const light = [44, 60, 32][number % 3]!;
      return [label, `hsl(${hue} 62% ${light}%)`];
    }),
  );
}

/** Colours by place: equal for points that lie alike. Places are in [-1, 1]. */
export function placeColours(points: Float32Array, scale: number): Float32Array {
  return points.map((value) => Math.min(0.95, Math.max(0.08, 0.5 + (0.5 * value) / scale)));
}
