/** Drafts: frames of fewer pixels and faces, for cameras that move where a whole frame takes long. */

/** Milliseconds that a frame may take while the camera moves. */
const FRAME = 40;

const LEAST_SCALE = 0.35;
const MOST_FACES = 8_000;
const GRIDS = [64, 48, 36, 28, 22, 16, 12];

export function isSlow(frame: number): boolean {
  return frame > FRAME;
}

/** Share of the pixels along each side that a draft draws, by the milliseconds of a whole frame. */
export function draftScale(frame: number): number {
  return Math.min(1, Math.max(LEAST_SCALE, Math.sqrt(FRAME / frame)));
}

/**
 * Faces of a coarser mesh between some of the same vertices (vertex clustering, Rossignac & Borrel 1993).
 *
 * Vertices are joined only if they are near each other on the surface and in its signature, so that a hand which touches
 * a hip stays apart from it.
 */
export function draftFaces(positions: Float32Array, form: Float32Array | undefined, faces: Uint32Array): Uint32Array {
  let found = faces;
  for (const cells of GRIDS) {
    if (found.length <= 3 * MOST_FACES) break;
    found = joined(faces, clusters([positions, ...(form ? [form] : [])], cells));
  }
  return found;
}

/** For each vertex, the first vertex in its cell. */
function clusters(places: Float32Array[], cells: number): Uint32Array {
  const boxes = places.map((points) => box(points));
  const first = new Map<number, number>();
  const found = new Uint32Array(places[0]!.length / 3);
  for (let vertex = 0; vertex < found.length; vertex++) {
    let key = 0;
    places.forEach((points, number) => {
      const { low, side } = boxes[number]!;
      for (let axis = 0; axis < 3; axis++) {
        const cell = Math.floor((cells * (points[3 * vertex + axis]! - low[axis]!)) / side);
        key = key * cells + Math.min(cells - 1, cell);
      }
    });
    const known = first.get(key);
    if (known === undefined) first.set(key, vertex);
    found[vertex] = known ?? vertex;
  }
  return found;
}

function box(points: Float32Array): { low: number[]; side: number } {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < points.length; i++) {
    low[i % 3] = Math.min(low[i % 3]!, points[i]!);
    high[i % 3] = Math.max(high[i % 3]!, points[i]!);
  }
  return { low, side: Math.max(...high.map((value, axis) => value - low[axis]!)) || 1 };
}

function joined(faces: Uint32Array, cluster: Uint32Array): Uint32Array {
  const kept = new Uint32Array(faces.length);
  let count = 0;
  for (let face = 0; face < faces.length; face += 3) {
    const [i, j, k] = [cluster[faces[face]!]!, cluster[faces[face + 1]!]!, cluster[faces[face + 2]!]!];
    if (i === j || j === k || k === i) continue;
    kept.set([i, j, k], count);
    count += 3;
  }
  return kept.slice(0, count);
}
