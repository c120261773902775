"""The helicoid and the catenoid, and the minimal surfaces between them: one isometric family."""

from __future__ import annotations

import math

import numpy as np

from unbend.mesh.shapes.checks import at_least, between
from unbend.mesh.shapes.grids import grid_faces, grid_parameters
from unbend.mesh.surface import Surface


def helicoid_catenoid(
    t: float = 0.0, *, columns: int = 60, rows: int = 20, span: float = 0.95 * 2 * math.pi, reach: float = 1.0
) -> Surface:
    """Return a surface of the associate family cos(t) * helicoid + sin(t) * catenoid.

    On the domain |u| <= span / 2, |v| <= reach,

        helicoid = (sinh v sin u, -sinh v cos u, u),    catenoid = (cosh v cos u, cosh v sin u, v).

    Every member has the metric cosh(v)^2 (du^2 + dv^2) (do Carmo 1976, section 4-2), so all of them are
    isometric, with area span * (reach + sinh(2 reach) / 2). The domain is shorter than a full turn in u, so the
    catenoid has a slit along v. Without the slit it would not be isometric to the helicoid, which is simply connected.

    Parameters
    ----------
    t : float, default 0.0
        From -pi / 2 to pi / 2. 0 is the helicoid, pi / 2 the catenoid.
    columns, rows : int, default 60 and 20
        Cells along u and v.
    span : float, default 0.95 * 2 pi
        Length of the domain in u, radians, from 0.1 to 0.99 * 2 pi.
    reach : float, default 1.0
        Half of the length of the domain in v, from 0.1 to 3.

    Returns
    -------
    Surface
        (columns + 1) * (rows + 1) vertices; the same faces for every t.

    Raises
    ------
    ParameterError
        If an argument is out of its range.
    """
    between("t", t, -math.pi / 2, math.pi / 2)
    columns, rows = at_least("columns", columns, 1), at_least("rows", rows, 1)
    between("span", span, 0.1, 0.99 * 2 * math.pi)
    between("reach", reach, 0.1, 3.0)
    u, v = grid_parameters(columns, rows)
    u, v = span * (u - 0.5), reach * (2 * v - 1)
    helicoid = np.stack([np.sinh(v) * np.sin(u), -np.sinh(v) * np.cos(u), u], axis=1)
    catenoid = np.stack([np.cosh(v) * np.cos(u), np.cosh(v) * np.sin(u), v], axis=1)
    return Surface(math.cos(t) * helicoid + math.sin(t) * catenoid, grid_faces(columns, rows))
