"""The things in a picture: triangle meshes, tubes and spheres, as values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unbend.arrays import Floats, Ints, frozen
from unbend.errors import ParameterError
from unbend.mesh.surface import check_mesh
from unbend.render.colours import Colour, ColourMap, colour_table


@dataclass(frozen=True, eq=False)
class Field:
    """A function on the vertices of a mesh, shown by colours and contours.

    Parameters
    ----------
    values : (n,) float64
        One value per vertex. Triangles with an infinite value get the theme's colour for unknown values.
    colour_map : {"viridis", "coolwarm"}, default "viridis"
        Colours from `low` to `high`.
    low, high : float, optional
        Values of the first and the last colour; the least and the largest finite value by default.
    contours : int, default 0
        Number of steps between `low` and `high` that contours separate; 0 draws none.

    Raises
    ------
    ParameterError
        If `values` is not one-dimensional, the colour map is unknown, `low` or `high` is not a number, `low` is above
        `high`, or `contours` is negative.
    """

    values: Floats
    colour_map: ColourMap = "viridis"
    low: float | None = None
    high: float | None = None
    contours: int = 0

    def __post_init__(self) -> None:
        values = frozen(self.values, np.float64)
        object.__setattr__(self, "values", values)
        if values.ndim != 1:
            raise ParameterError(f"values must be (n,), not {values.shape}")
        colour_table(self.colour_map)
        known = values[np.isfinite(values)]
        low = float(known.min(initial=np.inf)) if self.low is None else float(self.low)
        high = float(known.max(initial=-np.inf)) if self.high is None else float(self.high)
        if len(known) == 0 and (self.low is None or self.high is None):
            low = high = 0.0
        if not low <= high:
            raise ParameterError(f"low must be at most high, not {low} and {high}")
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        if self.contours < 0:
            raise ParameterError(f"contours must be 0 or more, not {self.contours}")

    @property
    def bounds(self) -> tuple[float, float]:
        """`low` and `high`, which are not None once the field is made."""
        return float(self.low or 0.0), float(self.high or 0.0)


@dataclass(frozen=True, eq=False)
class SceneMesh:
    """A triangle mesh in a picture.

    Parameters
    ----------
    vertices : (n, 3) float64
        Finite where a face uses them.
    faces : (m, 3) int32
        Their orientation does not matter: both sides are lit.
    colour : (3,) float
        sRGB, 0 to 1, of the whole mesh.
    colours : (n, 3) float64, optional
        sRGB of each vertex, instead of `colour`.
    field : Field, optional
        Colours by a function, instead of `colour`.

    Raises
    ------
    MeshGeometryError
        If the shapes are wrong, an index is out of range, or there is no face.
    ParameterError
        If a used coordinate is not finite, colours or values do not fit the vertices, or a used value is not a number.
    """

    vertices: Floats
    faces: Ints
    colour: Colour = (0.7, 0.7, 0.7)
    colours: Floats | None = None
    field: Field | None = None

    def __post_init__(self) -> None:
        vertices = frozen(self.vertices, np.float64)
        check_mesh(vertices, np.asarray(self.faces))
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", frozen(self.faces, np.int32))
        count = len(vertices)
        used = np.zeros(count, bool)
        used[self.faces] = True
        if not np.isfinite(vertices[used]).all():
            row = int(np.flatnonzero(used & ~np.isfinite(vertices).all(axis=1))[0])
            raise ParameterError(f"vertices: vertex {row} has a coordinate that is not finite")
        if self.colours is not None:
            object.__setattr__(self, "colours", frozen(self.colours, np.float64))
            if self.colours.shape != (count, 3):
                raise ParameterError(f"colours must be ({count}, 3), one for each vertex, not {self.colours.shape}")
        if self.field is not None:
            if self.field.values.shape != (count,):
                raise ParameterError(f"values must be ({count},), one for each vertex, not {self.field.values.shape}")
            if np.isnan(self.field.values[used]).any():
                raise ParameterError("values: one of them is not a number")


@dataclass(frozen=True, eq=False)
class Tube:
    """A tube around a polyline: points (p, 3), its radius in the same unit, and its colour in sRGB."""

    points: Floats
    radius: float
    colour: Colour

    def __post_init__(self) -> None:
        points = frozen(self.points, np.float64)
        object.__setattr__(self, "points", points)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
            raise ParameterError("points of a tube must be (p, 3) finite numbers, with at least one point")
        _check_radius(self.radius)


@dataclass(frozen=True)
class Sphere:
    """A sphere that marks a place: its centre, its radius in the same unit, and its colour in sRGB."""

    centre: tuple[float, float, float]
    radius: float
    colour: Colour

    def __post_init__(self) -> None:
        if not np.isfinite(self.centre).all():
            raise ParameterError("the centre of a sphere must be finite")
        _check_radius(self.radius)


def _check_radius(radius: float) -> None:
    if not (np.isfinite(radius) and radius > 0):
        raise ParameterError(f"radius must be a finite number above 0, not {radius}")


Item = SceneMesh | Tube | Sphere


@dataclass(frozen=True, eq=False)
class Scene:
    """All that a picture shows, in one coordinate system. Lengths should be between 1e-70 and 1e70.

    The picture of an empty scene is only the background.
    """

    items: tuple[Item, ...]
