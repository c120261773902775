"""Every numeric tolerance of the package, with its reason. All are relative unless a unit is named."""

from __future__ import annotations

from typing import Final

DEGENERATE_HEIGHT: Final = 1e-10
"""A triangle whose height is below this share of its longest edge carries no direction: it is dropped.

In double precision a height is known to about 1e-16 of the edge; six digits above that, the unfolded
coordinates of `geodesics.stencils` still keep six digits.
"""

START_DISC_EDGES: Final = 3.0
"""Radius, in mean edges at the source, of the disc that planar fast marching starts with already unfolded."""

UNFOLDING_STEPS: Final = 12
"""Triangles an obtuse corner is unfolded over before it is left as it is.

Kimmel & Sethian (1998) bound the number by the mesh's smallest angle; 12 suffices for angles above 8 degrees.
"""

SMACOF_DECREASE: Final = 1e-5
"""SMACOF stops when an iteration lowers the stress by less than this share of it (section 3.2, step 5)."""

SMACOF_ITERATIONS: Final = 300
"""SMACOF stops after this many iterations whatever the decrease."""

SPECTRUM_FLOOR: Final = 1e-9
"""Eigenvalues of the geodesic spectrum below this are rounding; the largest is near 1, for weights sum to 1."""
