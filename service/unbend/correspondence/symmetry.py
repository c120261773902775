"""`symmetry`: the intrinsic mirror image of a surface."""

from __future__ import annotations

from unbend.correspondence.bivectors import orientation_of
from unbend.correspondence.correspondence import Correspondence
from unbend.correspondence.match import SAMPLES, match
from unbend.errors import UnsuitedError
from unbend.mesh.surface import Surface


def symmetry(surface: Surface, *, samples: int = SAMPLES, threads: int | None = None) -> Correspondence:
    """Find the intrinsic reflection of a surface: for each vertex its mirror image, such as the other hand's thumb.

    It is the best match of the surface with itself that reverses the orientation of the triangles, so it is never the
    identity. It exists for every surface; `residual` and `confidence` say how good it is. Compare the residual with
    that of `match(surface, surface)`, which only sampling raises above zero.

    Parameters
    ----------
    surface : Surface
        Connected, with faces that agree on their sides.
    samples : int, default 300
        See `match`.
    threads : int, optional
        All cores by default. The result does not depend on it.

    Raises
    ------
    UnsuitedError
        If the faces do not agree on their sides, as on a Möbius strip, so that a reflection is not defined.
    MeshGeometryError
        If the surface has no area, or its faces are not connected.
    ParameterError
        If `samples` or `threads` is out of range.

    Examples
    --------
    >>> from unbend.mesh.shapes import ellipsoid
    >>> symmetry(ellipsoid((1.0, 0.7, 0.4)), samples=100).oriented
    True
    """
    if not orientation_of(surface).known:
        raise UnsuitedError("the faces do not agree on their sides, so no map is a reflection: orient the faces first")
    return match(surface, surface, samples=samples, orientation="reverse", threads=threads)
