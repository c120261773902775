"""The base of values that a notebook shows with a picture."""

from __future__ import annotations

from importlib import import_module


class Pictured:
    """A value with a picture in a notebook."""

    def _repr_html_(self) -> str:
        # Surfaces are below the renderer and must not import it. So it is named here, as `unbend/__init__.py` names the
        # public modules, and nothing is drawn or compiled until a notebook shows a value. Formatters that the renderer
        # registers with IPython would need somebody to import the renderer first.
        return str(import_module("unbend.render.notebook").html_of(self))
