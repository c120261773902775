/** Laying one form on another: both are known up to a rotation and a reflection. */

import { at, centred, type Point } from "./geometry";

const SAMPLES = 350;
const ROUNDS = 25;

type Matrix = number[][];

/** Return both forms, each centred and scaled to size 1, the second turned, perhaps mirrored, to lie best on the first. */
export function align(first: Float32Array, second: Float32Array): [Float32Array, Float32Array] {
  const [a, b] = [unit(first), unit(second)];
  const [onto, from] = [sample(a), sample(b)];
  const [axesA, axesB] = [principalAxes(onto), principalAxes(from)];
  let best: Matrix = [];
  let least = Infinity;
  for (let flips = 0; flips < 8; flips++) {
    const signs = [flips & 1 ? -1 : 1, flips & 2 ? -1 : 1, flips & 4 ? -1 : 1];
    // Axis i of the second form goes to axis i of the first, in either direction.
    let turn = product(
      transposed(axesA).map((row) => row.map((value, i) => value * signs[i]!)),
      axesB,
    );
    let error = Infinity;
    for (let round = 0; round < ROUNDS; round++) {
      const turned = from.map((point) => apply(turn, point));
      const pairs = turned.map((point) => nearest(point, onto));
      const now = pairs.reduce((sum, [, away]) => sum + away, 0);
      if (now > error * 0.9999) break;
      error = now;
      turn = orthogonal(from, pairs.map(([point]) => point)) ?? turn;
    }
    const back = onto.map((point) => nearest(point, from.map((each) => apply(turn, each)))[1]);
    const both = error + back.reduce((sum, away) => sum + away, 0);
    if (both < least) [least, best] = [both, turn];
  }
  const turned = new Float32Array(b.length);
  for (let vertex = 0; vertex < b.length / 3; vertex++) turned.set(apply(best, at(b, vertex)), 3 * vertex);
  return [a, turned];
}

function unit(points: Float32Array): Float32Array {
  const middle = centred(points);
  let sum = 0;
  for (const value of middle) sum += value * value;
  const size = Math.sqrt(sum / (middle.length / 3)) || 1;
  return middle.map((value) => value / size);
}

function sample(points: Float32Array): Point[] {
  const count = points.length / 3;
  const step = Math.max(1, count / SAMPLES);
  const found: Point[] = [];
  for (let place = 0; place < count; place += step) found.push(at(points, Math.floor(place)));
  return found;
}

function nearest(point: Point, points: Point[]): [Point, number] {
  let [found, least] = [points[0]!, Infinity];
  for (const each of points) {
    const away = (each[0] - point[0]) ** 2 + (each[1] - point[1]) ** 2 + (each[2] - point[2]) ** 2;
    if (away < least) [found, least] = [each, away];
  }
  return [found, least];
}

/** Rows are the axes, the longest first. */
function principalAxes(points: Point[]): Matrix {
  const spread = [0, 1, 2].map((i) => [0, 1, 2].map((j) => points.reduce((sum, point) => sum + point[i]! * point[j]!, 0)));
  return eigenvectors(spread);
}

/** Return the orthogonal matrix that takes points to their partners best (Kabsch 1976), null if they are degenerate. */
function orthogonal(points: Point[], partners: Point[]): Matrix | null {
  const cross = [0, 1, 2].map((i) =>
    [0, 1, 2].map((j) => points.reduce((sum, point, k) => sum + partners[k]![i]! * point[j]!, 0)),
  );
  // The polar factor of `cross` is cross (cross' cross)^(-1/2), reflections included.
  const square = product(transposed(cross), cross);
  const axes = eigenvectors(square);
  const root = axes.map((axis) => {
    const image = [0, 1, 2].map((i) => square[i]!.reduce((sum, value, j) => sum + value * axis[j]!, 0));
    return Math.sqrt(Math.max(0, image.reduce((sum, value, i) => sum + value * axis[i]!, 0)));
  });
  if (root.some((value) => value < 1e-9 * root[0]!)) return null;
  const inverse = [0, 1, 2].map((i) =>
    [0, 1, 2].map((j) => axes.reduce((sum, axis, k) => sum + (axis[i]! * axis[j]!) / root[k]!, 0)),
  );
  return product(cross, inverse);
}

/** Eigenvectors of a symmetric matrix as rows, the largest eigenvalue first (Jacobi's method). */
function eigenvectors(matrix: Matrix): Matrix {
  const a = matrix.map((row) => [...row]);
  const v: Matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (let sweep = 0; sweep < 30; sweep++) {
    for (const [p, q] of [[0, 1], [0, 2], [1, 2]] as const) {
      if (Math.abs(a[p]![q]!) < 1e-14) continue;
      const angle = 0.5 * Math.atan2(2 * a[p]![q]!, a[p]![p]! - a[q]![q]!);
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      for (let k = 0; k < 3; k++) {
        [a[k]![p]!, a[k]![q]!] = [c * a[k]![p]! + s * a[k]![q]!, c * a[k]![q]! - s * a[k]![p]!];
      }
      for (let k = 0; k < 3; k++) {
        [a[p]![k]!, a[q]![k]!] = [c * a[p]![k]! + s * a[q]![k]!, c * a[q]![k]! - s * a[p]![k]!];
        [v[p]![k]!, v[q]![k]!] = [c * v[p]![k]! + s * v[q]![k]!, c * v[q]![k]! - s * v[p]![k]!];
      }
    }
  }
  const order = [0, 1, 2].sort((i, j) => a[j]![j]! - a[i]![i]!);
  return order.map((i) => v[i]!);
}

function product(a: Matrix, b: Matrix): Matrix {
  return a.map((row) => [0, 1, 2].map((j) => row.reduce((sum, value, k) => sum + value * b[k]![j]!, 0)));
}

function transposed(a: Matrix): Matrix {
  return [0, 1, 2].map((i) => a.map((row) => row[i]!));
}

function apply(turn: Matrix, point: Point): Point {
  return [0, 1, 2].map((i) => turn[i]!.reduce((sum, value, j) => sum + value * point[j]!, 0)) as Point;
}
