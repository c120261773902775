"""One API near and far: the same tests against a library, a client and an asynchronous client."""

from __future__ import annotations

import dataclasses
import inspect
import io
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.support.clients import make_client
from tests.support.server import DAMAGED, SAMPLES, Server, ply, small_mesh
from unbend import (
    AsyncClient,
    Client,
    Library,
    MeshPolicy,
    Parameters,
    Surface,
    compute_signature,
    match,
    read_mesh,
    transfer,
)
from unbend.errors import MeshFormatError, MeshReadError, NotFoundError, ParameterError, UnsuitedError
from unbend.mesh.shapes import ellipsoid
from unbend.results import (
    AddedShape,
    EvaluationResult,
    PartRelation,
    PointMap,
    Ranking,
    RetrievalMetrics,
    ShapeMap,
    ShapePage,
    ShapeRecord,
)

KINDS = ("library", "sync", "async")


@pytest.fixture(scope="module")
def own_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with Server(tmp_path_factory.mktemp("far"), workers=1, parts=True) as running:
        yield running


@pytest.fixture
def near(own_server: Server) -> Iterator[Library]:
    """The library of the server, opened as a file, and empty."""
    with Library(str(own_server.library)) as library:
        for shape in library:
            library.remove(shape.id)
        yield library


@pytest.fixture(params=KINDS)
def kind(request) -> str:
    return request.param


@pytest.fixture
def api(kind: str, near: Library, own_server: Server) -> Iterator[Any]:
    if kind == "library":
        yield near
    else:
        made, close = make_client(kind, own_server.url)
        yield made
        close()


@pytest.fixture
def far(own_server: Server) -> Iterator[Client]:
    with Client(own_server.url) as client:
        yield client


def egg(height: float) -> Surface:
    body = ellipsoid((1.0, 0.7, 0.4), subdivisions=2)
    bumps = 1 + height * np.exp(-((body.vertices - (0.9, 0.2, 0.1)) ** 2).sum(axis=1) / 0.1)
    return Surface(body.vertices * bumps[:, None], body.faces)


def add_classes(api: Any) -> list[AddedShape]:
    meshes = [("ring", small_mesh(number)) for number in range(3)] + [("egg", ply(egg(h))) for h in (0.3, 0.4, 0.5)]
    return [
        api.add(data, name=f"{label}-{number}", label=label, parameters=SAMPLES)
        for number, (label, data) in enumerate(meshes)
    ]


def test_a_mesh_becomes_a_shape(api, tmp_path):
    path = tmp_path / "my ring.ply"
    path.write_bytes(small_mesh(0))
    shape = api.add(path, label="torus", metadata={"n": 1}, parameters=SAMPLES)
    assert isinstance(shape, AddedShape)
    assert (shape.name, shape.label, shape.metadata, shape.is_new) == ("my ring", "torus", {"n": 1}, True)
    assert (shape.parameters, shape.policy) == (Parameters(**SAMPLES), MeshPolicy())
    assert shape.created_at.tzinfo is not None
    found = api.get(shape.id)
    assert type(found) is ShapeRecord
    assert found == shape
    assert api.mesh(shape.id) == small_mesh(0)
    expected = compute_signature(read_mesh(small_mesh(0)), SAMPLES)
    signature = api.signature(shape.id)
    assert np.array_equal(signature.points, expected.points)
    assert (signature.parameters, signature.version) == (expected.parameters, expected.version)
    with pytest.raises(dataclasses.FrozenInstanceError):
        shape.name = "other"


@pytest.mark.parametrize("form", ["path", "text", "bytes", "file", "surface", "arrays"])
def test_every_form_of_a_mesh_is_taken(api, form, tmp_path):
    data = small_mesh(1)
    path = tmp_path / "ring.ply"
    path.write_bytes(data)
    surface = read_mesh(data)
    sources = {
        "path": path, "text": str(path), "bytes": data, "file": io.BytesIO(data), "surface": surface,
        "arrays": (surface.vertices, surface.faces),
    }  # fmt: skip
    shape = api.add(sources[form], parameters=Parameters(**SAMPLES), policy=MeshPolicy(seams="keep"))
    expected = compute_signature(surface, SAMPLES)
    assert np.allclose(api.signature(shape.id).points, expected.points)
    sources["file"].seek(0)
    ranking = api.rank(sources[form], parameters=SAMPLES, policy={"seams": "keep"})
    assert (ranking.shapes[0].id, ranking.shapes[0].distance) == (shape.id, 0.0)


def test_a_known_file_says_what_it_kept_and_what_it_took(api):
    metadata = {"size": (1, 2), 3: {4: 5}}
    first = api.add(small_mesh(2), name="first", metadata=metadata, parameters=SAMPLES)
    assert first.metadata == {"size": [1, 2], "3": {"4": 5}}
    again = api.add(small_mesh(2), metadata=metadata, parameters=SAMPLES)
    assert (again.id, again.ignored) == (first.id, ())
    kept = api.add(small_mesh(2), name="second", label="ring", metadata=metadata, parameters=SAMPLES)
    assert (kept.id, kept.name, kept.is_new) == (first.id, "first", False)
    assert (kept.ignored, kept.updated) == (("label", "name"), ())
    taken = api.add(small_mesh(2), name="second", label="ring", parameters=SAMPLES, if_known="update")
    assert (taken.id, taken.name, taken.label, taken.is_new) == (first.id, "second", "ring", False)
    assert (taken.ignored, taken.updated) == ((), ("label", "name"))


def test_shapes_are_listed_counted_and_found(api):
    assert (api.count(), list(api)) == (0, [])
    ids = [
        api.add(small_mesh(number), name=str(number), label="ring", parameters={"samples": 5}).id for number in (4, 3)
    ]
    other = api.add(small_mesh(5), name="other", parameters={"samples": 5}).id
    assert api.count() == 3
    assert [shape.id for shape in api] == [*ids, other]
    assert [shape.id for shape in api.iter_shapes(label="ring", order="newest")] == ids[::-1]
    assert [shape.id for shape in api.iter_shapes(name="OTH")] == [other]
    page = api.page(limit=2)
    assert isinstance(page, ShapePage)
    rest = api.page(cursor=page.next_cursor)
    assert ([shape.id for shape in page.items + rest.items], rest.next_cursor) == ([*ids, other], None)
    assert api.labels() == {"ring": 2}
    assert (api.has(other), api.has("0" * 32)) == (True, False)


def test_length_membership_and_truth(near, far):
    shape = near.add(small_mesh(6), parameters=SAMPLES)
    for api in (near, far):
        assert (len(api), shape.id in api, "0" * 32 in api, 3 in api) == (1, True, False, False)
        api.remove(shape.id)
        assert (len(api), bool(api)) == (0, True)
        near.add(small_mesh(6), parameters=SAMPLES)
        shape = next(iter(near))


def test_a_shape_is_changed_and_removed(api):
    shape = api.add(small_mesh(7), label="ring", parameters=SAMPLES)
    changed = api.change(shape.id, name="x", label=None, metadata={"a": [1]})
    assert (changed.name, changed.label, changed.metadata) == ("x", None, {"a": [1]})
    assert changed == api.get(shape.id)
    assert changed.revision > shape.revision
    with pytest.raises(ParameterError):
        api.change(shape.id, name="")
    with pytest.raises(ParameterError):
        api.change(shape.id, sha256="0")
    api.remove(shape.id)
    for call in (api.get, api.remove, api.mesh, api.signature, api.rank, api.change):
        with pytest.raises(NotFoundError, match=shape.id):
            call(shape.id)


def test_queries_rank_classes_and_shapes(api, tmp_path):
    shapes = add_classes(api)
    query = tmp_path / "query.ply"
    query.write_bytes(ply(egg(0.45)))
    ranking = api.rank(str(query), k=2, parameters=SAMPLES)
    assert isinstance(ranking, Ranking)
    assert (ranking.measure, ranking.classes[0].label, len(ranking.shapes)) == ("spectrum", "egg", 2)
    assert {match.label for match in ranking.shapes} == {"egg"}
    assert api.nearest(query, 2, parameters=SAMPLES) == ranking.shapes
    assert api.classify(query, parameters=SAMPLES) == ranking.classes
    stored = api.rank(shapes[0].id, measure="moments", classifier="vote", k=9)
    assert (stored.measure, len(stored.shapes), stored.classes[0].label) == ("moments", 5, "ring")
    assert shapes[0].id not in {match.id for match in stored.shapes}
    with pytest.raises(NotFoundError, match="nobody"):
        api.rank("nobody")
    with pytest.raises(ParameterError):
        api.rank(shapes[0].id, measure="nothing")
    with pytest.raises(ParameterError):
        api.rank(query, k=0)


def test_a_piece_is_found_in_its_whole(api):
    shapes = add_classes(api)
    body = egg(0.4)
    kept = body.faces[(body.vertices[body.faces] @ (0.5, 0.7, 0.3)).mean(axis=1) > -0.1]
    used, corners = np.unique(kept, return_inverse=True)
    piece = Surface(body.vertices[used], corners.reshape(-1, 3))
    first = api.rank(piece, measure="partial", parameters=SAMPLES).shapes[0]
    assert first.label == "egg"
    assert isinstance(first.part, PartRelation)
    assert (first.part.relation, len(first.part.place)) == ("part", 3)
    assert 0.3 < first.part.covered < 0.9
    assert api.rank(shapes[0].id).shapes[0].part is None


def test_points_are_matched(api):
    a, b = egg(0.5), egg(0.4)
    ids = [api.add(ply(surface), parameters=SAMPLES).id for surface in (a, b)]
    found = api.match(*ids, samples=60)
    assert isinstance(found, PointMap)
    read_a, read_b = (read_mesh(ply(surface)) for surface in (a, b))
    expected = match(read_a, read_b, samples=60)
    places = np.einsum("nc,nck->nk", found.barycentric, read_b.vertices[found.corners])
    assert places == pytest.approx(transfer(expected, read_b.vertices))
    assert found.vertices.tolist() == expected.vertices.tolist()
    assert found.matched.all()
    assert (found.residual, found.oriented, found.ambiguous) == (
        expected.residual,
        expected.oriented,
        expected.ambiguous,
    )
    with pytest.raises(ParameterError):
        api.match(*ids, samples=3)


def test_the_library_is_mapped_and_evaluated(api):
    shapes = add_classes(api)
    found = api.map(parameters=SAMPLES, distance="squared_l2")
    assert isinstance(found, ShapeMap)
    assert (found.count, [item.id for item in found.items]) == (6, [shape.id for shape in shapes])
    evaluation = api.evaluation(parameters=Parameters(**SAMPLES))
    assert isinstance(evaluation, EvaluationResult)
    assert (evaluation.measure, evaluation.queries, evaluation.accuracy) == ("spectrum", 6, 1.0)
    assert evaluation.confusion.labels == ("egg", "ring")
    assert evaluation.confusion.counts == ((3, 0), (0, 3))
    assert [row.label for row in evaluation.classes] == ["egg", "ring"]
    metrics = api.evaluate("moments", parameters=SAMPLES)
    assert isinstance(metrics, RetrievalMetrics)
    assert 0.0 < metrics.map <= 1.0
    with pytest.raises(UnsuitedError):
        api.evaluate(parameters={"samples": 77})


def test_errors_have_the_same_class_code_and_advice(api):
    for source, expected in ((DAMAGED, MeshReadError), (b"no mesh", MeshFormatError)):
        for call in (api.add, api.rank):
            with pytest.raises(expected) as caught:
                call(source)
            with pytest.raises(expected) as here:
                read_mesh(source)
            assert (str(caught.value), caught.value.code) == (str(here.value), here.value.code)
            assert caught.value.advice == here.value.advice
    with pytest.raises(ParameterError, match="samples"):
        api.add(small_mesh(8), parameters={"samples": 1})
    with pytest.raises(ParameterError, match="JSON"):
        api.add(small_mesh(8), metadata={"x": float("nan")})


def test_wrong_arguments_are_refused_alike(api):
    for wrong in ({"limit": 0}, {"limit": -1}, {"state": "lost"}, {"kind": "none"}):
        with pytest.raises(ParameterError, match=next(iter(wrong))):
            api.list_jobs(**wrong)
    with pytest.raises(ParameterError, match="if_known"):
        api.add(small_mesh(8), parameters=SAMPLES, if_known="perhaps")
    for wrong in ({"name": ""}, {"label": ""}):
        with pytest.raises(ParameterError, match=next(iter(wrong))):
            api.add(small_mesh(8), parameters=SAMPLES, **wrong)
    with pytest.raises(NotFoundError, match="neither the id"):
        api.rank("OFF\n" * 5000)


def test_jobs_are_listed(api, kind, near):
    shape = api.add(small_mesh(9), parameters={"samples": {"library": 6, "sync": 7, "async": 8}[kind]})
    jobs = [job for job in api.list_jobs(kind="shape", state="succeeded") if job.shape_id == shape.id]
    assert [(job.kind, job.state, job.finished, job.error) for job in jobs] == (
        [] if kind == "library" else [("shape", "succeeded", True, None)]
    )
    assert api.list_jobs(kind="shape", state="succeeded") == near.list_jobs(kind="shape", state="succeeded")


def test_near_and_far_give_equal_results(near, far):
    shapes = add_classes(near)
    asked = {
        "get": lambda api: api.get(shapes[0].id),
        "page": lambda api: api.page(limit=4),
        "iter": list,
        "labels": lambda api: api.labels(),
        "rank": lambda api: api.rank(egg(0.35), parameters=SAMPLES),
        "rank stored": lambda api: api.rank(shapes[3].id, measure="partial"),
        "map": lambda api: api.map(parameters=SAMPLES),
        "evaluation": lambda api: api.evaluation(parameters=SAMPLES),
        "known": lambda api: api.add(small_mesh(0), name="other", parameters=SAMPLES),
    }
    for name, ask in asked.items():
        assert ask(near) == ask(far), name


def test_near_and_far_have_the_same_methods_and_arguments():
    own = {
        "add_computed", "address", "backup", "check_writable", "complete", "disk", "export", "jobs", "keys", "search",
        "shapes", "store", "url",
    }  # fmt: skip
    http = {"request", "submit", "job", "job_events"}
    public = {name for name in dir(Library) if not name.startswith("_")} - own
    for client in (Client, AsyncClient):
        assert {name for name in dir(client) if not name.startswith("_")} - http == public
        for name in public - {"close"}:
            near = inspect.signature(getattr(Library, name)).parameters
            far = inspect.signature(getattr(client, name)).parameters
            assert [each for each in far if each not in {"timeout", "progress"}] == list(near), name
            assert [each.kind for key, each in far.items() if key in near] == [each.kind for each in near.values()]


def test_results_survive_a_round_trip_through_json(near):
    shapes = add_classes(near)
    for value in (
        near.get(shapes[0].id),
        near.rank(shapes[3].id, measure="partial"),
        near.rank(shapes[0].id),
        near.map(parameters=SAMPLES),
        near.evaluation(parameters=SAMPLES),
    ):
        assert type(value).from_dict(value.as_dict()) == value
