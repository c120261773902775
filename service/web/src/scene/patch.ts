/** Geodesic discs cut out of a surface. */

/** Return the part of a mesh where `values` are at most `limit` as an off file; triangles are cut at the limit. */
export function cutOff(positions: Float32Array, faces: Uint32Array, values: Float32Array, limit: number): string {
  const vertices: string[] = [];
  const triangles: string[] = [];
  const numbers = new Map<string, number>();
  const add = (name: string, x: number, y: number, z: number): number => {
    const known = numbers.get(name);
    if (known !== undefined) return known;
    numbers.set(name, vertices.length);
    return vertices.push(`${x} ${y} ${z}`) - 1;
  };
  const corner = (i: number): number => add(String(i), positions[3 * i]!, positions[3 * i + 1]!, positions[3 * i + 2]!);
  const between = (i: number, j: number): number => {
    const [a, b] = i < j ? [i, j] : [j, i]; // the same for both triangles at an edge
    const share = (limit - values[a]!) / (values[b]! - values[a]!);
    const [x, y, z] = [0, 1, 2].map((axis) => positions[3 * a + axis]! + share * (positions[3 * b + axis]! - positions[3 * a + axis]!));
    return add(`${a} ${b}`, x!, y!, z!);
  };
  for (let face = 0; face < faces.length; face += 3) {
    const outline: number[] = [];
    for (let side = 0; side < 3; side++) {
      const [i, j] = [faces[face + side]!, faces[face + ((side + 1) % 3)]!];
      const [here, there] = [values[i]! <= limit, values[j]! <= limit];
      if (here) outline.push(corner(i));
      // A vertex exactly at the limit is a corner already.
      if (here !== there && values[here ? i : j]! < limit) outline.push(between(i, j));
    }
    for (let k = 2; k < outline.length; k++) triangles.push(`3 ${outline[0]} ${outline[k - 1]} ${outline[k]}`);
  }
  return ["OFF", `${vertices.length} ${triangles.length} 0`, ...vertices, ...triangles, ""].join("\n");
}
