"""The one place that says how numeric kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on first use, keep the machine code on disk, and run it without the GIL.

    Floating point stays strict (no fastmath), so that results do not depend on how a loop was vectorised.
    """
    return cast("Callable[P, R]", numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as a part of the kernels that call it."""
    return cast("Callable[P, R]", numba.njit(cache=True, nogil=True, inline="always", error_model="numpy")(function))
