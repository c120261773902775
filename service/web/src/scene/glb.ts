/** Reading the glb files of this service: one mesh of one primitive. */

export interface Mesh {
  positions: Float32Array;
  faces: Uint32Array;
  /** Place of each vertex in the signature, in the unit of the surface. */
  form: Float32Array | null;
  /** Dimensions 4 to 6 of each vertex. */
  more: Float32Array | null;
  /** Number of each vertex in the file. */
  numbers: Float32Array | null;
  uv: Float32Array | null;
  about: { up?: string; centre?: [number, number, number]; dimensions?: number; faces?: number; full_faces?: number };
}

interface Layout {
  asset: { extras?: Mesh["about"] };
  meshes: { primitives: { attributes: Record<string, number>; indices: number }[] }[];
  accessors: { bufferView: number; count: number; type: string; byteOffset?: number }[];
  bufferViews: { byteOffset?: number; byteLength: number }[];
}

const WIDTH: Record<string, number> = { SCALAR: 1, VEC2: 2, VEC3: 3 };

export function readGlb(data: ArrayBuffer): Mesh {
  const header = new DataView(data);
  const length = header.getUint32(12, true);
  const layout = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 20, length))) as Layout;
  const start = 20 + length + 8;
  const { attributes, indices } = layout.meshes[0]!.primitives[0]!;
  const place = (accessor: number): [number, number] => {
    const { bufferView, count, type, byteOffset } = layout.accessors[accessor]!;
    return [start + (layout.bufferViews[bufferView]!.byteOffset ?? 0) + (byteOffset ?? 0), count * WIDTH[type]!];
  };
  const floats = (name: string): Float32Array | null => {
    const accessor = attributes[name];
    return accessor === undefined ? null : new Float32Array(data, ...place(accessor));
  };
  return {
    positions: floats("POSITION")!,
    faces: new Uint32Array(data, ...place(indices)),
    form: floats("_FORM"),
    more: floats("_MORE"),
    numbers: floats("_VERTEX"),
    uv: floats("TEXCOORD_0"),
    about: layout.asset.extras ?? {},
  };
}
