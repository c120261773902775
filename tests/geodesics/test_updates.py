"""The update equations on single triangles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.geodesics.updates import planar_slot, spherical_slot


def at(radius: float, degrees: float) -> np.ndarray:
    return radius * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])


@pytest.mark.parametrize("slot", [planar_slot, spherical_slot])
@given(
    st.floats(91.0, 175.0), st.floats(0.2, 0.8), st.floats(0.2, 2.0), st.floats(0.2, 2.0), st.floats(0.3, 3.0),
    st.floats(0.0, 2.0),
)  # fmt: skip
def test_the_update_at_an_obtuse_corner_uses_the_edge_that_divides_it(slot, angle, share, near, far, p, time):
    """Kimmel & Sethian unfold an obtuse corner C until an edge CP divides it; a front from P runs along CP."""
    a, b, middle = at(near, 0.0), at(far, angle), at(p, share * angle)
    ends = time + np.array([np.linalg.norm(a - middle), np.linalg.norm(b - middle), 0.0])
    numbers = np.array([*ends, a[0], b[0], b[1], *middle], np.float32)
    assert slot(*numbers) <= (time + p) * (1 + 1e-5)
