"""The signature surface's triangles."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.mesh.surface import Surface
from unbend.signature.collapse import collapse_onto_samples


def signature_faces(surface: Surface, samples: Ints, nearest: Ints, distances: Floats) -> Ints:
    """Join samples by collapsing the surface's edges until no other vertices are left (section 2.2).

    The paper decimates as Melax (1998) does. Collapsing within the samples' geodesic Voronoi cells first makes the
    triangles those of the dual of the Voronoi diagram, wherever samples are dense enough for that to be a surface.
    Where they are not, in thin fingers, around handles and along boundaries, vertices that are left move across
    cells, the shortest new edges first, measured by `distances`: so triangles depend on nothing that bending
    changes. As long as it can, a collapse keeps the link condition (Dey et al. 1999), and with it the surface's
    genus, orientability and boundaries; it keeps the orientation of faces always. What samples are too few for, a
    handle of two or a hole of one, closes.

    Parameters
    ----------
    surface : Surface
        Any triangles: they need not be manifold, oriented or connected.
    samples : (k,) int
        Vertices of the surface, each once.
    nearest : (n,) int32
        Place in `samples` of the sample nearest to each vertex; -1 where there is none.
    distances : (k, k) float64
        Geodesic distances between samples.

    Returns
    -------
    (f, 3) int32
        Places in `samples`, oriented as the surface is, each triangle once. With every vertex a sample these are
        the surface's own faces, without those that use a vertex twice or have the vertices of an earlier one.

    References
    ----------
    S. Melax, "A simple, fast, and effective polygon reduction algorithm", Game Developer, November 1998.
    T. Dey, H. Edelsbrunner, S. Guha, D. Nekhayev, "Topology preserving edge contraction", Publ. Inst. Math.
    (Beograd) 66 (80), 1999.
    """
    return collapse_onto_samples(surface, nearest, np.asarray(samples, np.int32), distances)
