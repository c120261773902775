"""Kernels for binary rows of different lengths, each of which begins where the previous one ends."""

from __future__ import annotations

import numpy as np

from unbend.jit import kernel

SCALAR, UNSIGNED, SIGNED, SINGLE, DOUBLE = 0, 1, 2, 3, 4
"""Kinds of fields: a single value, or a list that begins with its length as a number of this type."""

ENDED, STRANGE = -1, -2
"""Returned instead of a position: the bytes end early, or a list has an impossible length."""

MOST = 2**31
"""Bound on the length of a list. Lists of this length or more are STRANGE."""


@kernel
def follow(body, position, widths, kinds, sizes, big, places, counts):
    """Find the values of each field of each row: write their position to `places` and their count to `counts`.

    Both arrays are (rows, fields).

    The rows are in `body` (bytes,), starting at `position`. A value of a field has `widths` (fields,) bytes. The length
    of a list has the type `kinds` (fields,) and `sizes` (fields,) bytes, and is big-endian if `big`. Return the
    position after the last row, or ENDED or STRANGE, and for STRANGE the impossible length.
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
    """Copy to `found` the values of each row: `counts` (rows,) values of `width` bytes, from `places` (rows,) on."""
    position = 0
    for row in range(len(places)):
        for byte in range(places[row], places[row] + counts[row] * width):
            found[position] = body[byte]
            position += 1
