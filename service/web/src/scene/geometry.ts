/** Geometry that the views compute themselves. */

export type Point = [number, number, number];

/** Unit vector from the origin towards the first position of the camera. */
export const FIRST_DIRECTION: Point = [0.5443, 0.2771, 0.7918];

export function at(points: Float32Array, vertex: number): Point {
  return [points[3 * vertex]!, points[3 * vertex + 1]!, points[3 * vertex + 2]!];
}

export function distance(a: Point, b: Point): number {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

/** Unit normals of vertices: the normalised sum of the adjacent faces' normals, weighted by area. */
export function normals(positions: Float32Array, faces: Uint32Array): Float32Array {
  const found = new Float32Array(positions.length);
  for (let face = 0; face < faces.length; face += 3) {
    const [i, j, k] = [3 * faces[face]!, 3 * faces[face + 1]!, 3 * faces[face + 2]!];
    const ux = positions[j]! - positions[i]!;
    const uy = positions[j + 1]! - positions[i + 1]!;
    const uz = positions[j + 2]! - positions[i + 2]!;
    const vx = positions[k]! - positions[i]!;
    const vy = positions[k + 1]! - positions[i + 1]!;
    const vz = positions[k + 2]! - positions[i + 2]!;
    const x = uy * vz - uz * vy;
    const y = uz * vx - ux * vz;
    const z = ux * vy - uy * vx;
    for (const corner of [i, j, k]) {
      found[corner]! += x;
      found[corner + 1]! += y;
      found[corner + 2]! += z;
    }
  }
  for (let i = 0; i < found.length; i += 3) {
    const size = Math.hypot(found[i]!, found[i + 1]!, found[i + 2]!) || 1;
    found[i]! /= size;
    found[i + 1]! /= size;
    found[i + 2]! /= size;
  }
  return found;
}

/** Largest distance of a point from the origin. */
export function radius(points: Float32Array): number {
  let most = 0;
  for (let i = 0; i < points.length; i += 3) most = Math.max(most, Math.hypot(points[i]!, points[i + 1]!, points[i + 2]!));
  return most;
}

/** Points moved so that the middle of their box is the origin. */
export function centred(points: Float32Array): Float32Array {
  const low: Point = [Infinity, Infinity, Infinity];
  const high: Point = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < points.length; i++) {
    low[i % 3] = Math.min(low[i % 3]!, points[i]!);
    high[i % 3] = Math.max(high[i % 3]!, points[i]!);
  }
  return points.map((value, i) => value - (low[i % 3]! + high[i % 3]!) / 2);
}

/**
 * Return the corner with the largest barycentric coordinate where a ray first meets the mesh; -1 if it misses
 * (Moeller & Trumbore 1997).
 */
export function pick(positions: Float32Array, faces: Uint32Array, origin: Point, ray: Point): number {
  let nearest = Infinity;
  let vertex = -1;
  for (let face = 0; face < faces.length; face += 3) {
    const [i, j, k] = [faces[face]!, faces[face + 1]!, faces[face + 2]!];
    const a = at(positions, i);
    const b = at(positions, j);
    const c = at(positions, k);
    const u = minus(b, a);
    const v = minus(c, a);
    const p = cross(ray, v);
    const determinant = dot(u, p);
    if (Math.abs(determinant) < 1e-20) continue;
    const t = minus(origin, a);
    const s = dot(t, p) / determinant;
    if (s < 0 || s > 1) continue;
    const q = cross(t, u);
    const r = dot(ray, q) / determinant;
    if (r < 0 || s + r > 1) continue;
    const along = dot(v, q) / determinant;
    if (along > 0 && along < nearest) {
      nearest = along;
      vertex = s > r && s > 1 - s - r ? j : r > 1 - s - r ? k : i;
    }
  }
  return vertex;
}

function minus(a: Point, b: Point): Point {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

function cross(a: Point, b: Point): Point {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function dot(a: Point, b: Point): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** Area of each vertex: a third of the area of its faces. */
export function vertexAreas(positions: Float32Array, faces: Uint32Array): Float32Array {
  const areas = new Float32Array(positions.length / 3);
  for (let face = 0; face < faces.length; face += 3) {
    const [i, j, k] = [faces[face]!, faces[face + 1]!, faces[face + 2]!];
    const a = at(positions, i);
    const normal = cross(minus(at(positions, j), a), minus(at(positions, k), a));
    const third = Math.hypot(...normal) / 6;
    for (const corner of [i, j, k]) areas[corner]! += third;
  }
  return areas;
}
