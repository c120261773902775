"""The skeletons of the figures: lengths in arbitrary units, angles in degrees, x left, y front, z up."""

from __future__ import annotations

from unbend.mesh.shapes.skeleton import Bone, Range, Skeleton, Vector

STILL: Range = (0, 0)
UP: Vector = (0, 0, 1)
DOWN: Vector = (0, 0, -1)
FRONT: Vector = (0, 1, 0)
LEFT: Vector = (1, 0, 0)


def _with_right_side(*bones: Bone) -> tuple[Bone, ...]:
    """Return the bones, and the mirror image of those whose name says "left"."""
    return bones + tuple(bone.mirrored() for bone in bones if "left" in bone.name)


def _biped() -> Skeleton:
    slope: Vector = (1, 0, -0.6)
    return Skeleton(
        _with_right_side(
            Bone("pelvis", "", 0.12, (0.13, 0.125), UP),
            Bone("chest", "pelvis", 0.36, (0.125, 0.16), UP, ((-30, 15), (-15, 15), (-30, 30))),
            Bone("neck", "chest", 0.2, (0.07, 0.065), UP),
            Bone("head", "neck", 0.13, (0.1, 0.12), UP, ((-30, 25), (-20, 20), (-40, 40))),
            Bone("left shoulder", "chest", 0.17, (0.09, 0.075), (1, 0, -0.1), at=0.95),
            Bone("left upper arm", "left shoulder", 0.3, (0.07, 0.06), slope, ((-40, 40), (-75, 25), (-25, 60))),
            Bone("left forearm", "left upper arm", 0.27, (0.06, 0.05), slope, (STILL, (-20, 20), (0, 105))),
            Bone("left hand", "left forearm", 0.1, (0.055, 0.06), slope),
            Bone("left hip", "pelvis", 0.11, (0.11, 0.1), (1, 0, -0.3), at=0.0),
            Bone("left thigh", "left hip", 0.42, (0.1, 0.075), (0.18, 0, -1), ((-30, 80), (-30, 5), (-20, 20))),
            Bone("left shin", "left thigh", 0.42, (0.075, 0.058), (0.05, 0, -1), ((-100, 0), STILL, STILL)),
            Bone("left foot", "left shin", 0.17, (0.062, 0.055), (0.1, 1, -0.15), ((-20, 20), STILL, STILL)),
        )
    )


def _quadruped(*, leg: float, girth: float, neck: tuple[float, float], tail: float) -> Skeleton:
    """Return a four-legged animal; `neck` is the length and the slope of the neck, `leg` half the length of a leg."""
    neck_length, neck_slope = neck
    hip: Vector = (1, 0, -1.1)
    nod = ((-25, 30), (-10, 10), (-25, 25))
    wag = ((-30, 30), STILL, (-40, 40))
    limb = dict[str, Range](upper=(0.085, 0.065), lower=(0.06, 0.05), foot=(0.055, 0.055))
    return Skeleton(
        _with_right_side(
            Bone("rump", "", 0.36, (girth, girth * 0.92), FRONT),
            Bone("chest", "rump", 0.38, (girth * 0.92, girth * 1.08), FRONT, ((-14, 14), (-8, 8), (-16, 16))),
            Bone("neck", "chest", neck_length / 2, (girth * 0.72, 0.095), (0, 1, neck_slope), nod),
            Bone("nape", "neck", neck_length / 2, (0.095, 0.08), (0, 1, neck_slope), nod),
            Bone("head", "nape", 0.24, (0.1, 0.065), (0, 1, -0.45), ((-30, 30), STILL, (-30, 30))),
            Bone("tail", "rump", tail / 2, (0.055, 0.05), (0, -1, -0.25), wag, at=0.0),
            Bone("tail tip", "tail", tail / 2, (0.05, 0.045), (0, -1, -0.25), wag),
            Bone("left shoulder", "chest", 0.19, (0.1, 0.09), hip, at=0.85),
            Bone("left arm", "left shoulder", leg, limb["upper"], DOWN, ((-40, 40), (-12, 5), STILL)),
            Bone("left foreleg", "left arm", leg, limb["lower"], DOWN, ((-70, 0), STILL, STILL)),
            Bone("left hoof", "left foreleg", 0.07, limb["foot"], (0, 1, -0.3)),
            Bone("left hip", "rump", 0.19, (0.105, 0.095), hip, at=0.1),
            Bone("left thigh", "left hip", leg, limb["upper"], (0, -0.1, -1), ((-35, 45), (-12, 5), STILL)),
            Bone("left shank", "left thigh", leg, limb["lower"], (0, 0.05, -1), ((-60, 5), STILL, STILL)),
            Bone("left paw", "left shank", 0.07, limb["foot"], (0, 1, -0.3)),
        )
    )


def _hand() -> Skeleton:
    """Return a left hand, its palm to the front, the thumb to the left, on a stub of the forearm."""
    fingers = (
        ("index", 0.27, 0.37, 0.28, 1.0),
        ("middle", 0.085, 0.39, 0.31, 1.0),
        ("ring", -0.095, 0.37, 0.28, 1.0),
        ("little", -0.265, 0.33, 0.22, 0.9),
    )
    curl: Range = (-5, 65)
    bones = [Bone("wrist", "", 0.3, (0.13, 0.13), UP)]
    for name, lean, palm, length, girth in fingers:
        ray: Vector = (lean / palm * 0.85, 0, 1)
        bones += [
            Bone(f"{name} palm", "wrist", palm, (0.1, 0.085), ray),
            Bone(f"{name} 1", f"{name} palm", length, (0.072 * girth, 0.067 * girth), ray, _curl(curl, 6)),
            Bone(f"{name} 2", f"{name} 1", length * 0.7, (0.067 * girth, 0.062 * girth), ray, _curl((0, 75), 0)),
            Bone(f"{name} 3", f"{name} 2", length * 0.5, (0.062 * girth, 0.058 * girth), ray, _curl((0, 45), 0)),
        ]
    thumb: Vector = (1, 0.15, 0.75)
    bones += [
        Bone("thumb palm", "wrist", 0.24, (0.11, 0.09), (1, 0.2, 0.7), at=0.8),
        Bone("thumb 1", "thumb palm", 0.2, (0.085, 0.075), thumb, ((-25, 25), (-25, 25), (-5, 40))),
        Bone("thumb 2", "thumb 1", 0.16, (0.075, 0.065), thumb, (STILL, (-40, 5), (0, 30))),
    ]
    return Skeleton(tuple(bones))


def _curl(flexion: Range, spread: float) -> tuple[Range, Range, Range]:
    """Return the limits of a finger's joint: fingers point up, so they curl to the front about -x."""
    return ((-flexion[1], -flexion[0]), (-spread, spread), STILL)


def _spider() -> Skeleton:
    bones = [
        Bone("body", "", 0.42, (0.2, 0.17), FRONT),
        Bone("waist", "body", 0.22, (0.11, 0.11), (0, -1, 0.1), at=0.0),
        Bone("abdomen", "waist", 0.3, (0.24, 0.3), (0, -1, 0.25), ((-20, 15), STILL, (-18, 18))),
    ]
    for number, (lean, at) in enumerate(((1.2, 1.0), (0.36, 0.72), (-0.3, 0.38), (-1.0, 0.1)), start=1):
        side: Vector = (1, lean, 0)
        swing = ((-10, 10), (-25, 15), (-11, 11))
        bones += [
            Bone(f"left coxa {number}", "body", 0.3, (0.095, 0.085), side, at=at),
            Bone(f"left femur {number}", f"left coxa {number}", 0.44, (0.085, 0.08), (1, lean, 0.9), swing),
            Bone(
                f"left tibia {number}",
                f"left femur {number}",
                0.62,
                (0.08, 0.068),
                (1, lean, -1.5),
                (STILL, (-30, 25), STILL),
            ),
        ]
    return Skeleton(_with_right_side(*bones))


def _bird() -> Skeleton:
    """Return a wading bird with spread wings; its feathers are rigid cones that blend into a sheet."""
    back: Vector = (0.12, -1, 0)
    feathers = [
        Bone(f"left {bone} feather {number}", f"left {bone}", length, (0.068, 0.064), back, at=at)
        for bone, ats in (("wing", (0.25, 0.45, 0.65)), ("pinion", (0.35, 0.55, 0.75, 0.95)))
        for number, (at, length) in enumerate(zip(ats, (0.3, 0.32, 0.31, 0.28), strict=False))
    ]
    neck = ((-20, 25), (-15, 15), (-25, 25))
    return Skeleton(
        _with_right_side(
            Bone("body", "", 0.42, (0.15, 0.18), (0, 1, 0.25)),
            Bone("neck", "body", 0.26, (0.085, 0.065), (0, 0.7, 1), neck),
            Bone("nape", "neck", 0.26, (0.065, 0.06), (0, 0.15, 1), neck),
            Bone("head", "nape", 0.1, (0.09, 0.085), (0, 1, 0.1), ((-25, 25), STILL, (-30, 30))),
            Bone("beak", "head", 0.24, (0.06, 0.042), (0, 1, -0.15)),
            Bone("tail", "body", 0.34, (0.1, 0.07), (0, -1, 0.1), ((-15, 20), STILL, (-12, 12)), at=0.0),
            Bone("left shoulder", "body", 0.17, (0.085, 0.08), (1, 0, 0.35), at=0.8),
            Bone("left wing", "left shoulder", 0.42, (0.07, 0.062), LEFT, ((-15, 15), (-50, 35), (-10, 10))),
            Bone("left pinion", "left wing", 0.5, (0.062, 0.05), LEFT, (STILL, (-15, 40), (-12, 4))),
            *feathers,
            Bone("left hip", "body", 0.12, (0.09, 0.08), (1, 0, -1), at=0.3),
            Bone("left leg", "left hip", 0.36, (0.062, 0.055), (0.05, 0.1, -1), ((-30, 35), (-10, 3), STILL)),
            Bone("left shank", "left leg", 0.36, (0.055, 0.05), (0.02, -0.15, -1), ((-10, 55), STILL, STILL)),
            Bone("left foot", "left shank", 0.15, (0.05, 0.05), (0.1, 1, -0.1), ((-20, 20), STILL, STILL)),
        )
    )


SKELETONS: dict[str, Skeleton] = {
    "biped": _biped(),
    "quadruped": _quadruped(leg=0.3, girth=0.19, neck=(0.3, 0.9), tail=0.5),
    "giraffe": _quadruped(leg=0.5, girth=0.17, neck=(0.95, 2.2), tail=0.24),
    "hand": _hand(),
    "spider": _spider(),
    "bird": _bird(),
}
"""The skeleton of every kind of figure."""
