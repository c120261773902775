"""Surfaces, forms and signatures as HTML with a picture, for notebooks."""

from __future__ import annotations

from functools import singledispatch
from typing import Final

from unbend.errors import ParameterError
from unbend.mesh.surface import Surface
from unbend.notebook.html import figure_html
from unbend.render.picture import render_picture
from unbend.render.request import PictureRequest
from unbend.signature.canonical_form import CanonicalForm
from unbend.signature.signature import Signature

_SURFACE: Final = PictureRequest(width=256, height=256, format="webp", theme="transparent")
_FORM: Final = PictureRequest(width=256, height=256, format="webp", theme="transparent", subject="signature")


@singledispatch
def html_of(value: object) -> str:
    """Return HTML of a `Surface`, `CanonicalForm` or `Signature`: a picture, its `repr`, and its warnings."""
    raise ParameterError(f"value: {type(value).__name__} has no picture")


@html_of.register
def _(surface: Surface) -> str:
    return figure_html(thumbnail(surface), repr(surface), surface.report.warnings)


@html_of.register
def _(form: CanonicalForm) -> str:
    return figure_html(_drawn(form), repr(form), form.signature.warnings)


@html_of.register
def _(signature: Signature) -> str:
    # A signature whose samples have no triangles between them cannot be drawn as a surface.
    picture = _drawn(CanonicalForm(signature.points, signature.faces, signature)) if len(signature.faces) else None
    return figure_html(picture, repr(signature), signature.warnings)


def thumbnail(surface: Surface) -> bytes:
    """Return a small picture of a surface on a transparent ground, a WebP file."""
    return render_picture(_SURFACE, surface)


def _drawn(form: CanonicalForm) -> bytes:
    """Draw a form alone. The form itself decides how it is turned, because the pose of its surface is unknown."""
    return render_picture(_FORM, form.surface, form)
