"""The pictures of the report: a selection of the shapes. The page contains each picture once."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Final

import numpy as np

MOST_PICTURES: Final = 400
"""Largest number of pictures in a page, to bound its size. A picture of 128 x 128 pixels takes about 3 kB in base64."""

MOST_OF_CLASS: Final = 8
"""Largest number of pictures in the row of a class."""


@dataclass(frozen=True)
class ShapePicture:
    """A picture of a shape."""

    name: str
    """The name of the shape, as in `Report.queries` or `Report.gallery`."""
    label: str
    """The class of the shape."""
    file: bytes
    """A WebP file. The page may be light or dark, so the background should be transparent."""


@dataclass(frozen=True)
class EmbeddedPicture:
    """A picture in the page."""

    identity: str
    """The id of its element."""
    url: str
    """A data: URL."""


@dataclass(frozen=True)
class ClassRow:
    """The members of a class that the page shows."""

    label: str
    members: int
    """The number of members that have a picture, shown or not."""
    shown: tuple[str, ...]
    """Names of shapes."""


@dataclass(frozen=True)
class PictureView:
    """The pictures in the page."""

    by_name: Mapping[str, EmbeddedPicture]
    """The selected pictures, by the names of the shapes."""
    rows: tuple[ClassRow, ...]
    """Sorted by class, without classes that have no selected picture."""
    given: int
    """The number of shapes that have a picture, selected or not."""
    classes: int
    """The number of classes that have a picture, selected or not."""
    most: int = MOST_PICTURES
    most_of_class: int = MOST_OF_CLASS


def select_pictures(pictures: Sequence[ShapePicture], wrong: Sequence[Sequence[str]]) -> PictureView:
    """Select at most `MOST_PICTURES` pictures.

    At least half of them show wrong answers, if there are enough wrong answers. The others are evenly
    spaced members of each class.

    Parameters
    ----------
    pictures : sequence of ShapePicture
    wrong : sequence of sequences of str
        For each measure, the shapes of its wrong answers, in the order of the page.
    """
    files = {picture.name: picture.file for picture in pictures}
    by_class: dict[str, dict[str, None]] = {}
    for picture in pictures:
        by_class.setdefault(picture.label, {})[picture.name] = None
    spaced = {label: _evenly_spaced(list(by_class[label])) for label in sorted(by_class)}
    members = _in_turn(list(spaced.values()))
    half = MOST_PICTURES // 2
    wanted = dict.fromkeys([*members[:half], *_in_turn(wrong), *members[half:]])
    chosen = [name for name in wanted if name in files][:MOST_PICTURES]
    embedded = {
        name: EmbeddedPicture(f"picture-{place}", _data_url(files[name])) for place, name in enumerate(chosen, start=1)
    }
    rows = (
        ClassRow(label, len(by_class[label]), tuple(name for name in names if name in embedded))
        for label, names in spaced.items()
    )
    return PictureView(embedded, tuple(row for row in rows if row.shown), len(files), len(by_class))


def _evenly_spaced(names: Sequence[str]) -> list[str]:
    places = np.linspace(0, len(names) - 1, min(len(names), MOST_OF_CLASS)).round().astype(int)
    return [names[place] for place in places]


def _in_turn(lists: Sequence[Sequence[str]]) -> list[str]:
    """Return the first of each list, then the second of each, and so on."""
    return [name for names in zip_longest(*lists) for name in names if name is not None]


def _data_url(file: bytes) -> str:
    return "data:image/webp;base64," + b64encode(file).decode("ascii")
