"""The demonstration collection: classes of nearly isometric shapes, in many poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.mesh.shapes.cones import cone
from unbend.mesh.shapes.figures import FIGURES, figure
from unbend.mesh.shapes.helicoid import helicoid_catenoid
from unbend.mesh.shapes.sheet import cylinder, s_bend, sheet, spiral
from unbend.mesh.shapes.tubes import bent_tube, pin_profile
from unbend.mesh.surface import Surface
from unbend.mesh.write import write_mesh

POSES = 6
"""Number of shapes in each class."""

DEMO_LABELS = ("sheet", "helicoid", "cone", "tube", "pin", *FIGURES)
"""Classes of the collection."""

DEMO_COUNT = POSES * len(DEMO_LABELS)
"""Number of shapes in the collection."""

Maker = Callable[[], Surface]


@dataclass(frozen=True)
class LabelledShape:
    """A shape of the collection.

    Parameters
    ----------
    name : str
        Unique: the label and the number of the pose, like "biped-03".
    label : str
        The class. Shapes of one class are isometric or nearly isometric.
    surface : Surface
        500 to 2,500 vertices.
    """

    name: str
    label: str
    surface: Surface

    def as_ply(self) -> bytes:
        """Return the surface as a ply file."""
        return write_mesh(self.surface.vertices, self.surface.faces, "ply")


def demo_shapes() -> Iterator[LabelledShape]:
    """Yield the shapes of the collection, class by class, with six poses of each class. They are always the same.

    Every shape is turned by a random rotation, because a signature must not depend on rotations. In the classes
    "sheet", "helicoid" and "cone" the smooth surfaces are isometric; in the others they are nearly isometric.

    Yields
    ------
    LabelledShape
        Each shape is made only when it is requested.
    """
    for class_number, (label, makers) in enumerate(_classes().items()):
        for pose, make in enumerate(makers):
            generator = np.random.default_rng([class_number, pose])
            yield LabelledShape(f"{label}-{pose:02d}", label, _turned(make(), generator))


def _classes() -> dict[str, list[Maker]]:
    sheets: list[Maker] = [
        sheet,
        partial(cylinder, math.pi),
        partial(cylinder, 1.8 * math.pi),
        partial(s_bend, math.pi),
        partial(s_bend, 1.6 * math.pi),
        partial(spiral, 1.5, 0.1),
    ]
    families: dict[str, list[Maker]] = {
        "sheet": sheets,
        "helicoid": [partial(helicoid_catenoid, t) for t in np.linspace(0.0, math.pi / 2, POSES).tolist()],
        "cone": [partial(cone, roll=roll) for roll in np.linspace(0.0, 1.0, POSES).tolist()],
        "tube": [partial(bent_tube, pose) for pose in ("straight", "arc", "s", "spiral", "helix", "knot")],
        "pin": [
            partial(bent_tube, pose, length=4.0, radius=pin_profile(4.0, 0.26))
            for pose in ("straight", "arc", "s", "spiral", "helix", "loop")
        ],
    }
    return families | {kind: [partial(figure, kind, pose) for pose in range(POSES)] for kind in FIGURES}


def _turned(surface: Surface, generator: np.random.Generator) -> Surface:
    """Return the surface after a uniformly random rotation, because a normal quaternion has no preferred direction."""
    turn = Rotation.from_quat(generator.normal(size=4)).as_matrix()
    return Surface(surface.vertices @ turn.T, surface.faces)
