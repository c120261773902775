"""Progress of a computation: its stage, the share that is done, and details."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

Stage = Literal["starting", "reading", "repairing", "sampling", "geodesics", "embedding", "describing"]
"""A stage of a running job."""

STAGES: Final[tuple[Stage, ...]] = (
    "starting", "reading", "repairing", "sampling", "geodesics", "embedding", "describing",
)  # fmt: skip
"""The stages of a running job, in order."""


@dataclass(frozen=True)
class Progress:
    """The progress of a computation at one moment."""

    stage: Stage
    share: float = 0.0
    """Share of the whole computation that is done, 0 to 1."""
    detail: Mapping[str, float] = field(default_factory=dict)
    """Details of the stage: `sample` of `samples`, `row` of `rows`, or `iteration` and its `stress`."""


ProgressCallback = Callable[[Progress], None]


def ignore(_progress: Progress) -> None:
    """Ignore progress."""
