"""Packages that only an extra of unbend installs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from unbend.errors import ExtraMissingError


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Import the packages of an extra in the body; ExtraMissingError says which extra to install if one is missing.

    An error within an installed package passes through: another installation would not mend it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        if find_spec(package) is not None:
            raise
        raise ExtraMissingError(
            f"this needs the extra {name}, but {package} is not installed: "
            f"run pip install '.[{name}]' in the clone of unbend's repository"
        ) from error
