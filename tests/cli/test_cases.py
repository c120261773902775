"""The files of `mesh_cases` on the command line: each has its area, or fails with its message."""

from __future__ import annotations

import json

import pytest

from tests.support.commands import failed_with_a_sentence, in_process, succeeded
from tests.support.mesh_cases import AREAS, CASES, REFUSED, surface_area_of


@pytest.mark.parametrize("name", AREAS)
def test_every_valid_mesh_file_has_its_area(tmp_path, name):
    target = tmp_path / "signature.json"
    succeeded("signature", CASES / name, "-o", target, "--samples", 4, run=in_process)
    scale = json.loads(target.read_text())["scale"]  # by default the square root of the area
    assert scale**2 == pytest.approx(surface_area_of(name), rel=1e-4)


@pytest.mark.parametrize("name", REFUSED)
def test_every_unreadable_mesh_file_is_refused_with_its_message(tmp_path, name):
    failed_with_a_sentence(in_process("signature", CASES / name, "-o", tmp_path / "signature.json"), REFUSED[name])
