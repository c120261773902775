"""The numeric tolerances and iteration limits of the package. Tolerances are relative unless a unit is named."""

from __future__ import annotations

from typing import Final

DEGENERATE_HEIGHT: Final = 1e-10
"""A triangle whose height is below this share of its longest edge has no direction: it is counted and kept.

Double precision resolves a height to about 1e-16 of the edge. A height of 1e-10 therefore has six correct digits, and
so do the unfolded coordinates of `geodesics.stencils`.
"""

SEAM_GAP: Final = 1e-6
"""Largest gap between the two sides of a seam, as a share of the surface's extent.

Both sides are copies of the same points, rounded to single precision or to text of six or seven digits.
"""

SEAM_EDGES: Final = 10.0
"""A vertex is joined across a gap only if its edges are at least this many gaps long, so that small features remain."""

SAME_ANGLE: Final = 1e-4
"""Faces around an edge coincide where their angles, in radians, differ by less than this."""

AREA_KEPT: Final = 0.9
"""Below this share of the area kept, reading warns that the surface may not be what the file's author intended."""

DEGENERATE_BASE: Final = 1e-7
"""An edge below this share of the other two of its triangle has no direction: no front crosses it."""

NEEDLE: Final = 1e4
"""Ratio of a triangle's longest edge to its shortest beyond which single precision has no direction across it."""

LONGEST_EDGE: Final = 1e9
"""Longest edge, in median edges, for which squared distances fit in single precision."""

MOLLIFIED: Final = 1e-11
"""Least excess, in median edges, of two sides of a triangle over the third before flips (Sharp & Crane 2020)."""

DELAUNAY: Final = 1e-9
"""An edge is flipped where the cotangents opposite it sum to less than minus this, so that squares are not flipped."""

FLIPS: Final = 100
"""Most flips per face. Lawson's algorithm ends in exact arithmetic, but rounding on triangles of zero area can loop."""

THIN_ANGLE: Final = 10.0
"""Degrees below which angles of intrinsic triangles are always refined. 1 % of a scan's faces have such an angle."""

ROUND_ANGLE: Final = 25.0
"""Degrees below which a stretched surface's angles are refined. Refinement provably ends up to 20.7, in practice 30."""

STRETCHED_SHARE: Final = 0.03
"""A surface is stretched where more than this share of its faces have an angle below `THIN_ANGLE` after all flips."""

NARROW: Final = 60.0
"""Where the angle around a vertex is below this, in degrees, its triangles stay thin after any insertion."""

MOST_STEINER: Final = 4.0
"""Most Steiner points per vertex of the surface, in addition to `STEINER_FLOOR`."""

STEINER_FLOOR: Final = 2000
"""Steiner points that every surface may have, because CAD models have few vertices."""

HOPELESS: Final = 1e-3
"""A triangle whose shortest side is below this share of its longest is not refined: it needs thousands of points."""

REFINEMENT_STEPS: Final = 200
"""Most triangles crossed in search of a circumcentre. Only early circumcentres are far from their triangle."""

START_EVENTS: Final = 224
"""Windows and pseudo-sources that the exact start of a front processes: about four rings of vertices."""

START_RADIUS: Final = 2.75
"""Radius, in median edges, below which the exact start continues, for up to three times `START_EVENTS`."""

SADDLE: Final = 1e-10
"""Shortest paths may bend at a vertex around which the angle exceeds a full turn by more than this, in radians.

Rounding on flat meshes causes a smaller excess. Behind a vertex of smaller excess, rays that graze it reach every
vertex.
"""

PLANAR_START: Final = 0.1
"""Radius of the disc around a source in which planar marching uses the spherical update.

The radius is this number of median edges times the square root of the number of triangles, so that the disc is a fixed
share of the surface. A front is round near its source, and marching carries the error of the planar update there to the
whole surface. With a disc of a fixed number of edges, the error would fall more slowly than the edge length.
"""

PLANAR_START_EDGES: Final = 3.0
"""The least radius of the disc of `PLANAR_START`, in median edges."""

RAY_MARGIN: Final = 1e-6
"""Share of the segment by which a ray may miss its end, so that rounding does not lose a ray through a vertex."""

MARCHING_DECREASE: Final = 1e-6
"""A distance is lowered again only by more than this share of it. Single precision rounds to 6e-8."""

DOUBTFUL_ASYMMETRY: Final = 0.05
"""Distances are doubtful if the two directions of a pair differ by more than this share of the largest distance.

On real meshes they differed by at most 0.03, on a mesh of 252 vertices. Of 500 defective meshes, those without a
warning had errors of at most 4 % of the largest distance, and those with a warning of up to 21 %.
"""

PIECE_BOUNDARY: Final = 0.25
"""A surface may be a piece if its boundary is longer than this share of the square root of its area.

A circle of this length has a radius of 0.04 of it: a hole of a scan is shorter, a cut through a limb is longer.
"""

SAMPLING_TIE: Final = 1e-3
"""Vertices this near to the farthest, as a share of its distance, count as equally far: the first is sampled.

Distances have errors of about this size, so a smaller difference between a flat and a bent sheet means nothing.
"""

UNFOLDING_STEPS: Final = 12
"""Most triangles over which an obtuse corner is unfolded.

Kimmel & Sethian (1998) bound the number by the mesh's smallest angle; 12 suffices for angles above 8 degrees.
"""

SYMMETRY: Final = 1e-9
"""Share of the largest entry by which entries of a symmetric matrix may differ from their mirror images."""

REPRESENTATION_ERROR: Final = 0.05
"""Error of an embedding in the effective dimension (section 3: "a representation error of up to 5 percent")."""

EIGENPAIR_RESIDUAL: Final = 1e-8
"""Norm of B v - lambda v, in units of the largest eigenvalue, at which an eigenpair of classical scaling has converged.

The error of an eigenvalue is the square of this norm, divided by its distance from the next eigenvalue.
"""

SMACOF_DECREASE: Final = 1e-6
"""SMACOF stops when two iterations lower the stress by less than this share of it (section 3.2, step 5)."""

SMACOF_ITERATIONS: Final = 300
"""Most iterations of SMACOF, however slowly the stress decreases."""

SMACOF_MEMORY: Final = 8
"""Steps that accelerated scaling remembers. With twenty steps it needs as many iterations."""

SINGLE_STRESS: Final = 1e-6
"""Below this stress, distances differ by less than a thousandth, and scaling continues in double precision."""

ZERO_STRESS: Final = 1e-24
"""Below this stress only rounding is left."""

SPECTRUM_FLOOR: Final = 1e-9
"""Eigenvalues of the geodesic spectrum below this are rounding; the largest is near 1, because weights sum to 1."""

DENSITY_FLOOR: Final = 1e-12
"""Lower bound of the share of a surface's area within the width of a kernel around a sample.

Only needles of twenty orders of magnitude come near it; without it the diffusion kernel would divide by zero there.
"""

FLAT_CORNER: Final = 1e-6
"""Share of a polygon's area by which the triangles that cut it may overlap.

Rounding to single precision moves corners off a line by about as much.
"""

SHARES_SUM: Final = 1e-9
"""Difference from 1 of the sum of a stored signature's shares of the area: rounding in double precision is less."""
