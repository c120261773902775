"""The two update equations of fast marching, for one segment of a stencil.

Each takes the distances u1 and u2 at a segment's ends and the segment's position relative to the corner C: the squared
length of the segment, and C's coordinates along and across it, both multiplied by the length (which avoids a square
root). Each returns inf if the front reaches C from outside the segment.
"""

from __future__ import annotations

import numpy as np

from unbend.jit import inlined
from unbend.tolerances import RAY_MARGIN

_NONE = np.float32(np.inf)
_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_MARGIN = np.float32(-RAY_MARGIN)


@inlined
def spherical_squared(u1, u2, squared, along, across):
    """Return the squared distance of C from a virtual source (Novotni & Klein 2002).

    The source lies behind the segment, at the distances u1 and u2 from its ends. The ray from the source to C must meet
    the segment.
    """
    foot = _HALF * ((u1 - u2) * (u1 + u2) + squared)
    square = u1 * u1 * squared - foot * foot
    depth = np.sqrt(max(_ZERO, square))
    height = depth + across
    crossing = foot * across + along * depth
    end = squared * height
    offset = foot - along
    value = (offset * offset + height * height) / squared
    meets = (crossing >= _MARGIN * end) & (crossing <= end) & (height > _ZERO) & (squared > _ZERO)
    causal = (value >= u1 * u1) & (value >= u2 * u2)  # C may depend only on ends that the front reaches before it
    return value if meets & causal else _NONE


@inlined
def planar(u1, u2, squared, along, across):
    """Return the distance of C from a straight front through the segment's ends (Kimmel & Sethian 1998, section 4.1).

    The front's gradient along the segment is (u2 - u1) / length. The ray back from C must meet the segment.
    """
    rise = u2 - u1
    square = squared - rise * rise
    depth = np.sqrt(max(_ZERO, square))
    crossing = along * depth - across * rise
    end = squared * depth
    value = u1 + (rise * along + depth * across) / squared
    meets = (crossing >= _MARGIN * end) & (crossing <= end) & (square > _ZERO) & (value >= u1) & (value >= u2)
    return value if meets else _NONE


@inlined
def spherical_slot(ua, ub, up, ax, bx, by, px, py):
    """Return the distance of C through a slot (see `stencils`): between A and P, between P and B, or along CA or CP."""
    ex, ey = bx - px, by - py
    near_a = spherical_squared(ua, up, (px - ax) * (px - ax) + py * py, ax * (ax - px), ax * py)
    near_b = spherical_squared(up, ub, ex * ex + ey * ey, -(px * ex + py * ey), px * by - py * bx)
    through = np.sqrt(min(near_b, near_a))
    along = ua + ax
    straight = up + np.sqrt(px * px + py * py)
    along = min(straight, along)
    return min(along, through)


@inlined
def planar_slot(ua, ub, up, ax, bx, by, px, py):
    """Return the distance of C through a slot, which is split if its angle is obtuse, as Kimmel & Sethian do.

    CP is an edge of both halves, so the front may also follow CP. The whole triangle is used too, because it is exact
    for a straight front if the values at A and B are known before the value at C. P at the origin means that no front
    crosses AB.
    """
    ex, ey = bx - ax, by
    whole = planar(ua, ub, ex * ex + ey * ey, -ax * ex, ax * by)
    whole = min(ua + ax, whole if (px != _ZERO) | (py != _ZERO) else _NONE)
    ex, ey = bx - px, by - py
    near_a = planar(ua, up, (px - ax) * (px - ax) + py * py, ax * (ax - px), ax * py)
    near_b = planar(up, ub, ex * ex + ey * ey, -(px * ex + py * ey), px * by - py * bx)
    straight = up + np.sqrt(px * px + py * py)
    return min(whole, near_a, near_b, straight) if bx < _ZERO else whole
