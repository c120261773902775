"""Kernels for binary rows of changing length: where each begins is known only when the one before was read."""

from __future__ import annotations

import numpy as np

from unbend.jit import kernel

SCALAR, UNSIGNED, SIGNED, SINGLE, DOUBLE = 0, 1, 2, 3, 4
"""The kind of a field: one value, or a list with such a number before it."""

ENDED, STRANGE = -1, -2
"""For the position behind the last row: the bytes ended early, or a list has no length that could be."""

MOST = 2**31
"""No list is as long as that."""


@kernel
def follow(body, position, widths, kinds, sizes, big, places, counts):
    """Fill in where each row's fields have their values, `places` (rows, fields), and how many, `counts`.

    `body` are bytes, `position` the first row's; `widths` (fields,) are bytes of a value, `kinds` and `sizes` the kinds
    and bytes of the numbers before lists, `big` whether these are big-endian. Returns the position behind the last
    row or what went wrong, and for STRANGE the number that stands before the list.
    """
    cell = np.zeros(8, np.uint8)
    whole, single, double = cell.view(np.int64), cell.view(np.float32), cell.view(np.float64)
    for row in range(len(places)):
        for field in range(len(widths)):
            count = 1
            if kinds[field] != SCALAR:
                size = sizes[field]
                if position + size > len(body):
                    return ENDED, 0.0
                cell[:] = 0
                for byte in range(size):
                    cell[byte] = body[position + (size - 1 - byte if big else byte)]
                number = float(whole[0])
                if kinds[field] == SINGLE:
                    number = float(single[0])
                elif kinds[field] == DOUBLE:
                    number = double[0]
                elif kinds[field] == SIGNED and cell[size - 1] >= 128:
                    number -= 256.0**size
                if not (0 <= number < MOST and number == np.floor(number)):
                    return STRANGE, number
                count = int(number)
                position += size
            places[row, field] = position
            counts[row, field] = count
            position += count * widths[field]
        if position > len(body):
            return ENDED, 0.0
    return position, 0.0


@kernel
def gather(body, places, counts, width, found):
    """Copy to `found` the values of `width` bytes that lie at `places`, as many as `counts` says at each."""
    position = 0
    for row in range(len(places)):
        for byte in range(places[row], places[row] + counts[row] * width):
            found[position] = body[byte]
            position += 1
