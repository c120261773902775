"""From linear light to the bytes of pixels."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from unbend.jit import inlined, kernel
from unbend.render.colours import to_srgb

_ENTRIES: Final = 2**14  # so many that a step at black, where sRGB is steepest, is about a fifth of the unit of a byte


def srgb_bytes() -> NDArray[np.uint8]:
    """Return the bytes of sRGB for linear light from 0 to 1 in equal steps, (16385,)."""
    light = np.linspace(0, 1, _ENTRIES + 1)
    return np.asarray(np.floor(to_srgb(light) * 255 + 0.5), np.uint8)


@inlined
def _place(light):
    return int(min(max(light, 0.0), 1.0) * _ENTRIES + 0.5)


@kernel
def compose(first, stop, picture, light, background, transparent, codes, pixels):
    """Fill rows of `pixels` (h, w, 4) uint8: `picture` (h, w, 4) times `light` (h, w), over a background."""
    for row in range(first, stop):
        for column in range(picture.shape[1]):
            cover = min(picture[row, column, 3], np.float32(1.0))
            for part in range(3):
                lit = picture[row, column, part] * light[row, column]
                if transparent:
                    lit = lit / cover if cover > 0 else 0.0
                else:
                    lit += (1.0 - cover) * background[part]
                pixels[row, column, part] = codes[_place(lit)]
            pixels[row, column, 3] = np.uint8(cover * 255 + 0.5) if transparent else np.uint8(255)
