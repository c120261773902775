"""Skeletons: trees of rounded-cone bones, and their poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.arrays import Floats, Indices, frozen
from unbend.mesh.shapes.implicit import BlendedCones

Range = tuple[float, float]
Vector = tuple[float, float, float]

BLEND = 0.5
"""Width of the blend of two bones, as a share of the smallest of their four end radii."""

ATTEMPTS = 400
SHRINKING = 0.985
"""Factor of all angles after each rejected pose, so that the poses approach the rest pose, which is valid."""


@dataclass(frozen=True)
class Bone:
    """One rounded cone of a skeleton.

    Parameters
    ----------
    name, parent : str
        The parent comes earlier in the skeleton. The parent of the root is "".
    length : float
        Length of the axis.
    radii : two floats
        Radii at the start and at the end. They differ by less than `length`.
    direction : three floats
        Direction of the axis in the rest pose, in the frame of the figure: x left, y front, z up.
    bend : three ranges
        Limits of the rotation about the x, y and z axes relative to the parent, in degrees. All 0 for a rigid joint.
    at : float, default 1.0
        Start of the bone on the axis of its parent, from 0 to 1.
    """

    name: str
    parent: str
    length: float
    radii: Range
    direction: Vector
    bend: tuple[Range, Range, Range] = ((0, 0), (0, 0), (0, 0))
    at: float = 1.0

    @property
    def rigid(self) -> bool:
        """Whether the joint cannot turn."""
        return not any(limit for axis in self.bend for limit in axis)

    def mirrored(self) -> Bone:
        """Return the mirror image of the bone, x -> -x. "left" in names becomes "right"."""
        x, y, z = self.direction
        about_x, (y_low, y_high), (z_low, z_high) = self.bend
        bend = (about_x, (-y_high, -y_low), (-z_high, -z_low))
        name, parent = (text.replace("left", "right") for text in (self.name, self.parent))
        return Bone(name, parent, self.length, self.radii, (-x, y, z), bend, self.at)


@dataclass(frozen=True)
class Skeleton:
    """Bones, parents before children, the root first."""

    bones: tuple[Bone, ...]

    @cached_property
    def parents(self) -> Indices:
        """Index of each bone's parent, (b,); -1 for the root."""
        index = {bone.name: number for number, bone in enumerate(self.bones)}
        return frozen([index.get(bone.parent, -1) for bone in self.bones], np.int64)

    @cached_property
    def pairs(self) -> Indices:
        """Pairs of bones that blend, (m, 2): parent and child, and rigid siblings. Such pairs cannot collide."""
        found = [(int(parent), child) for child, parent in enumerate(self.parents) if parent >= 0]
        fixed = [number for number, bone in enumerate(self.bones) if bone.rigid]
        found += [(a, b) for a in fixed for b in fixed if a < b and self.parents[a] == self.parents[b] >= 0]
        return frozen(found, np.int64)

    @property
    def skin(self) -> float:
        """Sum of the lateral areas of the bones, roughly the area of the figure."""
        return float(sum(np.pi * sum(bone.radii) * bone.length for bone in self.bones))

    def rest(self) -> BlendedCones:
        """Return the cones of the rest pose."""
        return self.posed(np.zeros((len(self.bones), 3)))

    def posed(self, angles: Floats) -> BlendedCones:
        """Return the cones after turning each joint by angles (b, 3) about x, then y, then z, in degrees."""
        starts, ends = np.zeros((2, len(self.bones), 3))
        turns = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()  # (b, 3, 3)
        for number, (bone, parent) in enumerate(zip(self.bones, self.parents, strict=True)):
            if parent >= 0:
                turns[number] = turns[parent] @ turns[number]
                starts[number] = starts[parent] + bone.at * (ends[parent] - starts[parent])
            direction = np.array(bone.direction) / np.linalg.norm(bone.direction)
            ends[number] = starts[number] + bone.length * turns[number] @ direction
        radii = np.array([bone.radii for bone in self.bones])
        thin = radii.min(axis=1)[self.pairs].min(axis=1)
        return BlendedCones(starts, ends, radii, self.pairs, BLEND * thin)

    def random_pose(self, generator: np.random.Generator, *, clearance: float) -> BlendedCones:
        """Return a pose drawn within the joints' limits, in which no limb comes near another.

        Parameters
        ----------
        generator : numpy.random.Generator
            Source of the angles.
        clearance : float
            Balls (see `_gaps`) of two bones that do not blend, with a gap wider than `clearance` in the rest pose, keep
            a gap of at least half that width or 2 * clearance, whichever is less.
        """
        limits = np.array([bone.bend for bone in self.bones])  # (b, 3, 2)
        at_rest = _gaps(self.rest())
        watched = (at_rest > clearance) & self._may_collide()
        needed = np.minimum(at_rest[watched] / 2, 2 * clearance)
        for attempt in range(ATTEMPTS):
            angles = generator.uniform(limits[..., 0], limits[..., 1]) * SHRINKING**attempt
            cones = self.posed(angles)
            if (_gaps(cones)[watched] >= needed).all():
                return cones
        return self.rest()

    def _may_collide(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Return a mask of the pairs of samples (see `_gaps`) that belong to two bones that do not blend."""
        free = np.ones((len(self.bones),) * 2, bool)
        free[tuple(self.pairs.T)] = free[tuple(self.pairs[:, ::-1].T)] = False
        np.fill_diagonal(free, val=False)
        return np.repeat(np.repeat(free, SAMPLES, axis=0), SAMPLES, axis=1)


SAMPLES = 7
"""Number of balls along each bone that represent the bone when gaps are measured."""


def _gaps(cones: BlendedCones) -> Floats:
    """Return the gaps between balls along the bones, (b * SAMPLES, b * SAMPLES)."""
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    centres = (cones.starts[:, None] + share * (cones.ends - cones.starts)[:, None]).reshape(-1, 3)
    radii = (cones.radii[:, :1] * (1 - share.T) + cones.radii[:, 1:] * share.T).ravel()
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)
    return np.asarray(apart - radii[:, None] - radii, float)
