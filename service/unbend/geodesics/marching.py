"""The fast marching kernel: one front from one source, roughly in order of distance.

A vertex's distance is the least that its slots give (see `stencils`), so the distances are a fixed point of the update
equations. The order of visits mainly decides how often a vertex is visited again. A queue of buckets, each a fifth of
a median edge wide, needs about 1.2 visits per vertex. A heap keeps the exact order, but takes more time than it saves.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.geodesics.stencils import AX, BLOCK_BYTES, BX, BY, LINE_BYTES, PX, PY, SLOTS, A, B, P
from unbend.geodesics.updates import planar_slot, spherical_slot
from unbend.jit import kernel, prefetch
from unbend.tolerances import MARCHING_DECREASE

UNREACHED: Final = np.float32(np.inf)
KEPT: Final = np.float32(1.0 - MARCHING_DECREASE)  # a value that falls by a smaller share is not propagated

BUCKETS: Final = 1024  # a power of two, enough for edges of up to 200 median edges
PER_EDGE: Final = np.float32(5.0)  # buckets per median edge

_WAITING, _SEEDED, _SETTLED = 1, 2, 3  # values of `queued`: waiting in a bucket, a seed, or final


def front_arrays(count: int) -> tuple[np.ndarray, ...]:
    """Return the work arrays of `march` for `count` vertices: values, queued, next, heads, tails, slots, chosen."""
    values = np.full(count + 1, UNREACHED, np.float32)  # the last entry is for the vertex of empty slots
    queued = np.zeros(count + 1, np.uint8)
    queued[count] = _WAITING  # so that the vertex of empty slots is never queued
    heads, tails = np.full(BUCKETS, -1, np.int32), np.full(BUCKETS, -1, np.int32)
    slots, chosen = np.empty((4, SLOTS), np.float32), np.empty(2 * SLOTS + 1, np.int32)
    return values, queued, np.empty(count + 1, np.int32), heads, tails, slots, chosen


@kernel
def march(stencils, seeds, exact, limit, disc, width, reached, front):
    """March from `seeds`; list the vertices reached in `reached` and return their number.

    The values of the seeds must be set, and all other values must be `UNREACHED`. Seeds with values below `exact` keep
    them. Other seeds may get lower values.

    The front stops at vertices whose value is not below `limit`. If `limit` has the distances to earlier sources, the
    front visits only the new source's Voronoi cell and the vertices at its border. Updates are spherical within the
    radius `disc`, in median edges, and planar beyond it. `width` is SLOTS. It is passed as a variable, because the
    compiler would unroll a loop of constant length instead of vectorising it.

    This is one function with separate loops that gather, compute and choose. Unpredictable branches, and calls that
    pass arrays, would take more time than the arithmetic (benchmarks/geodesics/distances.py).
    """
    first, corners, shapes = stencils
    values, queued, following, heads, tails, slots, chosen = front
    mask = len(heads) - 1
    last_round = np.int64(min(disc * PER_EDGE, 2.0**62))
    pending = len(seeds)
    count = len(seeds)
    for index in range(len(seeds)):
        v = seeds[index]
        reached[index] = v
        queued[v] = _SEEDED
        append(heads, tails, following, min(np.int64(values[v] * PER_EDGE), mask), v)
    now = 0
    while pending > 0:
        v = heads[now & mask]
        if v < 0:
            now += 1
            continue
        heads[now & mask] = following[v]
        pending -= 1

        old = values[v]
        settled = queued[v] == _SEEDED and old < exact
        new = old if settled else UNREACHED
        for block in range(first[v], first[v] if settled else first[v + 1]):
            for slot in range(SLOTS):
                slots[A, slot] = values[corners[block, A, slot]]
                slots[B, slot] = values[corners[block, B, slot]]
                slots[P, slot] = values[corners[block, P, slot]]
            if now <= last_round:
                for slot in range(width):
                    slots[3, slot] = spherical_slot(
                        slots[A, slot], slots[B, slot], slots[P, slot], shapes[block, AX, slot],
                        shapes[block, BX, slot], shapes[block, BY, slot], shapes[block, PX, slot],
                        shapes[block, PY, slot],
                    )  # fmt: skip
            else:
                for slot in range(width):
                    slots[3, slot] = planar_slot(
                        slots[A, slot], slots[B, slot], slots[P, slot], shapes[block, AX, slot],
                        shapes[block, BX, slot], shapes[block, BY, slot], shapes[block, PX, slot],
                        shapes[block, PY, slot],
                    )  # fmt: skip
            for slot in range(SLOTS):
                new = min(new, slots[3, slot])

        if queued[v] == _SEEDED:  # a seed's value never rises, and is always propagated
            new = min(new, old)
        elif not new < old * KEPT:
            queued[v] = 0
            continue
        queued[v] = _SETTLED if settled else 0
        if old == UNREACHED:
            reached[count] = v
            count += 1
        values[v] = new
        if new >= limit[v]:
            continue

        for block in range(first[v], first[v + 1]):
            if settled or first[v + 1] - first[v] > 1:  # otherwise `slots` still has these values
                for slot in range(SLOTS):
                    slots[A, slot] = values[corners[block, A, slot]]
                    slots[P, slot] = values[corners[block, P, slot]]
            size = 0
            for slot in range(SLOTS):
                chosen[size] = slot
                size += (slots[A, slot] > new) & (queued[corners[block, A, slot]] == 0)
            near = size
            late = False  # rare: another vertex was visited before v, although v is the P of one of its slots
            for slot in range(width):
                late |= (slots[P, slot] > new) & (slots[P, slot] < UNREACHED)
            if late:
                for slot in range(SLOTS):
                    chosen[size] = slot
                    size += (slots[P, slot] > new) & (slots[P, slot] < UNREACHED)
            for index in range(size):
                slot = chosen[index]
                w = corners[block, A if index < near else P, slot]
                if queued[w] == 0:
                    queued[w] = _WAITING
                    pending += 1
                    key = new + shapes[block, AX, slot] if index < near else values[w]
                    bucket = min(max(int(key * PER_EDGE), now), now + mask) & mask
                    following[w] = -1
                    if heads[bucket] < 0:
                        heads[bucket] = w
                    else:
                        following[tails[bucket]] = w
                    tails[bucket] = w
                    start = np.int64(first[w]) * BLOCK_BYTES
                    prefetch(corners, start)
                    prefetch(corners, start + LINE_BYTES)
                    prefetch(corners, start + 2 * LINE_BYTES)
                    prefetch(corners, start + 3 * LINE_BYTES)
    for index in range(len(seeds)):
        queued[reached[index]] = 0
    return count


@kernel
def append(heads, tails, following, bucket, vertex):
    """Append `vertex` to a bucket, which is a linked list."""
    following[vertex] = -1
    if heads[bucket] < 0:
        heads[bucket] = vertex
    else:
        following[tails[bucket]] = vertex
    tails[bucket] = vertex
