"""Files of other programs that earlier versions refused or misread, each with its correct area."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.mesh_cases import AREAS, CASES, NOTES, REFUSED, surface_area_of
from unbend import read_mesh
from unbend.errors import MeshFormatError
from unbend.mesh.formats.detect import detect_format
from unbend.mesh.formats.registry import REGISTRY
from unbend.mesh.limits import UNLIMITED


def test_every_case_file_has_an_expected_result():
    assert {path.name for path in CASES.iterdir()} == AREAS.keys() | REFUSED.keys()


@pytest.mark.parametrize("name", AREAS)
@pytest.mark.parametrize("named", [True, False])
def test_every_valid_mesh_file_has_its_area(name, named):
    data = (CASES / name).read_bytes()
    parsed = REGISTRY[detect_format(data, Path(name).suffix[1:] if named else None)].read(data, UNLIMITED)
    corners = parsed.vertices[parsed.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert areas.sum() == pytest.approx(AREAS[name], rel=1e-5)
    assert any(NOTES[name] in note for note in parsed.notes) if name in NOTES else parsed.notes == ()


@pytest.mark.parametrize("name", AREAS)
def test_every_valid_mesh_file_is_one_surface(name):
    surface = read_mesh(CASES / name)
    body = surface_area_of(name)
    assert surface.area == pytest.approx(body, rel=1e-4)
    assert surface.report.components == (1 if body == AREAS[name] else 2)
    if name in NOTES:
        assert any(NOTES[name] in note for note in surface.report.notes)


@pytest.mark.parametrize("name", REFUSED)
def test_every_unreadable_mesh_file_is_refused_with_its_message(name):
    with pytest.raises(MeshFormatError, match=REFUSED[name]):
        read_mesh(CASES / name)
