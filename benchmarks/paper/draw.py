"""Draws shaded, coloured surfaces pixel by pixel, and lines on them where the surface does not hide the lines."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import matplotlib as mpl
import numpy as np
from numba import njit
from PIL import Image

from benchmarks.common import ROOT

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.collections import LineCollection

from unbend import Surface

PICTURES = ROOT / "docs" / "pictures"

Array = np.ndarray
Colours = Array | Callable[[Array], Array]
"""One colour (3,), one for each vertex (n, 3), or a function from values at pixels (p, k) to colours (p, 3)."""

LIGHT = np.array([-0.35, 0.5, 0.8]) / np.linalg.norm([-0.35, 0.5, 0.8])
HALFWAY = (LIGHT + np.eye(3)[2]) / np.linalg.norm(LIGHT + np.eye(3)[2])  # between the light and the eye
AMBIENT = 0.38
FINER = 2  # buffer pixels per picture pixel along each side
MARGIN = 0.03
STEP = 0.004  # longest piece of a line, as a share of the picture's side
NEAR = 0.012  # a line this far behind the surface is still drawn, as a share of the picture's side

STONE = np.array([0.80, 0.78, 0.74])


@dataclass(frozen=True)
class Shot:
    """A view of a surface: its frame, and the depth at every pixel."""

    turn: Array  # (3, 3): the rows are right, up and towards the eye
    low: Array  # (2,), the lower left corner
    unit: float  # the width of a pixel
    depth: Array  # (height, width), -inf where the surface is absent

    @property
    def side(self) -> float:
        """Longer side of the picture."""
        return self.unit * max(self.depth.shape)


def turn_of(azimuth: float, elevation: float) -> Array:
    """Return the axes of an eye that looks at the origin from this direction, in degrees; z is up."""
    a, e = np.radians([azimuth, elevation])
    eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return np.stack([right, np.cross(eye, right), eye])


def paint(
    axes: Any, surface: Surface, turn: Array, colours: Colours = STONE, *, values: Array | None = None, size: int = 500
) -> Shot:
    """Draw a surface into `axes`, `size` pixels on its longer side."""
    seen = surface.vertices @ turn.T
    used = seen[surface.used_vertices]
    low, high = used.min(axis=0), used.max(axis=0)
    pad = MARGIN * (high - low)[:2].max()
    corner, extent = low[:2] - pad, (high - low)[:2] + 2 * pad
    unit = extent.max() / (size * FINER)
    height, width = (FINER * np.ceil(extent[::-1] / (unit * FINER))).astype(int)
    data = np.zeros((len(seen), 0)) if values is None else values.reshape(len(seen), -1)
    if not callable(colours) and np.ndim(colours) == 2:
        data = np.asarray(colours, float)
    depth, pixels = np.full((height, width), -np.inf), np.zeros((height, width, 3 + data.shape[1]))
    attributes = np.hstack([_normals(seen, surface.faces), data])
    _rasterise(seen, surface.faces, attributes, corner, unit, depth, pixels)
    image = _shade(depth, pixels, colours)
    box = (corner[0], corner[0] + width * unit, corner[1], corner[1] + height * unit)
    axes.imshow(image, origin="lower", extent=box, interpolation="antialiased", zorder=1)
    axes.set_adjustable("datalim")
    axes.set_axis_off()
    return Shot(turn, corner, unit, depth)


def trace(axes: Any, shot: Shot, lines: Iterable[Array], **style: Any) -> None:
    """Draw polylines (p, 3) where the surface does not hide them."""
    pieces = [piece for line in lines for piece in _visible(shot, line)]
    axes.add_collection(LineCollection(pieces, capstyle="round", joinstyle="round", zorder=2, **style))


def dots(axes: Any, shot: Shot, points: Array, **style: Any) -> None:
    """Draw points (p, 3) over everything."""
    axes.scatter(*(points @ shot.turn.T)[:, :2].T, zorder=4, **style)


def segment(axes: Any, shot: Shot, ends: Array, **style: Any) -> None:
    """Draw a straight line (2, 3) over everything."""
    axes.plot(*(ends @ shot.turn.T)[:, :2].T, zorder=3, solid_capstyle="round", **style)


def panels(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Array]:
    page, grid = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    return page, grid


def head_columns(grid: Array, titles: Iterable[str]) -> None:
    for axes, title in zip(grid[0], titles, strict=True):
        axes.set_title(title, fontsize=13)


def head_rows(grid: Array, titles: Iterable[str]) -> None:
    for axes, title in zip(grid[:, 0], titles, strict=True):
        axes.text(-0.02, 0.5, title, transform=axes.transAxes, rotation=90, va="center", ha="right", fontsize=13)


def save(page: Any, name: str, dpi: int = 80) -> None:
    """Write a picture with 86 shades per channel: the loss is invisible, and the file is smaller."""
    PICTURES.mkdir(exist_ok=True)
    buffer = BytesIO()
    page.savefig(buffer, dpi=dpi)
    plt.close(page)
    pixels = np.asarray(Image.open(buffer).convert("RGB"), np.uint16)
    Image.fromarray(((pixels + 1) // 3 * 3).astype(np.uint8)).save(PICTURES / f"{name}.png", optimize=True)


def scale_of(values: Array, name: str = "viridis") -> Callable[[Array], Array]:
    """Return a function from values at pixels to colours; the scale spans the range of `values`."""
    low, high, scale = values.min(), values.max(), plt.get_cmap(name)
    return lambda pixels: scale((pixels[:, 0] - low) / (high - low))[:, :3]


def procrustes(points: Array, onto: Array) -> Array:
    """Return the rotation or reflection R (3, 3) for which the centred `points @ R` are nearest to `onto`."""
    left, _, right = np.linalg.svd((points - points.mean(axis=0)).T @ (onto - onto.mean(axis=0)))
    return left @ right


def _normals(points: Array, faces: Array) -> Array:
    a, b, c = points[faces].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], across)
    return normals / (np.linalg.norm(normals, axis=1, keepdims=True) + 1e-300)


def _shade(depth: Array, pixels: Array, colours: Colours) -> Array:
    there = np.isfinite(depth)
    of = pixels[there]
    normals = of[:, :3] * np.sign(of[:, 2:3] + 1e-12)  # both sides of a surface are lit
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-300
    light = AMBIENT + (1 - AMBIENT) * np.clip(normals @ LIGHT, 0, 1)
    base = colours(of[:, 3:]) if callable(colours) else of[:, 3:] if np.ndim(colours) == 2 else colours
    shine = 0.12 * np.clip(normals @ HALFWAY, 0, 1) ** 30
    image = np.ones((*depth.shape, 4))
    image[..., 3] = there
    image[there, :3] = np.clip(base * light[:, None] + shine[:, None], 0, 1)
    return _averaged(image)


def _averaged(image: Array) -> Array:
    height, width = image.shape[0] // FINER, image.shape[1] // FINER
    blocks = image.reshape(height, FINER, width, FINER, 4)
    alpha = blocks[..., 3:].sum(axis=(1, 3))
    colour = (blocks[..., :3] * blocks[..., 3:]).sum(axis=(1, 3)) / np.maximum(alpha, 1)
    return np.concatenate([np.where(alpha > 0, colour, 1.0), alpha / FINER**2], axis=2)


def _visible(shot: Shot, line: Array) -> list[Array]:
    """Return the parts of a line (q, 2) that the surface does not hide."""
    seen = line @ shot.turn.T
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(seen, axis=0), axis=1)))
    at = np.linspace(0, along[-1], 2 + int(along[-1] / (STEP * shot.side)))
    fine = np.stack([np.interp(at, along, axis) for axis in seen.T], axis=1)
    column, row = ((fine[:, :2] - shot.low) / shot.unit).astype(int).T
    row, column = np.clip(row, 0, shot.depth.shape[0] - 1), np.clip(column, 0, shot.depth.shape[1] - 1)
    shown = fine[:, 2] >= shot.depth[row, column] - NEAR * shot.side
    breaks = np.flatnonzero(np.diff(shown)) + 1
    return [part[:, :2] for part, keep in zip(np.split(fine, breaks), np.split(shown, breaks), strict=True) if keep[0]]


@njit(cache=True)
def _rasterise(points, faces, attributes, corner, unit, depth, pixels):
    height, width = depth.shape
    for face in range(len(faces)):
        a, b, c = faces[face]
        ax, ay = (points[a, 0] - corner[0]) / unit, (points[a, 1] - corner[1]) / unit
        bx, by = (points[b, 0] - corner[0]) / unit, (points[b, 1] - corner[1]) / unit
        cx, cy = (points[c, 0] - corner[0]) / unit, (points[c, 1] - corner[1]) / unit
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:
            continue
        left, right = max(int(min(ax, bx, cx)), 0), min(int(max(ax, bx, cx)) + 1, width - 1)
        bottom, top = max(int(min(ay, by, cy)), 0), min(int(max(ay, by, cy)) + 1, height - 1)
        for row in range(bottom, top + 1):
            for column in range(left, right + 1):
                x, y = column + 0.5, row + 0.5
                v = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                w = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                u = 1 - v - w
                if u < -1e-9 or v < -1e-9 or w < -1e-9:
                    continue
                z = u * points[a, 2] + v * points[b, 2] + w * points[c, 2]
                if z > depth[row, column]:
                    depth[row, column] = z
                    for k in range(attributes.shape[1]):
                        pixels[row, column, k] = u * attributes[a, k] + v * attributes[b, k] + w * attributes[c, k]
