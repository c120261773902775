"""The transformer for scikit-learn: its vectors, its contract with scikit-learn, and its errors."""

from __future__ import annotations

from dataclasses import fields
from inspect import signature as arguments_of

import joblib
import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.utils.estimator_checks import parametrize_with_checks
from sklearn.utils.validation import validate_data

from tests.support.server import DAMAGED, ply, two_rings
from unbend import MeshPolicy, Parameters, compare, compute_signature, read_mesh
from unbend.errors import MeshError, MeshGeometryError, ParameterError
from unbend.matching.measures import VECTOR_MEASURES
from unbend.mesh.shapes import cylinder, ellipsoid, s_bend, sheet, spiral, tetrahedron
from unbend.sklearn import SignatureTransformer

GRID = {"columns": 12, "rows": 6}
SHEETS = [sheet(**GRID), cylinder(**GRID), s_bend(**GRID), spiral(**GRID)]
BALLS = [ellipsoid((1.0, wide, wide), subdivisions=2) for wide in (1.0, 0.95, 0.9, 0.85)]
MESHES = SHEETS + BALLS
LABELS = ["sheet"] * 4 + ["ball"] * 4
FEW = {"samples": 40}


class OfNumbers(SignatureTransformer):
    """A transformer of rows of numbers: each becomes a stretched tetrahedron.

    scikit-learn's checks send tables of numbers. They skip every estimator whose tags say that it takes none, so none
    of them would run on the transformer of meshes itself. Here all run, and none is expected to fail.
    """

    def fit(self, X, y=None):  # noqa: ARG002, N803  scikit-learn's names
        return super().fit(self._meshes(X, reset=True))

    def transform(self, X):  # noqa: N803
        return super().transform(self._meshes(X, reset=False))

    def _meshes(self, numbers, *, reset):
        rows = validate_data(self, numbers, reset=reset)
        body = tetrahedron()
        stretches = np.exp(np.tanh(rows @ np.cos(np.outer(np.arange(rows.shape[1]), [1.0, 2.0, 3.0]))))
        return [(body.vertices * stretch, body.faces) for stretch in stretches]

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.no_validation = False
        tags.input_tags.one_d_array, tags.input_tags.two_d_array = False, True
        return tags


@parametrize_with_checks([OfNumbers("moments", samples=4)])
def test_the_transformer_keeps_the_rules_of_scikit_learn(estimator, check):
    check(estimator)


def test_scikit_learn_is_told_that_the_input_is_no_table():
    tags = SignatureTransformer().__sklearn_tags__()
    assert tags.input_tags.one_d_array
    assert not tags.input_tags.two_d_array
    assert not tags.requires_fit


def test_arguments_have_the_names_and_defaults_of_parameters_and_of_the_policy():
    defaults = {
        field.name: field.default
        for kind in (Parameters, MeshPolicy)
        for field in fields(kind)
        if field.name != "scaling"  # no descriptor depends on it
    }
    own = {"measure": "spectrum", "memory": None, "n_jobs": None}
    assert SignatureTransformer().get_params() == defaults | own
    assert all(
        argument.kind is argument.KEYWORD_ONLY
        for argument in [*arguments_of(SignatureTransformer).parameters.values()][1:]
    )


@pytest.mark.parametrize("measure", VECTOR_MEASURES)
def test_distances_of_vectors_are_those_of_the_measure(measure):
    vectors = SignatureTransformer(measure, **FEW).fit_transform(MESHES[2:6])
    signatures = [compute_signature(read_mesh(mesh), FEW) for mesh in MESHES[2:6]]
    expected = [[compare(a, b, measure) for b in signatures] for a in signatures]
    assert np.abs(vectors[:, None] - vectors[None]).sum(axis=2) == pytest.approx(np.array(expected), rel=1e-5, abs=1e-5)
    assert vectors.dtype == np.float64


@pytest.mark.parametrize("measure", VECTOR_MEASURES)
def test_every_coordinate_has_a_name_of_its_own(measure):
    transformer = SignatureTransformer(measure, **FEW)
    names = transformer.get_feature_names_out()
    assert names.dtype == object
    assert len(set(names)) == len(names) == transformer.transform(MESHES[:1]).shape[1]
    assert names[0] == f"{VECTOR_MEASURES[measure].parts[0][0]}0"


def test_meshes_may_be_paths_bytes_surfaces_and_arrays(tmp_path):
    mesh = read_mesh(ply(MESHES[1]))
    path = tmp_path / "sheet.ply"
    path.write_bytes(ply(MESHES[1]))
    with path.open("rb") as file:
        sources = [path, str(path), path.read_bytes(), file, mesh, (mesh.vertices, mesh.faces)]
        vectors = SignatureTransformer(**FEW).fit_transform(sources)
    assert (vectors == vectors[0]).all()
    column = pd.Series([str(path)] * 2, index=["a", "b"])
    assert (SignatureTransformer(**FEW).transform(column) == vectors[0]).all()


def test_the_result_does_not_depend_on_the_number_of_jobs():
    alone = SignatureTransformer(**FEW).fit_transform(MESHES)
    assert (SignatureTransformer(**FEW, n_jobs=2).fit_transform(MESHES) == alone).all()
    assert (SignatureTransformer(**FEW, n_jobs=-1).fit_transform(MESHES[:1]) == alone[:1]).all()


def test_a_nearest_neighbour_finds_the_class_of_a_bent_shape(tmp_path):
    model = make_pipeline(SignatureTransformer(**FEW), KNeighborsClassifier(1, metric="manhattan"))
    train = MESHES[:3] + MESHES[4:7]
    model.fit(train, LABELS[:3] + LABELS[4:7])
    assert model.predict([MESHES[3], MESHES[7]]).tolist() == ["sheet", "ball"]
    joblib.dump(model, tmp_path / "model")
    assert joblib.load(tmp_path / "model").predict([MESHES[3]]).tolist() == ["sheet"]


def test_a_grid_search_chooses_among_measures_and_computes_each_mesh_once(tmp_path):
    model = Pipeline(
        [
            ("signature", SignatureTransformer(**FEW, memory=str(tmp_path))),
            ("nearest", KNeighborsClassifier(1, metric="manhattan")),
        ]
    )
    grid = {"signature__measure": ["spectrum", "moments"], "nearest__n_neighbors": [1, 2]}
    search = GridSearchCV(model, grid, cv=2).fit(MESHES, LABELS)
    assert search.best_score_ == 1.0
    assert len(search.cv_results_["params"]) == 4
    assert len([*tmp_path.rglob("output.pkl")]) == len(MESHES)


def test_a_memory_knows_a_mesh_by_its_content_and_its_parameters(tmp_path):
    path = tmp_path / "mesh.ply"
    transformer = SignatureTransformer(**FEW, memory=str(tmp_path / "memory"))
    path.write_bytes(ply(MESHES[0]))
    first = transformer.fit_transform([path])
    path.write_bytes(ply(MESHES[4]))
    assert (transformer.transform([path]) != first).any()
    path.write_bytes(ply(MESHES[0]))
    assert (transformer.transform([path]) == first).all()
    renamed = path.rename(tmp_path / "renamed.ply")
    kept = [*tmp_path.rglob("metadata.json")]
    assert (transformer.transform([renamed]) == first).all()
    assert [*tmp_path.rglob("metadata.json")] == kept
    assert max(file.stat().st_size for file in kept) < 1000  # not the mesh itself
    path = renamed
    other = clone(transformer).set_params(samples=30).transform([path])
    assert (other == SignatureTransformer(samples=30).transform([path])).all()


def test_vectors_may_be_a_dataframe():
    frame = SignatureTransformer("dimension", **FEW).set_output(transform="pandas").fit_transform(MESHES[:2])
    assert frame.columns.tolist() == [f"dimension{place}" for place in range(7)]
    assert len(frame) == 2


def test_a_copy_has_the_same_arguments_and_the_repr_only_those_that_differ():
    transformer = SignatureTransformer("moments", samples=40)
    assert clone(transformer).get_params() == transformer.get_params()
    assert repr(transformer) == "SignatureTransformer(measure='moments', samples=40)"


@pytest.mark.parametrize(
    ("meshes", "message"),
    [
        ([], "X is empty"),
        ("cat.off", "single mesh"),
        (b"OFF", "single mesh"),
        (MESHES[0], "single mesh"),
        (3, "must be a sequence of meshes, not int"),
        (np.zeros((4, 2)), "several columns"),
        (pd.DataFrame({"path": ["cat.off"]}), "several columns"),
    ],
)
def test_what_is_no_sequence_of_meshes_is_refused(meshes, message):
    for call in (SignatureTransformer().fit, SignatureTransformer().transform):
        with pytest.raises(ParameterError, match=message):
            call(meshes)


@pytest.mark.parametrize("wrong", [{"measure": "rigid"}, {"samples": 3}, {"method": "best"}, {"components": "all"}])
def test_a_wrong_argument_is_refused_by_fit(wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        SignatureTransformer(**wrong).fit(MESHES)


def test_an_unusable_mesh_is_named_by_its_place_and_path(tmp_path):
    path = tmp_path / "broken.off"
    path.write_bytes(DAMAGED)
    with pytest.raises(MeshError, match=r"^X\[1\] \(.*broken\.off\): "):
        SignatureTransformer(**FEW).transform([MESHES[0], str(path)])
    with pytest.raises(ParameterError, match=r"^X\[0\]: int is no mesh"):
        SignatureTransformer(**FEW).transform([3])
    with pytest.raises(OSError, match="missing"):
        SignatureTransformer(**FEW).transform([tmp_path / "missing.off"])


def test_the_policy_applies_and_warnings_are_warnings(tmp_path):
    rings = two_rings(0)
    for memory in (None, str(tmp_path), str(tmp_path)):  # the third time from memory
        with pytest.warns(UserWarning, match=r"^X\[0\]: .*component"):
            SignatureTransformer(**FEW, memory=memory).transform([rings])
    with pytest.raises(MeshGeometryError, match=r"^X\[0\]: "):
        SignatureTransformer(**FEW, components="error").transform([rings])
