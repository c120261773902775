"""Figures, galleries, rankings and maps as HTML.

Rankings and maps are above this package, and show themselves by its functions. So it knows only their attributes.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from numpy.typing import NDArray

from unbend.marks import COLOURS, MARKS, UNLABELLED, fit_to_frame, look_of

MOST_ROWS: Final = 10
"""Classes or shapes that a ranking shows; the table says how many more there are."""

MOST_MARKS: Final = 2000
"""Shapes that a map shows; if there are more, evenly spaced ones."""

_WIDTH, _HEIGHT, _EDGE = 460, 360, 24

# Names and labels are not trusted, so every value is escaped. A missing value is an error.
_TEMPLATES: Final = Environment(
    loader=PackageLoader("unbend.notebook"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)

_LEAST_SHARE: Final = 0.001
"""The smallest share that is written as a number."""


def _percent(share: float) -> str:
    return "< 0.1 %" if 0 < share < _LEAST_SHARE else f"{100 * share:.3g} %"


def _coded(text: str) -> Markup:
    """Return text in which words between backticks are code; other text is escaped."""
    parts = text.split("`")
    if len(parts) % 2 == 0:  # a single backtick encloses nothing
        return escape(text)
    return Markup().join(
        Markup("<code>{}</code>").format(part) if place % 2 else escape(part) for place, part in enumerate(parts)
    )


_TEMPLATES.filters |= {"percent": _percent, "coded": _coded}


def figure_html(picture: bytes | None, caption: str, warnings: Sequence[str] = ()) -> str:
    """Return a picture, a PNG or WebP file, with its caption and warnings; without a picture only these."""
    source = None if picture is None else data_url(picture)
    return _TEMPLATES.get_template("figure.html.jinja").render(source=source, caption=caption, warnings=warnings)


def gallery_html(pictures: Mapping[str, bytes]) -> str:
    """Return PNG or WebP files beside each other, each above its caption."""
    sources = {caption: data_url(file) for caption, file in pictures.items()}
    return _TEMPLATES.get_template("gallery.html.jinja").render(sources=sources)


def ranking_html(ranking: Any, pictures: Mapping[str, bytes] | None = None, *, most: int = MOST_ROWS) -> str:
    """Return the best classes and shapes of a ranking as two tables.

    Parameters
    ----------
    ranking : Ranking
    pictures : mapping of str to bytes, optional
        PNG or WebP files of shapes by their ids; shapes without one have none. `unbend.render.notebook.thumbnail` draws
        them from surfaces.
    most : int, default 10
        Rows of each table.
    """
    sources = {shape: data_url(file) for shape, file in (pictures or {}).items()}
    shown = ranking.shapes[:most]
    return _TEMPLATES.get_template("ranking.html.jinja").render(
        ranking=ranking,
        most=most,
        sources=sources,
        pictured=any(match.id in sources for match in shown),
        parts=any(getattr(match, "part", None) for match in shown),
    )


def map_html(shape_map: Any) -> str:
    """Return a `ShapeMap` as marks in its first two dimensions, with the name of each shape as a tooltip."""
    items = list(shape_map.items)
    if len(items) > MOST_MARKS:
        items = [items[row] for row in np.linspace(0, len(items) - 1, MOST_MARKS).astype(int)]
    labels = sorted({item.label for item in items if item.label is not None})
    looks = {label: _look(place) for place, label in enumerate(labels)}
    points = fit_to_frame(_in_plane(items), _WIDTH, _HEIGHT, _EDGE) if items else np.empty((0, 2))
    marks = [
        (item, x, _HEIGHT - y, *looks.get(item.label, (UNLABELLED, MARKS[0])))
        for item, (x, y) in zip(items, points.tolist(), strict=True)
    ]
    return _TEMPLATES.get_template("map.html.jinja").render(
        map=shape_map, marks=marks, looks=looks, width=_WIDTH, height=_HEIGHT
    )


def data_url(picture: bytes) -> str:
    """Return a PNG or WebP file as a data URL."""
    kind = "png" if picture.startswith(b"\x89PNG") else "webp"
    return f"data:image/{kind};base64," + b64encode(picture).decode("ascii")


def _look(place: int) -> tuple[str, str]:
    colour, mark = look_of(place)
    return COLOURS[colour], MARKS[mark]


def _in_plane(items: Sequence[Any]) -> NDArray[np.float64]:
    """Return the first two coordinates of items, (n, 2); 0 where a map has a single one."""
    points = np.array([item.point for item in items], np.float64)
    return np.pad(points[:, :2], ((0, 0), (0, max(0, 2 - points.shape[1]))))
