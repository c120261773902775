"""An indexed 4-ary min-heap for fast marching: keys lie beside the vertices, so sifting stays in one array."""

from __future__ import annotations

import numpy as np

from unbend.jit import kernel

# A heap is three arrays: keys (n,) float64, items (n,) int32, and position (n,) int32 of each item, -1 outside.
ARITY = 4


@kernel
def push_or_decrease(keys, items, position, size, item, key):
    """Insert `item` or lower its key; return the new size."""
    slot = position[item]
    if slot < 0:
        slot = size
        size += 1
    while slot > 0:
        parent = (slot - 1) // ARITY
        if keys[parent] <= key:
            break
        keys[slot] = keys[parent]
        items[slot] = items[parent]
        position[items[slot]] = slot
        slot = parent
    keys[slot] = key
    items[slot] = item
    position[item] = slot
    return size


@kernel
def pop(keys, items, position, size):
    """Remove the item with the smallest key; return it and the new size."""
    top = items[0]
    position[top] = -1
    size -= 1
    key, item = keys[size], items[size]
    slot = 0
    while True:
        child = ARITY * slot + 1
        if child >= size:
            break
        best = child
        for other in range(child + 1, min(child + ARITY, size)):
            if keys[other] < keys[best]:
                best = other
        if keys[best] >= key:
            break
        keys[slot] = keys[best]
        items[slot] = items[best]
        position[items[slot]] = slot
        slot = best
    if size > 0:
        keys[slot] = key
        items[slot] = item
        position[item] = slot
    return top, size


def heap_arrays(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return empty heap arrays for items 0 to `count` - 1."""
    return np.empty(count), np.empty(count, np.int32), np.full(count, -1, np.int32)
