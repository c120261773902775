/** A match of two views: where the vertices of the first are on the second, and what of the second they cover. */

import { at, distance, vertexAreas, type Point } from "./geometry";
import type { Mesh } from "./glb";

/** The file of a match: a row for each vertex of the first file. */
export interface Found {
  /** Vertices of the second file at the corners of a triangle; -1 if there is no point. */
  corners: [number, number, number][];
  barycentric: [number, number, number][];
  confidence: number[];
  residual: number;
  oriented: boolean;
  ambiguous: boolean;
}

const GREY = 0.55;
const REACH = 2; // a point of the second is covered within this many lengths of an edge
const WHOLE = 0.95; // a larger share of the second counts as all of it

export class Matching {
  /** The place on the second of each vertex of the first, NaN where there is none. */
  readonly images: Float32Array;
  /** Confidence at each vertex of the first. */
  readonly confidence: Float32Array;
  /** Share of the area of the second that is near an image; 1 if it is nearly all. */
  readonly share: number;
  private readonly covered: Uint8Array;
  private readonly reach: number;
  private readonly cells = new Map<string, number[]>();

  /** `corners` is the second mesh with all its vertices; `second` may be simpler, around the same centre. */
  constructor(
    readonly first: Mesh,
    readonly second: Mesh,
    corners: Mesh,
    readonly found: Found,
  ) {
    this.images = imagesOf(first, corners, found);
    this.confidence = first.numbers!.map((number) => found.confidence[number] ?? 0);
    this.reach = REACH * Math.max(edge(this.images, first.faces), edge(second.positions, second.faces) / 2);
    for (let vertex = 0; vertex < this.images.length / 3; vertex++) {
      if (!this.has(vertex)) continue;
      const name = this.cell(at(this.images, vertex)).join();
      const inside = this.cells.get(name);
      if (inside) inside.push(vertex);
      else this.cells.set(name, [vertex]);
    }
    const count = second.positions.length / 3;
    this.covered = Uint8Array.from({ length: count }, (_, vertex) => (this.back(vertex) === null ? 0 : 1));
    const areas = vertexAreas(second.positions, second.faces);
    const whole = areas.reduce((sum, area) => sum + area, 0) || 1;
    const share = areas.reduce((sum, area, vertex) => (this.covered[vertex] ? sum + area : sum), 0) / whole;
    this.share = share > WHOLE ? 1 : share;
  }

  /** Whether a vertex of the first has a point. */
  has(vertex: number): boolean {
    return Number.isFinite(this.images[3 * vertex]!);
  }

  /** The vertex of the first whose point is nearest to a vertex of the second, null if none is near. */
  back(vertex: number): number | null {
    const place = at(this.second.positions, vertex);
    const [x, y, z] = this.cell(place);
    let [found, least]: [number | null, number] = [null, this.reach];
    for (let i = x - 1; i <= x + 1; i++) {
      for (let j = y - 1; j <= y + 1; j++) {
        for (let k = z - 1; k <= z + 1; k++) {
          for (const each of this.cells.get([i, j, k].join()) ?? []) {
            const away = distance(place, at(this.images, each));
            if (away < least) [found, least] = [each, away];
          }
        }
      }
    }
    return found;
  }

  /** Colours of both that are equal at equal places; grey where nothing is matched. */
  colours(): [Float32Array, Float32Array] {
    const { positions } = this.second;
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    positions.forEach((value, i) => {
      low[i % 3] = Math.min(low[i % 3]!, value);
      high[i % 3] = Math.max(high[i % 3]!, value);
    });
    const colour = (value: number, i: number): number =>
      Number.isFinite(value) ? 0.08 + 0.87 * Math.min(1, Math.max(0, (value - low[i % 3]!) / (high[i % 3]! - low[i % 3]! || 1))) : GREY;
    const shown = (value: number, i: number): number =>
      this.share === 1 || this.covered[Math.floor(i / 3)] ? colour(value, i) : GREY;
    return [this.images.map(colour), positions.map(shown)];
  }

  private cell(place: Point): Point {
    return [Math.floor(place[0] / this.reach), Math.floor(place[1] / this.reach), Math.floor(place[2] / this.reach)];
  }
}

function imagesOf(first: Mesh, second: Mesh, found: Found): Float32Array {
  const byNumber = new Map<number, number>();
  second.numbers!.forEach((number, vertex) => byNumber.set(number, vertex));
  const images = new Float32Array(first.positions.length).fill(NaN);
  first.numbers!.forEach((number, vertex) => {
    const weights = found.barycentric[number];
    const places = (found.corners[number] ?? []).map((corner) => byNumber.get(corner));
    if (!weights || places.some((place) => place === undefined)) return;
    for (let axis = 0; axis < 3; axis++) {
      images[3 * vertex + axis] = places.reduce<number>((sum, place, i) => sum + weights[i]! * second.positions[3 * place! + axis]!, 0);
    }
  });
  return images;
}

/** The middle of all lengths of edges. */
function edge(positions: Float32Array, faces: Uint32Array): number {
  const lengths: number[] = [];
  for (let face = 0; face < faces.length; face += 3) {
    const length = distance(at(positions, faces[face]!), at(positions, faces[face + 1]!));
    if (length > 0) lengths.push(length);
  }
  return lengths.sort((a, b) => a - b)[lengths.length >> 1] ?? 1;
}
