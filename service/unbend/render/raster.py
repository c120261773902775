"""The rasteriser: triangles onto a grid of samples, the nearest at each, shaded and averaged over each pixel."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.jit import inlined, kernel

SAMPLES: Final = 3
"""Samples per pixel along each axis."""

_SQUARE: Final = SAMPLES * SAMPLES

BAND: Final = 8
"""Rows of pixels in a band. Each band has its own list of faces and is drawn by one thread."""

_NEAREST: Final = 1e-3  # faces with a corner nearer to the eye than this share of its distance are not drawn
_SLACK: Final = 1e-9  # allowed error of a corner's share, so that no sample falls between two faces

# Directions towards the lights in the camera's axes, and their strengths: the sum is near 1 on what faces the viewer.
_KEY: Final = (-0.44, 0.62, 0.65)
_FILL: Final = (0.85, 0.10, 0.52)
_RIM: Final = (0.30, 0.75, -0.59)
_KEY_STRENGTH: Final = 0.84
_FILL_STRENGTH: Final = 0.24
_RIM_STRENGTH: Final = 0.28
_SKY: Final = 0.40  # ambient light from above and from below
_GROUND: Final = 0.20
_SHINE: Final = 0.10
_MATT: Final = 0.3  # gloss of a surface with a field, so that its colours can be read
_INK: Final = 0.72  # how much of a contour's colour covers the surface


@kernel
def project(points, axes, centre, factor, closeness, width, height, seen):
    """Fill `seen` (n, 4): x and y in samples, the depth, which grows towards the eye, and its divisor.

    On the picture of a triangle, x, y, the depth and the inverse of the divisor are linear. The divisor is NaN at
    points behind the eye or too near to it.
    """
    for point in range(len(points)):
        x, y, z = points[point, 0] - centre[0], points[point, 1] - centre[1], points[point, 2] - centre[2]
        across = x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]
        above = x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]
        near = x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]
        divisor = 1.0 - near * closeness
        seen[point, 0] = width / 2 + across * factor / divisor
        seen[point, 1] = height / 2 - above * factor / divisor
        seen[point, 2] = near / divisor
        seen[point, 3] = divisor if divisor > _NEAREST else np.nan


@inlined
def _band_range(low, high, bands, rows):
    """Return the first band between two heights, and the one after the last; equal if there is none."""
    if not (high >= 0 and low < bands * rows):  # also for NaN
        return 0, 0
    return int(max(low, 0.0) // rows), min(int(min(high, bands * rows * 1.0) // rows), bands - 1) + 1


@kernel
def sort_into_bands(seen, faces, columns, bands):
    """Return the start of each band's faces, (bands + 1,), and the faces of all bands, in ascending order in each."""
    rows = BAND * SAMPLES
    starts = np.zeros(bands + 1, np.int64)
    for turn in range(2):
        if turn == 1:
            for band in range(bands):
                starts[band + 1] += starts[band]
            order, place = np.empty(starts[bands], np.int32), starts.copy()
        for face in range(len(faces)):
            a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
            if np.isnan(seen[a, 3] + seen[b, 3] + seen[c, 3]):
                continue
            if max(seen[a, 0], seen[b, 0], seen[c, 0]) < 0 or min(seen[a, 0], seen[b, 0], seen[c, 0]) > columns:
                continue
            low, high = min(seen[a, 1], seen[b, 1], seen[c, 1]), max(seen[a, 1], seen[b, 1], seen[c, 1])
            first, stop = _band_range(low, high, bands, rows)
            for band in range(first, stop):
                if turn == 0:
                    starts[band + 1] += 1
                else:
                    order[place[band]] = face
                    place[band] += 1
    return starts, order


@kernel
def _nearest_faces(seen, faces, listed, top, nearest, depth):
    """Fill the face that is nearest at each sample of a band, and its depth; -1 and -inf where there is none."""
    nearest[:] = -1
    depth[:] = -np.inf
    rows, columns = nearest.shape
    for face in listed:
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0 or np.isnan(area):
            continue
        left = int(max(np.ceil(min(ax, bx, cx) - 0.5), 0.0))
        right = int(min(np.floor(max(ax, bx, cx) - 0.5), columns - 1.0))
        upper = int(max(np.ceil(min(ay, by, cy) - 0.5 - top), 0.0))
        lower = int(min(np.floor(max(ay, by, cy) - 0.5 - top), rows - 1.0))
        inverse = 1.0 / area
        # Shares of corners b and c, and the depth, at a sample: each is a constant and two slopes.
        b_x, b_y = (cy - ay) * inverse, -(cx - ax) * inverse
        c_x, c_y = -(by - ay) * inverse, (bx - ax) * inverse
        rise_b, rise_c = seen[b, 2] - seen[a, 2], seen[c, 2] - seen[a, 2]
        for row in range(upper, lower + 1):
            y = row + 0.5 + top - ay
            for column in range(left, right + 1):
                x = column + 0.5 - ax
                share_b = b_x * x + b_y * y
                share_c = c_x * x + c_y * y
                if share_b >= -_SLACK and share_c >= -_SLACK and share_b + share_c <= 1 + _SLACK:
                    here = seen[a, 2] + share_b * rise_b + share_c * rise_c
                    if here > depth[row, column]:
                        depth[row, column] = here
                        nearest[row, column] = face


@inlined
def _light(nx, ny, nz):
    """Return the light on a surface with a unit normal in the camera's axes: of the key, of the fill, from around."""
    key = max(0.0, (nx * _KEY[0] + ny * _KEY[1] + nz * _KEY[2] + 0.22) / 1.22) * _KEY_STRENGTH
    fill = max(0.0, (nx * _FILL[0] + ny * _FILL[1] + nz * _FILL[2] + 0.40) / 1.40) * _FILL_STRENGTH
    ambient = _GROUND + (_SKY - _GROUND) * (0.5 + 0.5 * ny)
    return key, fill, ambient


@inlined
def _gloss(nx, ny, nz):
    """Return the light that a surface reflects without colouring it: a soft highlight, and a rim."""
    # The vector halfway between the key light and the eye, of length 1.
    hx, hy, hz = _KEY[0] / 1.8166, _KEY[1] / 1.8166, (_KEY[2] + 1.0) / 1.8166
    shine = max(0.0, nx * hx + ny * hy + nz * hz)
    shine *= shine
    shine *= shine
    shine *= shine
    shine *= shine  # to the 16th
    edge = 1.0 - max(0.0, nz)
    rim = edge * edge * edge * max(0.0, nx * _RIM[0] + ny * _RIM[1] + nz * _RIM[2] + 0.30)
    return _SHINE * shine + _RIM_STRENGTH * rim


@inlined
def _weights(x, y, ax, ay, bx, by, cx, cy, divisor_a, divisor_b, divisor_c):
    """Return the shares of a triangle's corners at a sample, corrected for perspective, and none below 0."""
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    share_b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
    share_c = ((y - ay) * (bx - ax) - (x - ax) * (by - ay)) / area
    a = max(0.0, 1.0 - share_b - share_c) / divisor_a
    b, c = max(0.0, share_b) / divisor_b, max(0.0, share_c) / divisor_c
    whole = a + b + c
    return a / whole, b / whole, c / whole


@inlined
def _on_contour(value, low, high, steps, slope, half):
    """Return whether a contour between `low` and `high` is less than `half` away from a value, along the surface."""
    step = (high - low) / steps
    number = np.floor((value - low) / step + 0.5)
    return slope > 0 and 1 <= number < steps and abs(value - low - number * step) < half * slope


@kernel
def draw_bands(
    first, stop, seen, faces, normals, axes, starts, order, item_of, colours, values, slopes, tables, bounds, steps,
    unknown, ink, half, picture, surface_depth,
):  # fmt: skip
    """Fill rows of `picture` (h, w, 4), linear light times coverage and the coverage, and of `surface_depth` (h, w).

    A face is shaded once in each pixel, in the middle of its samples there; contours are found at each sample.
    `item_of` gives each face its item. `bounds` (items, 2) and `steps` (items,) describe the field of each item. Steps
    are -1 without a field.
    """
    height, width = surface_depth.shape
    rows, columns = BAND * SAMPLES, width * SAMPLES
    nearest, depth = np.empty((rows, columns), np.int32), np.empty((rows, columns))
    here = np.empty(_SQUARE, np.int32)
    for band in range(first, stop):
        top = band * rows
        _nearest_faces(seen, faces, order[starts[band] : starts[band + 1]], top, nearest, depth)
        for pixel_row in range(band * BAND, min((band + 1) * BAND, height)):
            row = (pixel_row - band * BAND) * SAMPLES
            for pixel in range(width):
                column = pixel * SAMPLES
                for sample in range(_SQUARE):
                    here[sample] = nearest[row + sample // SAMPLES, column + sample % SAMPLES]
                for sample in range(_SQUARE):
                    face = here[sample]
                    if face < 0:
                        continue
                    count, x, y, deepest = 0, 0.0, 0.0, -np.inf
                    for other in range(sample, _SQUARE):
                        if here[other] == face:
                            here[other] = -2 - face  # marks the sample as done, and still tells its face
                            count += 1
                            x += column + other % SAMPLES + 0.5
                            y += row + other // SAMPLES + 0.5 + top
                            deepest = max(deepest, depth[row + other // SAMPLES, column + other % SAMPLES])
                    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
                    ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
                    weight_a, weight_b, weight_c = _weights(
                        x / count, y / count, ax, ay, bx, by, cx, cy, seen[a, 3], seen[b, 3], seen[c, 3]
                    )

                    wx = (
                        weight_a * normals[face, 0, 0] + weight_b * normals[face, 1, 0] + weight_c * normals[face, 2, 0]
                    )
                    wy = (
                        weight_a * normals[face, 0, 1] + weight_b * normals[face, 1, 1] + weight_c * normals[face, 2, 1]
                    )
                    wz = (
                        weight_a * normals[face, 0, 2] + weight_b * normals[face, 1, 2] + weight_c * normals[face, 2, 2]
                    )
                    size = np.sqrt(wx * wx + wy * wy + wz * wz)
                    # Towards the viewer; y points down in the picture.
                    side = 1.0 if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) < 0 else -1.0
                    turn = side / size if size > 0 else 0.0
                    nx = (wx * axes[0, 0] + wy * axes[0, 1] + wz * axes[0, 2]) * turn
                    ny = (wx * axes[1, 0] + wy * axes[1, 1] + wz * axes[1, 2]) * turn
                    nz = (wx * axes[2, 0] + wy * axes[2, 1] + wz * axes[2, 2]) * turn
                    if size == 0:
                        nz = 1.0

                    item = item_of[face]
                    if steps[item] < 0:
                        red = weight_a * colours[a, 0] + weight_b * colours[b, 0] + weight_c * colours[c, 0]
                        green = weight_a * colours[a, 1] + weight_b * colours[b, 1] + weight_c * colours[c, 1]
                        blue = weight_a * colours[a, 2] + weight_b * colours[b, 2] + weight_c * colours[c, 2]
                    else:
                        value = weight_a * values[a] + weight_b * values[b] + weight_c * values[c]
                        low, high = bounds[item, 0], bounds[item, 1]
                        if not np.isfinite(value):
                            red, green, blue = unknown[0], unknown[1], unknown[2]
                        else:
                            last = tables.shape[1] - 1
                            share = (value - low) / (high - low) if high > low else 0.5
                            place = min(max(share, 0.0), 1.0) * last
                            entry = int(place + 0.5)
                            red, green, blue = tables[item, entry, 0], tables[item, entry, 1], tables[item, entry, 2]
                            if steps[item] > 0:
                                inked = 0
                                for other in range(sample, _SQUARE):
                                    if here[other] == -2 - face:
                                        p, q, r = _weights(
                                            column + other % SAMPLES + 0.5, row + other // SAMPLES + 0.5 + top,
                                            ax, ay, bx, by, cx, cy, seen[a, 3], seen[b, 3], seen[c, 3],
                                        )  # fmt: skip
                                        value = p * values[a] + q * values[b] + r * values[c]
                                        inked += _on_contour(value, low, high, steps[item], slopes[face], half)
                                cover = _INK * inked / count
                                red += (ink[0] - red) * cover
                                green += (ink[1] - green) * cover
                                blue += (ink[2] - blue) * cover

                    key, fill, ambient = _light(nx, ny, nz)
                    gloss = _gloss(nx, ny, nz) * (1.0 if steps[item] < 0 else _MATT)
                    warm, cool = key * 1.04 + fill * 0.92 + ambient, key * 0.94 + fill * 1.10 + ambient
                    middle = key + fill + ambient
                    part = count / _SQUARE
                    picture[pixel_row, pixel, 0] += min(1.0, red * warm + gloss) * part
                    picture[pixel_row, pixel, 1] += min(1.0, green * middle + gloss) * part
                    picture[pixel_row, pixel, 2] += min(1.0, blue * cool + gloss) * part
                    picture[pixel_row, pixel, 3] += part
                    surface_depth[pixel_row, pixel] = max(surface_depth[pixel_row, pixel], deepest)
