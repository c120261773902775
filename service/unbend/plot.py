"""Figures of matplotlib. Only this module imports matplotlib, which the extra `plot` installs.

Each function returns a `matplotlib.figure.Figure` of its own and leaves pyplot's state alone. `figure.savefig` writes
it to a file, and a notebook shows it after `%matplotlib inline`. Colours and marks of classes are those of the report.

matplotlib sorts whole triangles by depth, which is wrong where they cross. `unbend.render_picture` is right there, but
has no axes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from unbend.arrays import Floats, Ints
from unbend.brief import counted_points
from unbend.errors import ParameterError
from unbend.extras import extra
from unbend.marks import COLOURS, UNLABELLED, look_of
from unbend.mesh.surface import Surface
from unbend.results import MapItem, Ranking, ShapeMap, ShapeMatch
from unbend.signature.canonical_form import CanonicalForm, in_space
from unbend.signature.signature import Signature

with extra("plot"):
    from matplotlib import colormaps
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection
    from mpl_toolkits.mplot3d.axes3d import Axes3D

MOST_BARS: Final = 20
"""Shapes that `ranking` shows by default."""

_FORM, _EDGE, _UNKNOWN = "#e3b58a", "#7a5a38", "#b9b9b9"

_MARKERS: Final = "os^DvP"
"""The marks of `unbend.marks`, as matplotlib calls them."""

_MARGIN: Final = 0.02
"""Room around a surface, as a share of its extent."""

_ROWS: Final = 18
"""Most classes in a column of a legend."""

_HATCHES: Final = ("", "///", "...", "xxx", "ooo", "+++")
"""Hatches of bars, where points have marks."""


def form(signature: Signature | CanonicalForm) -> Figure:
    """Plot a signature, or the canonical form of every vertex, in its first three dimensions.

    In two dimensions it lies in the plane, in one on a line. Units are those of the signature's points.

    Raises
    ------
    ParameterError
        If it is neither, such as a surface.
    """
    if not isinstance(signature, Signature | CanonicalForm):
        error = ParameterError(f"signature: {type(signature).__name__} is neither a Signature nor a CanonicalForm")
        if isinstance(signature, Surface):
            raise error.with_advice("Give the form of the surface: plot.form(unbend.canonical_form(surface)).")
        raise error
    points, faces = signature.points, signature.faces
    figure = Figure(figsize=(5, 5), layout="constrained")
    if points.shape[1] > 2:
        space = figure.add_subplot(projection="3d")
        _add_solid(space, points[:, :3], faces, facecolors=_FORM, edgecolors=_EDGE, linewidths=0.3)
        axes: Axes = space
    else:
        axes = figure.add_subplot()
        if points.shape[1] == 2:
            axes.triplot(*points.T, faces, color=_EDGE, linewidth=0.5)
        axes.plot(*in_space(points)[:, :2].T, "o", color=_EDGE, markersize=2)
        axes.set_aspect("equal", adjustable="datalim")
    stress = signature.signature.stress if isinstance(signature, CanonicalForm) else signature.stress
    axes.set_title(f"{counted_points(points.shape)}, stress {stress:.3g}")
    return figure


def field(surface: Surface, values: ArrayLike, *, label: str = "", colours: str = "viridis") -> Figure:
    """Plot a surface coloured by values, such as geodesic distances.

    Parameters
    ----------
    surface : Surface
    values : (n,) array
        A value for each vertex. A face has the colour of the mean of its corners, and is grey if that is not finite.
    label : str, optional
        Label of the colour bar.
    colours : str, default "viridis"
        A colour map of matplotlib.

    Raises
    ------
    ParameterError
        If there is not one value for each vertex, none is finite, or matplotlib has no such colour map.
    """
    given = np.asarray(values, np.float64)
    if given.shape != (len(surface.vertices),):
        raise ParameterError(
            f"values must have one number for each of the {len(surface.vertices)} vertices, not the shape {given.shape}"
        )
    if colours not in colormaps:
        raise ParameterError(f"colours: matplotlib has no colour map {colours!r}")
    means = given[surface.faces].mean(axis=1)
    known = np.isfinite(means)
    if not known.any():
        raise ParameterError("values: no face has finite values")
    figure = Figure(figsize=(6, 5), layout="constrained")
    space = figure.add_subplot(projection="3d")
    solid = _add_solid(space, surface.vertices, surface.faces, linewidths=0)
    solid.set_array(np.ma.masked_invalid(means))
    solid.set_cmap(colormaps[colours].with_extremes(bad=_UNKNOWN))
    solid.set_clim(means[known].min(), means[known].max())
    bar = figure.colorbar(solid, ax=space, shrink=0.7)
    bar.set_label(label, parse_math=False)
    return figure


def map(shape_map: ShapeMap) -> Figure:  # noqa: A001  so that it reads `plot.map(library.map())`
    """Plot a `ShapeMap` as the paper's Fig. 8: on the left by its measure, on the right by the surfaces in space.

    Only the first two dimensions are shown.
    """
    items = list(shape_map.items)
    labels = _labels(items)
    figure = Figure(figsize=(10, 5), layout="constrained")
    sides = (
        ("point", f"by {shape_map.measure}, stress {shape_map.stress:.3g}"),
        ("original", f"by the surfaces in space, stress {shape_map.original_stress:.3g}"),
    )
    for axes, (which, title) in zip(figure.subplots(1, 2), sides, strict=True):
        for label in labels:
            points = in_space(np.array([getattr(item, which) for item in items if item.label == label], np.float64))
            axes.plot(*points[:, :2].T, **_look(labels, label), linestyle="", markersize=5)
        axes.set_title(title, parse_math=False)
        axes.set_aspect("equal", adjustable="datalim")
        axes.locator_params(nbins=5)  # more labels would overlap in the narrow axes
    handles = [Line2D([], [], **_look(labels, label), linestyle="") for label in labels]
    _add_legend(figure, handles, labels)
    return figure


def ranking(ranking: Ranking, *, most: int = MOST_BARS) -> Figure:
    """Plot the distances of the nearest shapes of a `Ranking` as bars, the nearest on top, coloured by class.

    Parameters
    ----------
    ranking : Ranking
    most : int, default 20
        Largest number of bars.
    """
    shown = list(ranking.shapes[:most])
    labels = _labels(shown)
    figure = Figure(figsize=(6, 1.2 + 0.28 * len(shown)), layout="constrained")
    axes = figure.add_subplot()
    for place, match in enumerate(shown):
        axes.barh(place, match.distance, **_filling(labels, match.label))
    axes.set_yticks(range(len(shown)), [match.name for match in shown], parse_math=False)
    axes.invert_yaxis()
    axes.set_xlabel(f"distance by {ranking.measure}", parse_math=False)
    _add_legend(figure, [Patch(**_filling(labels, label)) for label in labels], labels)
    return figure


def _add_solid(axes: Axes3D, points: Floats, faces: Ints, **style: Any) -> Poly3DCollection:
    """Add triangles to axes whose units are equal, and return their collection."""
    solid = Poly3DCollection(points[faces], **style)
    axes.add_collection3d(solid)
    used = points[faces.ravel()] if len(faces) else points
    margin = _MARGIN * float(np.ptp(used, axis=0).max()) or 1.0  # flat surfaces need room across, too
    low, high = used.min(axis=0) - margin, used.max(axis=0) + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_aspect("equal")
    return solid


def _labels(items: Iterable[MapItem | ShapeMatch]) -> list[str | None]:
    """Return the classes in alphabetical order; None comes last if a shape has no class."""
    found = {item.label for item in items}
    named = sorted(label for label in found if label is not None)
    return [*named, None] if None in found else [*named]


def _look(labels: Sequence[str | None], label: str | None) -> dict[str, Any]:
    if label is None:
        return {"color": UNLABELLED, "marker": _MARKERS[0]}
    colour, mark = look_of(labels.index(label))
    return {"color": COLOURS[colour], "marker": _MARKERS[mark]}


def _filling(labels: Sequence[str | None], label: str | None) -> dict[str, Any]:
    look = _look(labels, label)
    return {"facecolor": look["color"], "edgecolor": "white", "hatch": _HATCHES[_MARKERS.index(look["marker"])]}


def _add_legend(figure: Figure, handles: Sequence[Any], labels: Sequence[str | None]) -> None:
    if not labels:
        return
    names = ["(no class)" if label is None else label for label in labels]
    legend = figure.legend(handles, names, loc="outside right upper", ncols=-(-len(names) // _ROWS))
    for text in legend.get_texts():
        text.set_parse_math(False)  # a dollar sign in a label is a dollar sign
