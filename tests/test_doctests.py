"""Runs the examples in docstrings."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import unbend

MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(unbend.__path__, "unbend.")
    if not module.name.endswith("__main__") and ".migrations" not in module.name
)


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name):
    module = importlib.import_module(name)
    result = doctest.testmod(module, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert result.failed == 0


def test_there_are_more_than_five_doctests():
    finder = doctest.DocTestFinder()
    found = [test for name in MODULES for test in finder.find(importlib.import_module(name)) if test.examples]
    assert len(found) > 5
