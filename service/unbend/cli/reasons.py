"""Why nothing of a library compares with what a command asks about."""

from __future__ import annotations

from dataclasses import asdict
from typing import Final

from unbend.cli.options import PART_MEASURES, Values
from unbend.cli.places import Place
from unbend.errors import UnsuitedError

GIVE_CLASSES: Final = (
    "Give classes to shapes by `unbend label`, or import the folder again with --labels or --label-from folder."
)

_LOOKED_AT: Final = 100
"""Shapes that are looked at to find the reason."""


def why_nothing_compares(place: Place, parameters: Values, measure: str) -> UnsuitedError | None:
    """Return the reason why no shape of `place` is compared with a signature of these parameters, if it is known."""
    from unbend.signature.parameters import Parameters  # noqa: PLC0415
    from unbend.signature.signature import ALGORITHM_VERSION  # noqa: PLC0415

    shapes = place.page(limit=_LOOKED_AT).items
    if not shapes:
        return UnsuitedError("the library has no shapes").with_advice("Add some by `unbend import`.")
    wanted = asdict(Parameters.from_dict(parameters))
    stored = [asdict(shape.parameters) for shape in shapes]
    if wanted not in stored:
        names = [name for name in wanted if any(of[name] != wanted[name] for of in stored)]
        choices = sorted({_options(names, of) for of in stored})
        return UnsuitedError(
            f"no shape compares with {_options(names, wanted)}: the library has {' and '.join(choices)}"
        ).with_advice("Ask with its parameters, or import its shapes with these.")
    if all(shape.version != ALGORITHM_VERSION for shape in shapes):
        return UnsuitedError("an earlier version of unbend computed the shapes").with_advice(
            f"Import them again, for version {ALGORITHM_VERSION}."
        )
    if measure in PART_MEASURES:
        return UnsuitedError("no shape has local signatures").with_advice("Compute them by `unbend complete`.")
    return None


def why_nothing_is_evaluated(place: Place, parameters: Values, measure: str) -> UnsuitedError | None:
    """Return the reason why `place` has no evaluation, if it is known."""
    if reason := why_nothing_compares(place, parameters, measure):
        return reason
    return None if place.labels() else UnsuitedError("no shape has a class").with_advice(GIVE_CLASSES)


def _options(names: list[str], parameters: Values) -> str:
    """Return some of the parameters as options of the command line."""
    return " ".join(f"--{name.replace('_', '-')} {parameters[name]}" for name in names)
