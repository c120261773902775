"""A transformer for scikit-learn. Only this module imports scikit-learn, which the extra `sklearn` installs."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from os import PathLike
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Singles
from unbend.embedding.embed import Criterion, Method
from unbend.embedding.weighting import Weighting
from unbend.errors import MeshError, ParameterError
from unbend.extras import extra
from unbend.geodesics.distances import Update
from unbend.matching.measures import DEFAULT_MEASURE, VectorMeasure, get_vector_measure
from unbend.mesh.policy import Components, MeshPolicy, Seams
from unbend.mesh.shapes import tetrahedron
from unbend.mesh.sources import MeshBytes, MeshSource, bytes_of
from unbend.signature.from_file import signature_of_file
from unbend.signature.parameters import Dimensions, FirstSample, Parameters, Samples
from unbend.signature.pipeline import compute_signature
from unbend.signature.signature import ALGORITHM_VERSION

with extra("sklearn"):
    from joblib import Memory, Parallel, delayed, effective_n_jobs
    from sklearn.base import BaseEstimator, TransformerMixin
    from sklearn.utils import Tags
    from sklearn.utils.validation import check_memory

_PARAMETERS: Final = (
    "samples", "dimensions", "method", "update", "first_sample", "starts", "seed", "weights", "criterion", "threshold",
    "tolerance",
)  # fmt: skip
"""The fields of `Parameters` that the descriptors depend on; they always refer to area 1, whatever the scaling."""

_POLICY: Final = ("components", "max_vertices", "smooth", "seams")

_Described = tuple[Mapping[str, Floats], Sequence[str]]


class SignatureTransformer(TransformerMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """Turns meshes into the vectors that a measure compares, for the estimators of scikit-learn.

    The measures of unbend are sums of absolute differences (L1), so `metric="manhattan"` fits its vectors: with it, a
    nearest neighbour is the nearest shape of `unbend.compare`. The coordinates have weights already. Do not standardise
    them for such an estimator.

    It learns nothing from the meshes, so `transform` needs no `fit`. In a search over many candidates and folds, give
    `memory`: then each mesh is computed once for all measures, folds and candidates of the same parameters.

    Parameters
    ----------
    measure : str, default "spectrum"
        A measure that compares vectors: "spectrum", "combined", "moments", "distribution", "dimension" or
        "surface_moments".
    samples, dimensions, method, update, first_sample, starts, seed, weights, criterion, threshold, tolerance
        See `unbend.Parameters`, which has the same defaults.
    components, max_vertices, smooth, seams
        See `unbend.MeshPolicy`, which has the same defaults.
    memory : str or joblib.Memory, optional
        Folder that keeps descriptors, by the content of a mesh. By default nothing is kept. joblib reads the folder by
        pickle, so it must be your own.
    n_jobs : int, optional
        Meshes computed at a time, in threads; 1 by default, -1 for all cores. The result does not depend on it.

    Examples
    --------
    >>> from sklearn.neighbors import KNeighborsClassifier
    >>> from sklearn.pipeline import make_pipeline
    >>> from unbend.mesh.shapes import cylinder, sheet, sphere
    >>> model = make_pipeline(SignatureTransformer(samples=50), KNeighborsClassifier(1, metric="manhattan"))
    >>> model = model.fit([sheet(columns=20, rows=10), sphere(subdivisions=2)], ["sheet", "sphere"])
    >>> str(model.predict([cylinder(columns=20, rows=10)])[0])  # a bent sheet
    'sheet'
    """

    def __init__(
        self,
        measure: str = DEFAULT_MEASURE,
        *,
        samples: Samples = 300,
        dimensions: Dimensions = 3,
        method: Method = "least_squares",
        update: Update = "spherical",
        first_sample: FirstSample = "end",
        starts: int = 0,
        seed: int = 0,
        weights: Weighting = "equal",
        criterion: Criterion = "error",
        threshold: float = 0.05,
        tolerance: float = 0.02,
        components: Components = "largest",
        max_vertices: int | None = None,
        smooth: int = 0,
        seams: Seams = "stitch",
        memory: str | Memory | None = None,
        n_jobs: int | None = None,
    ) -> None:
        self.measure = measure
        self.samples = samples
        self.dimensions = dimensions
        self.method = method
        self.update = update
        self.first_sample = first_sample
        self.starts = starts
        self.seed = seed
        self.weights = weights
        self.criterion = criterion
        self.threshold = threshold
        self.tolerance = tolerance
        self.components = components
        self.max_vertices = max_vertices
        self.smooth = smooth
        self.seams = seams
        self.memory = memory
        self.n_jobs = n_jobs

    def fit(self, X: Iterable[MeshSource], y: object = None) -> Self:  # noqa: N803, ARG002  scikit-learn's names
        """Check the arguments and that there are meshes; nothing is computed.

        Raises
        ------
        ParameterError
            If an argument is out of its range, or `X` is not a sequence of meshes.
        """
        _sources(X)
        self._checked()
        return self

    def transform(self, X: Iterable[MeshSource]) -> Floats:  # noqa: N803
        """Return the vectors of meshes.

        Parameters
        ----------
        X : sequence of n bytes, str, Path, binary files, Surfaces, pairs of arrays, or mesh objects
            As for `unbend.read_mesh`.

        Returns
        -------
        (n, d) float64
            With the precision of single floats, as in a library.

        Raises
        ------
        MeshError
            If a mesh cannot be used; the message begins with its place, such as `X[3]`.
        ParameterError
            If an argument is out of its range, or `X` is not a sequence of meshes.
        OSError
            If a path cannot be read.

        Warns
        -----
        UserWarning
            If a signature has a warning: a reason why it may be wrong.
        """
        sources = _sources(X)
        measure, parameters, policy = self._checked()
        jobs = effective_n_jobs(self.n_jobs)
        threads = max(1, jobs // len(sources))  # a kernel's threads help only where there are fewer meshes than jobs
        describe = check_memory(self.memory).cache(_descriptors, ignore=["threads"])
        rows = Parallel(n_jobs=jobs, prefer="threads")(
            delayed(_vector)(measure, describe, place, source, parameters, policy, threads)
            for place, source in enumerate(sources)
        )
        return np.array(rows, np.float64)

    def get_feature_names_out(self, input_features: object = None) -> NDArray[np.object_]:  # noqa: ARG002
        """Return the names of the d coordinates, (d,), such as `spectrum0`; `input_features` is ignored."""
        lengths, (measure, _, _) = _lengths(), self._checked()
        names = [f"{part}{place}" for part, _ in measure.parts for place in range(lengths[part])]
        return np.array(names, object)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.requires_fit = False
        tags.no_validation = True
        tags.input_tags.one_d_array = True
        tags.input_tags.two_d_array = False
        tags.input_tags.string = True
        tags.transformer_tags.preserves_dtype = []
        return tags

    def __sklearn_is_fitted__(self) -> bool:
        return True

    def _checked(self) -> tuple[VectorMeasure, Parameters, MeshPolicy]:
        """Return the measure, the parameters and the policy; ParameterError if an argument is out of its range."""
        return (
            get_vector_measure(self.measure),
            Parameters(**{name: getattr(self, name) for name in _PARAMETERS}),
            MeshPolicy(**{name: getattr(self, name) for name in _POLICY}),
        )


def _sources(meshes: Any) -> list[Any]:
    """Return meshes as a list; ParameterError if they are a single mesh, a table, or none."""
    if isinstance(meshes, str | bytes | PathLike) or hasattr(meshes, "vertices") or hasattr(meshes, "points"):
        raise ParameterError("X is a single mesh: give a sequence of meshes, such as [mesh]")
    if getattr(meshes, "ndim", 1) != 1:
        raise ParameterError("X has several columns: give a sequence of meshes, such as a single column of paths")
    try:
        sources = list(meshes)
    except TypeError:
        raise ParameterError(f"X must be a sequence of meshes, not {type(meshes).__name__}") from None
    if not sources:
        raise ParameterError("X is empty: give at least one mesh")
    return sources


def _vector(
    measure: VectorMeasure,
    describe: Callable[..., _Described],
    place: int,
    source: MeshSource,
    parameters: Parameters,
    policy: MeshPolicy,
    threads: int,
) -> Singles:
    try:
        file = bytes_of(source)
        content = MeshBytes(file.data, f"mesh.{file.file_type}")  # whatever its name
        descriptors, doubts = describe(content, parameters, policy, ALGORITHM_VERSION, threads)
    except (MeshError, ParameterError) as error:
        raise type(error)(f"{_named(place, source)}: {error}") from error
    for doubt in doubts:
        warnings.warn(f"{_named(place, source)}: {doubt}", stacklevel=2)
    return measure.vector(descriptors)


def _named(place: int, source: MeshSource) -> str:
    return f"X[{place}] ({source})" if isinstance(source, str | PathLike) else f"X[{place}]"


def _descriptors(
    file: MeshBytes, parameters: Parameters, policy: MeshPolicy, _version: str, threads: int
) -> _Described:
    """Return the descriptors of the signature of a file, and its warnings.

    A memory keeps them by these arguments. It also stores the arguments' `repr`, which must be short for that.
    """
    found = signature_of_file(file.data, parameters, policy, file_type=file.file_type, threads=threads).signature
    return found.descriptors, found.warnings


@cache
def _lengths() -> dict[str, int]:
    """Return the lengths of descriptors; those that vectors contain are of the same length for all shapes."""
    smallest = compute_signature(tetrahedron(), Parameters(samples=4), threads=1)
    return {name: len(values) for name, values in smallest.descriptors.items()}
