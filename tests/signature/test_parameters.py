"""Parameters: a frozen, hashable value that survives JSON."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import Parameters
from unbend.errors import ParameterError


@given(
    st.builds(
        Parameters,
        samples=st.integers(4, 5000),
        dimensions=st.integers(1, 12) | st.just("auto"),
        method=st.sampled_from(["least_squares", "classical", "fast"]),
        update=st.sampled_from(["spherical", "planar"]),
        scaling=st.sampled_from(["area", "box"]),
    )
)
def test_json_round_trip_and_hash(parameters):
    again = Parameters.from_json(parameters.to_json())
    assert again == parameters
    assert hash(again) == hash(parameters)
    assert Parameters.from_dict(parameters.as_dict()) == parameters


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "JSON"),
        ("[]", "object"),
        ('{"sample": 3}', "parameters: unknown field 'sample'"),
        ('{"samples": 3}', "samples"),
        ('{"samples": 5001}', "samples"),
        ('{"samples": true}', "samples"),
        ('{"samples": "300"}', "samples"),
        ('{"samples": 300.5}', "samples"),
        ('{"dimensions": 0}', "dimensions"),
        ('{"dimensions": null}', "dimensions"),
        ('{"dimensions": "all"}', '1 to 12, or "auto"'),
        ('{"method": "sammon"}', "method"),
        ('{"update": []}', "update"),
        ('{"scaling": 1}', "scaling"),
    ],
)
def test_what_is_out_of_range_is_refused_by_name(text, message):
    with pytest.raises(ParameterError, match=message):
        Parameters.from_json(text)
