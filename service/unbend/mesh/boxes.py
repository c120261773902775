"""A tree of bounding boxes, for exact nearest-item searches in compiled code.

scipy's k-d tree finds the nearest point, but not the nearest point of another component, nor the nearest triangle. Both
need a search with the caller's own pruning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.jit import kernel

LEAF: Final = 8
"""Number of items in a leaf."""

_BITS = 21  # bits of a Morton code per axis: 63 for three axes


@dataclass(frozen=True, eq=False)
class BoxTree:
    """A complete binary tree over items in Morton order. Node 1 is the root; 2 i and 2 i + 1 are the children of i.

    Leaf `leaves + j` contains the items `order[LEAF * j : LEAF * (j + 1)]`. Leaves after the last item are empty and at
    infinite distance from every point.
    """

    order: Indices  # (n,)
    lower: Floats  # (2 leaves, 3)
    upper: Floats  # (2 leaves, 3)

    @property
    def leaves(self) -> int:
        """Number of leaves, a power of two."""
        return len(self.lower) // 2


def build_boxes(lower: Floats, upper: Floats) -> BoxTree:
    """Build the tree of items whose boxes extend from `lower` to `upper`, both (n, 3), in O(n log n)."""
    order = morton_order(0.5 * (lower + upper))
    filled = -(-len(order) // LEAF)
    leaves = 1 << (filled - 1).bit_length()
    low, high = np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf)
    starts = np.arange(0, len(order), LEAF)
    low[leaves : leaves + filled] = np.minimum.reduceat(lower[order], starts)
    high[leaves : leaves + filled] = np.maximum.reduceat(upper[order], starts)
    level = leaves // 2
    while level:
        low[level : 2 * level] = np.minimum(low[2 * level : 4 * level : 2], low[2 * level + 1 : 4 * level : 2])
        high[level : 2 * level] = np.maximum(high[2 * level : 4 * level : 2], high[2 * level + 1 : 4 * level : 2])
        level //= 2
    return BoxTree(order, low, high)


def uniform_labels(tree: BoxTree, labels: Ints) -> Ints:
    """Return for each node the common label of its items, -1 if the labels differ, (2 leaves,).

    `labels` (n,) are in the order of the tree.
    """
    leaves = tree.leaves
    padded = np.full(leaves * LEAF, labels[-1], labels.dtype)
    padded[: len(labels)] = labels
    blocks = padded.reshape(leaves, LEAF)
    uniform = np.empty(2 * leaves, labels.dtype)
    uniform[leaves:] = np.where((blocks == blocks[:, :1]).all(axis=1), blocks[:, 0], -1)
    level = leaves // 2
    while level:
        left, right = uniform[2 * level : 4 * level : 2], uniform[2 * level + 1 : 4 * level : 2]
        uniform[level : 2 * level] = np.where(left == right, left, -1)
        level //= 2
    return uniform


@kernel
def box_distance(lower: Floats, upper: Floats, node: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point from a node's box, infinite for an empty box."""
    dx = max(lower[node, 0] - x, 0.0, x - upper[node, 0])
    dy = max(lower[node, 1] - y, 0.0, y - upper[node, 1])
    dz = max(lower[node, 2] - z, 0.0, z - upper[node, 2])
    return float(dx * dx + dy * dy + dz * dz)


@kernel
def push_children(
    stack: Indices, top: int, node: int, lower: Floats, upper: Floats, x: float, y: float, z: float
) -> int:
    """Push a node's children onto the stack, the nearer child last, so that it is visited first."""
    left = box_distance(lower, upper, 2 * node, x, y, z)
    right = box_distance(lower, upper, 2 * node + 1, x, y, z)
    stack[top + 1] = 2 * node if left > right else 2 * node + 1
    stack[top + 2] = 2 * node + 1 if left > right else 2 * node
    return top + 2


def morton_order(points: Floats) -> Indices:
    """Return the Morton order of `points` (n, 3), in which neighbours in space are mostly neighbours in the order."""
    low = points.min(axis=0)
    span = (points.max(axis=0) - low).max()
    cells = ((points - low) * ((2**_BITS - 1) / span if span > 0 else 0.0)).astype(np.int64)
    return np.argsort(_spread(cells[:, 0]) << 2 | _spread(cells[:, 1]) << 1 | _spread(cells[:, 2]), kind="stable")


def _spread(cells: Indices) -> Indices:
    """Insert two zero bits before each of 21 bits."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        cells = (cells | cells << shift) & mask
    return cells
