/** Thumbnails: a few requests at a time, and the pictures of this session in memory. */

import { send } from "./client";

const AT_ONCE = 3;
const MOST_KEPT = 1500;

const kept = new Map<string, Promise<string>>();
const waiting: { start: () => void; wanted: () => boolean; drop: () => void }[] = [];
let running = 0;

export interface Drawing {
  subject?: "surface" | "signature" | "both";
  width?: number;
  height?: number;
}

/** Return an object URL of a shape's picture; null if nobody wants it any more when its turn comes. */
export function picture(shapeId: string, drawing: Drawing, wanted: () => boolean): Promise<string | null> {
  const address = `${shapeId} ${JSON.stringify(drawing)}`;
  const known = kept.get(address);
  if (known) return known;
  const { promise, resolve, reject } = Promise.withResolvers<string | null>();
  const start = (): void => {
    const loading = load(shapeId, drawing);
    kept.set(address, loading);
    loading.catch(() => kept.delete(address));
    loading.then(resolve, reject).finally(() => {
      running--;
      next();
    });
    evict();
  };
  waiting.push({ start, wanted, drop: () => resolve(null) });
  next();
  return promise;
}

function next(): void {
  while (running < AT_ONCE && waiting.length) {
    const { start, wanted, drop } = waiting.shift()!;
    if (!wanted()) {
      drop();
      continue;
    }
    running++;
    start();
  }
}

async function load(shapeId: string, drawing: Drawing): Promise<string> {
  const response = await send(`shapes/${shapeId}/thumbnail`, {}, { ...drawing });
  return URL.createObjectURL(await response.blob());
}

function evict(): void {
  for (const [address, loading] of kept) {
    if (kept.size <= MOST_KEPT) return;
    kept.delete(address);
    void loading.then((link) => URL.revokeObjectURL(link));
  }
}
