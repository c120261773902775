"""Analytic surfaces with known isometries, and articulated figures, as ground truth for tests and demos."""

from unbend.mesh.shapes.closed import ellipsoid, sphere, tetrahedron, torus
from unbend.mesh.shapes.collection import DEMO_COUNT, DEMO_LABELS, LabelledShape, demo_shapes
from unbend.mesh.shapes.cones import cone
from unbend.mesh.shapes.curves import TUBE_POSES, SpaceCurve, pose_curve
from unbend.mesh.shapes.figures import FIGURES, figure
from unbend.mesh.shapes.helicoid import helicoid_catenoid
from unbend.mesh.shapes.sheet import PlaneCurve, bend, cylinder, s_bend, sheet, spiral
from unbend.mesh.shapes.tubes import bent_tube, pin_profile, tube, worm_profile

__all__ = [
    "DEMO_COUNT",
    "DEMO_LABELS",
    "FIGURES",
    "TUBE_POSES",
    "LabelledShape",
    "PlaneCurve",
    "SpaceCurve",
    "bend",
    "bent_tube",
    "cone",
    "cylinder",
    "demo_shapes",
    "ellipsoid",
    "figure",
    "helicoid_catenoid",
    "pin_profile",
    "pose_curve",
    "s_bend",
    "sheet",
    "sphere",
    "spiral",
    "tetrahedron",
    "torus",
    "tube",
    "worm_profile",
]
