"""Computation of many files in processes."""

from __future__ import annotations

import pytest

from tests.support.server import DAMAGED, SAMPLES, ply
from unbend import Parameters, compute_signature, read_mesh
from unbend.errors import UnbendError
from unbend.jobs.batch import compute_paths
from unbend.mesh.shapes import torus
from unbend.render.picture import render_picture
from unbend.render.request import PictureRequest


@pytest.mark.parametrize("picture", [None, PictureRequest(width=32, height=24, theme="transparent")])
def test_paths_have_a_signature_and_only_the_requested_picture(tmp_path, picture):
    good, bad = tmp_path / "good.ply", tmp_path / "bad.off"
    good.write_bytes(ply(torus(columns=12, rows=8)))
    bad.write_bytes(DAMAGED)
    parameters = Parameters(**SAMPLES)
    outcomes = dict(compute_paths([bad, good], parameters, picture=picture))
    failed, found = outcomes[0], outcomes[1]
    assert isinstance(failed, UnbendError)
    surface = read_mesh(good)
    assert (found.signature.points == compute_signature(surface, parameters).points).all()
    assert found.picture == (render_picture(picture, surface) if picture else None)
