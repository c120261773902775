"""Files of signatures."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from unbend import Parameters, Signature, compute_signature, load_signature, save_signature
from unbend.errors import ParameterError
from unbend.mesh.shapes import sphere
from unbend.signature.export import export_signature


@pytest.fixture(scope="module")
def signature() -> Signature:
    return compute_signature(sphere(2), Parameters(samples=30, dimensions=4))


@pytest.mark.parametrize("name", ["form.npz", "form.JSON"])
def test_a_signature_is_the_same_after_saving_and_loading(signature, name, tmp_path):
    save_signature(signature, tmp_path / name)
    for source in (tmp_path / name, str(tmp_path / name), (tmp_path / name).read_bytes()):
        found = load_signature(source)
        for field in dataclasses.fields(Signature):
            value, again = getattr(signature, field.name), getattr(found, field.name)
            if isinstance(value, np.ndarray):
                assert (again.dtype, again.shape) == (value.dtype, value.shape)
                assert np.array_equal(again, value)
            elif field.name == "descriptors":
                assert again.keys() == value.keys()
                assert all(np.array_equal(again[each], value[each]) for each in value)
            else:
                assert again == value


def test_files_of_earlier_versions_have_no_boundary(signature):
    members = json.loads(export_signature(signature, "json"))
    del members["boundary"]
    assert load_signature(json.dumps(members).encode()).boundary is None


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b"PK\x03\x04", b"OFF\n3 1 0\n"])
def test_other_files_are_refused_by_name(content, tmp_path):
    path = tmp_path / "x.npz"
    path.write_bytes(content)
    with pytest.raises(ParameterError, match=r"x\.npz is no signature"):
        load_signature(path)


def test_other_formats_are_refused(signature, tmp_path):
    with pytest.raises(ParameterError, match="format of a signature file"):
        save_signature(signature, tmp_path / "form.ply")
