"""Reading policies: hashable values that can be stored as JSON."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import MeshPolicy
from unbend.errors import ParameterError


@given(
    st.builds(
        MeshPolicy,
        components=st.sampled_from(["largest", "bridge", "error"]),
        max_vertices=st.none() | st.integers(4, 10**9),
        smooth=st.integers(0, 100),
        seams=st.sampled_from(["stitch", "keep"]),
    )
)
def test_a_policy_survives_json_with_an_equal_hash(policy):
    again = MeshPolicy.from_json(policy.to_json())
    assert again == policy
    assert hash(again) == hash(policy)
    assert MeshPolicy.from_dict(policy.as_dict()) == policy


def test_missing_fields_of_a_policy_have_their_defaults():
    assert MeshPolicy.from_json("{}") == MeshPolicy()
    assert MeshPolicy.from_json('{"max_vertices": 100}') == MeshPolicy(max_vertices=100)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "policy: not JSON"),
        ("[]", "policy must be a JSON object"),
        ("[" * 60_000, "policy: nested too deeply"),
        (
            '{"component": "bridge"}',
            "policy: unknown field 'component'; known are components, max_vertices, seams, smooth",
        ),
        ('{"components": "smallest"}', "components must be one of largest, bridge, error, not 'smallest'"),
        ('{"components": null}', "components"),
        ('{"components": []}', "components"),
        ('{"seams": "weld"}', "seams must be one of stitch, keep, not 'weld'"),
        ('{"max_vertices": 3}', "max_vertices"),
        ('{"max_vertices": true}', "max_vertices"),
        ('{"max_vertices": "100"}', "max_vertices"),
        ('{"max_vertices": 100.5}', "max_vertices"),
        ('{"smooth": -1}', "smooth must be a whole number, 0 to 100, not -1"),
        ('{"smooth": 101}', "smooth must be a whole number, 0 to 100, not 101"),
        ('{"smooth": true}', "smooth"),
        ('{"smooth": 2.5}', "smooth"),
        ('{"smooth": null}', "smooth"),
        ('{"smooth": "2"}', "smooth"),
    ],
)
def test_an_invalid_field_of_a_policy_is_named(text, message):
    with pytest.raises(ParameterError, match=message):
        MeshPolicy.from_json(text)
