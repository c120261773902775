"""Fixtures that make signatures from given points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from unbend.signature.parameters import Parameters
from unbend.signature.signature import Signature


@pytest.fixture(scope="session")
def signature_of() -> Callable[..., Signature]:
    """A function that makes a signature from points, by default with equal weights; other fields are placeholders."""

    def of(points: np.ndarray, weights: np.ndarray | None = None) -> Signature:
        shares = np.ones(len(points)) if weights is None else np.asarray(weights)
        return Signature(
            points=points,
            faces=np.empty((0, 3)),
            samples=np.arange(len(points)),
            weights=shares / shares.sum(),
            scale=1.0,
            stress=0.0,
            asymmetry=0.0,
            descriptors={},
            parameters=Parameters(),
        )

    return of


@pytest.fixture(scope="session")
def cloud(signature_of: Callable[..., Signature]) -> Callable[..., Signature]:
    """A function that makes a random signature from a seed: skewed along every axis, with decreasing extents."""

    def of(seed: int, count: int = 50, axes: int = 3) -> Signature:
        random = np.random.default_rng(seed)
        spread = 0.75 ** np.arange(axes)
        return signature_of(random.gamma(2.0, size=(count, axes)) * spread, random.uniform(0.1, 1.0, count))

    return of
