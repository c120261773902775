"""unbend: recognise shapes however they bend.

The names below are public. They are imported when first used, so that `import unbend` is fast: it loads no web
framework, no database and no compiler.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from unbend.client import AsyncClient, Client
    from unbend.correspondence.correspondence import Correspondence
    from unbend.correspondence.match import match
    from unbend.correspondence.symmetry import symmetry
    from unbend.correspondence.transfer import transfer, transfer_landmarks
    from unbend.embedding.dimension import effective_dimension, representation_errors
    from unbend.embedding.embed import Embedding, embed
    from unbend.errors import UnbendError
    from unbend.geodesics.contours import iso_contours
    from unbend.geodesics.distances import geodesic_distances, geodesic_matrix
    from unbend.geodesics.paths.shortest import geodesic_path
    from unbend.geodesics.sampling import farthest_point_sampling
    from unbend.geodesics.voronoi import VoronoiDiagram, geodesic_voronoi
    from unbend.library import Library
    from unbend.library.computed import compute_file
    from unbend.local.key_points import key_points
    from unbend.local.signatures import LocalSignatures, local_signatures
    from unbend.matching.measures import compare
    from unbend.matching.partial import compare_parts
    from unbend.mesh.policy import MeshPolicy
    from unbend.mesh.read import read_mesh
    from unbend.mesh.surface import Surface
    from unbend.render.picture import render_picture
    from unbend.render.request import PictureRequest
    from unbend.signature.canonical_form import CanonicalForm, canonical_form
    from unbend.signature.files import load_signature, save_signature
    from unbend.signature.flattening import Flattening, flatten
    from unbend.signature.parameters import Parameters
    from unbend.signature.pipeline import compute_signature
    from unbend.signature.signature import Signature

_MODULES = {
    "AsyncClient": "unbend.client",
    "CanonicalForm": "unbend.signature.canonical_form",
    "Client": "unbend.client",
    "Correspondence": "unbend.correspondence.correspondence",
    "Embedding": "unbend.embedding.embed",
    "Flattening": "unbend.signature.flattening",
    "Library": "unbend.library",
    "LocalSignatures": "unbend.local.signatures",
    "MeshPolicy": "unbend.mesh.policy",
    "Parameters": "unbend.signature.parameters",
    "PictureRequest": "unbend.render.request",
    "Signature": "unbend.signature.signature",
    "Surface": "unbend.mesh.surface",
    "UnbendError": "unbend.errors",
    "canonical_form": "unbend.signature.canonical_form",
    "compare": "unbend.matching.measures",
    "VoronoiDiagram": "unbend.geodesics.voronoi",
    "compare_parts": "unbend.matching.partial",
    "compute_file": "unbend.library.computed",
    "compute_signature": "unbend.signature.pipeline",
    "effective_dimension": "unbend.embedding.dimension",
    "embed": "unbend.embedding.embed",
    "farthest_point_sampling": "unbend.geodesics.sampling",
    "flatten": "unbend.signature.flattening",
    "geodesic_distances": "unbend.geodesics.distances",
    "geodesic_matrix": "unbend.geodesics.distances",
    "geodesic_path": "unbend.geodesics.paths.shortest",
    "geodesic_voronoi": "unbend.geodesics.voronoi",
    "iso_contours": "unbend.geodesics.contours",
    "key_points": "unbend.local.key_points",
    "load_signature": "unbend.signature.files",
    "local_signatures": "unbend.local.signatures",
    "match": "unbend.correspondence.match",
    "read_mesh": "unbend.mesh.read",
    "render_picture": "unbend.render.picture",
    "representation_errors": "unbend.embedding.dimension",
    "save_signature": "unbend.signature.files",
    "symmetry": "unbend.correspondence.symmetry",
    "transfer": "unbend.correspondence.transfer",
    "transfer_landmarks": "unbend.correspondence.transfer",
}

__version__ = "0.1.0"

__all__ = [
    "AsyncClient",
    "CanonicalForm",
    "Client",
    "Correspondence",
    "Embedding",
    "Flattening",
    "Library",
    "LocalSignatures",
    "MeshPolicy",
    "Parameters",
    "PictureRequest",
    "Signature",
    "Surface",
    "UnbendError",
    "VoronoiDiagram",
    "canonical_form",
    "compare",
    "compare_parts",
    "compute_file",
    "compute_signature",
    "effective_dimension",
    "embed",
    "farthest_point_sampling",
    "flatten",
    "geodesic_distances",
    "geodesic_matrix",
    "geodesic_path",
    "geodesic_voronoi",
    "iso_contours",
    "key_points",
    "load_signature",
    "local_signatures",
    "match",
    "read_mesh",
    "render_picture",
    "representation_errors",
    "save_signature",
    "symmetry",
    "transfer",
    "transfer_landmarks",
]


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module 'unbend' has no attribute {name!r}")
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
