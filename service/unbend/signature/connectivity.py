"""The triangles of the signature surface."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.mesh.surface import Surface
from unbend.signature.collapse import collapse_onto_samples


def signature_faces(surface: Surface, samples: Ints, nearest: Ints, distances: Floats) -> Ints:
    """Connect samples by collapsing the surface's edges until only samples are left (section 2.2).

    The paper decimates as Melax (1998) does. Here, edges within the samples' geodesic Voronoi cells collapse first.
    This gives the triangles of the dual of the Voronoi diagram, wherever samples are dense enough for the dual to be a
    surface. Elsewhere, in thin fingers, around handles and along boundaries, the remaining vertices move across cells,
    the shortest new edges first. Edges are measured by `distances`, so triangles depend only on quantities that bending
    does not change. If possible, a collapse satisfies the link condition (Dey et al. 1999), which keeps the surface's
    genus, orientability and boundaries. The orientation of faces is always kept. Features with too few samples, such as
    a handle with two samples or a hole with one, close.

    Parameters
    ----------
    surface : Surface
        Any triangulated surface; it need not be manifold, oriented or connected.
    samples : (k,) int
        Vertices of the surface, without repeats.
    nearest : (n,) int32
        Index in `samples` of the sample nearest to each vertex, -1 for none.
    distances : (k, k) float64
        Geodesic distances between samples.

    Returns
    -------
    (f, 3) int32
        Indices into `samples`, oriented like the surface, without repeated triangles. If every vertex is a sample,
        these are the surface's faces without degenerate and duplicate ones.

    References
    ----------
    S. Melax, "A simple, fast, and effective polygon reduction algorithm", Game Developer, November 1998.
    T. Dey, H. Edelsbrunner, S. Guha, D. Nekhayev, "Topology preserving edge contraction", Publ. Inst. Math.
    (Beograd) 66 (80), 1999.
    """
    return collapse_onto_samples(surface, nearest, np.asarray(samples, np.int32), distances)
