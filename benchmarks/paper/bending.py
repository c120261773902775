"""Figs. 1, 2 and 4: flattened surfaces, two postures of a hand, and the three methods side by side."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from benchmarks.common import table
from benchmarks.paper.draw import (
    Array,
    dots,
    head_columns,
    head_rows,
    paint,
    panels,
    plt,
    procrustes,
    save,
    scale_of,
    segment,
    trace,
    turn_of,
)
from benchmarks.paper.meshes import STAND_INS, camel_face, curtain, hands, single
from unbend import (
    Parameters,
    Surface,
    farthest_point_sampling,
    geodesic_distances,
    geodesic_matrix,
    geodesic_path,
    iso_contours,
)
from unbend.signature.canonical_form import canonical_form
from unbend.signature.flattening import Flattening, flatten

SQUARES = 12  # of the texture, along its longer side
PALE = np.array([0.97, 0.95, 0.90])

SAMPLES = 500
TIPS = 6  # of a hand: five fingers and the end of the arm
CONTOURS = 18
METHODS = {"fast": "Fast", "least_squares": "LS", "classical": "Classical"}


def figure_1() -> str:
    shown = {"sheet": (curtain(), turn_of(-65, 28)), "face": (camel_face(), turn_of(14, 14))}
    page, grid = panels(len(shown), 4, (15, 7))
    rows = []
    for axes, (name, (surface, turn)) in zip(grid, shown.items(), strict=True):
        flat = flatten(surface, Parameters(samples=SAMPLES))
        _texture(axes, surface, flat, turn)
        stretch = f"{100 * (flat.mean_distortion - 1):.1f} %"
        stress = f"{flat.stress:.4f}" if flat.stress > 1e-4 else "below 0.0001"
        rows.append([name, len(surface.vertices), stress, stretch, f"{100 * flat.flipped:.1f} %"])
    head_columns(grid, ("surface", "flattened, m = 2", "texture in the plane", "texture on the surface"))
    save(page, "paper-fig1")
    return table(["surface", "vertices", "stress at m = 2", "mean change of lengths", "flipped area"], rows)


def _texture(axes: Array, surface: Surface, flat: Flattening, turn: Array) -> None:
    places = _upright(flat.uv, surface.vertices @ turn.T)
    plane = Surface(np.c_[places, np.zeros(len(places))], surface.faces)
    paint(axes[0], surface, turn)
    paint(axes[1], plane, np.eye(3))
    paint(axes[2], plane, np.eye(3), _checkered, values=places)
    paint(axes[3], surface, turn, _checkered, values=places)


def _upright(places: Array, seen: Array) -> Array:
    """Rotate the plane by the multiple of 90 degrees that best matches the drawn surface."""
    onto = (seen - seen.mean(axis=0))[:, :2]
    centred = places - places.mean(axis=0)
    quarter = np.array([[0.0, 1.0], [-1.0, 0.0]])
    turned = [centred @ np.linalg.matrix_power(quarter, times) for times in range(4)]
    best = max(turned, key=lambda candidate: float((candidate * onto).sum()))
    return best - best.min(axis=0)


def _checkered(places: Array) -> Array:
    cell = np.floor(places * SQUARES + 1e-9)
    longer = np.ptp(cell, axis=0).argmax()
    hue = plt.get_cmap("viridis")(0.1 + 0.75 * cell[:, longer] / SQUARES)[:, :3]
    return np.where((cell.sum(axis=1) % 2 == 0)[:, None], PALE, hue)


@dataclass(frozen=True)
class Posture:
    """A hand, and its signature rotated so that both are seen from the same side."""

    surface: Surface
    form: Surface  # the signature; its vertices and faces are numbered as those of the surface
    tips: Array  # vertex indices, lowest first in the open hand: end of the arm, thumb, little finger, other fingers


def figure_2() -> str:
    turn = turn_of(80, 12)
    page, grid = panels(2, 4, (15, 8.4))
    rows = []
    for name, axes, posture in zip(("open", "bent"), grid, _postures(), strict=True):
        ends = posture.tips[1:3]
        path = geodesic_path(posture.surface, int(ends[0]), int(ends[1]))
        _draw_posture(axes, posture, path, turn)
        apart, straight = (
            float(np.linalg.norm(np.subtract(*of.vertices[ends]))) for of in (posture.surface, posture.form)
        )
        length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
        rows.append([name, *(f"{value:.3f}" for value in (apart, length, straight))])
    head_columns(grid, ("posture", "geodesic and equal distances", "signature", "the geodesic, straight"))
    save(page, "paper-fig2")
    return table(["hand", "straight through space", "along the surface", "straight through the signature"], rows)


def _draw_posture(axes: Array, posture: Posture, path: Array, turn: Array) -> None:
    ends = posture.tips[1:3]
    field = geodesic_distances(posture.surface, ends[:1])[0]
    levels = np.linspace(0, field.max(), CONTOURS + 1)[1:-1]
    paint(axes[0], posture.surface, turn)
    paint(axes[2], posture.form, turn)
    for axis, surface in ((axes[1], posture.surface), (axes[3], posture.form)):
        shot = paint(axis, surface, turn, scale_of(field), values=field)
        contours = [line for level in iso_contours(surface, field, levels) for line in level]
        trace(axis, shot, contours, color="white", linewidths=0.7, alpha=0.8)
        for colour, width in (("white", 4.2), ("crimson", 2.4)):
            if surface is posture.surface:
                trace(axis, shot, [path], color=colour, linewidths=width)
            else:
                segment(axis, shot, surface.vertices[ends], color=colour, linewidth=width)
        dots(axis, shot, surface.vertices[ends], color="crimson", s=36, edgecolors="white")


def _postures() -> list[Posture]:
    opened, bent = hands()
    tips = farthest_point_sampling(opened, TIPS)
    tips = tips[opened.vertices[tips][:, 2].argsort()]
    postures: list[Posture] = []
    for surface, at in ((opened, tips), (bent, _matching(geodesic_matrix(opened, tips), bent))):
        form = canonical_form(surface, Parameters(samples=SAMPLES))
        points = form.points * form.signature.scale
        onto = postures[0].form.vertices[tips] if postures else opened.vertices[tips]
        postures.append(Posture(surface, Surface(points @ procrustes(points[at], onto), surface.faces), at))
    return postures


def _matching(between: Array, surface: Surface) -> Array:
    """Return the tips of a surface, in the order whose distances match `between` best."""
    tips = farthest_point_sampling(surface, TIPS)
    theirs = geodesic_matrix(surface, tips)
    orders = (list(order) for order in permutations(range(TIPS)))
    return tips[min(orders, key=lambda order: float(((theirs[np.ix_(order, order)] - between) ** 2).sum()))]


def figure_4() -> str:
    sides = {"Torus": turn_of(20, 35), "Human": turn_of(10, 8), "Rabbit": turn_of(-60, 12), "Elephant": turn_of(25, 10)}
    page, grid = panels(4, 4, (12.4, 12.6))
    rows = []
    for axes, (name, file) in zip(grid.T, STAND_INS.items(), strict=True):
        rows.append([name.lower(), *_draw_methods(axes, single(file), sides[name])])
    head_columns(grid, (name.lower() for name in STAND_INS))
    head_rows(grid, ("original", *METHODS.values()))
    save(page, "paper-fig4", dpi=75)
    return table(["stress at m = 3", *METHODS.values()], rows)


def _draw_methods(axes: Array, surface: Surface, side: Array) -> list[str]:
    paint(axes[0], surface, side)
    forms = {name: canonical_form(surface, Parameters(samples=SAMPLES, method=name)) for name in METHODS}
    best = forms["least_squares"]
    upright = best.points @ procrustes(best.points, surface.vertices)
    values = geodesic_distances(surface, best.signature.samples[:1])[0]
    for axis, form in zip(axes[1:], forms.values(), strict=True):
        points = form.points @ procrustes(form.points, upright)
        paint(axis, Surface(points, surface.faces), side, scale_of(values), values=values)
    return [f"{form.signature.stress:.4f}" for form in forms.values()]
