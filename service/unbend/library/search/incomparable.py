"""Why a library that has shapes has none to compare with a query."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any, Final

from sqlalchemy import Connection, func, select

from unbend.brief import assigned, counted
from unbend.library.storage.schema import shapes, signatures
from unbend.signature.parameters import Parameters

ADVICE: Final = "Ask with the parameters of the shapes, or add the shapes again with those of the query."

_LOOKED_AT: Final = 10_000
"""Shapes that are counted: a larger library would make the answer slow."""

_KINDS: Final = 3
"""Most kinds of parameters that a sentence names."""


def why_none_compares(connection: Connection, parameters: str, version: str, but: int = 0) -> str:
    """Return why no shape has a vector for a query of these parameters; nothing if the library has no other shape.

    Parameters
    ----------
    connection : Connection
    parameters : str
        The query's parameters as JSON.
    version : str
        The version of the query's algorithms.
    but : int, optional
        The place of the query in the order of adding, if it is stored.
    """
    first = select(shapes.c.signature_id).where(shapes.c.seq != but).order_by(shapes.c.seq).limit(_LOOKED_AT).subquery()
    kinds = (
        select(signatures.c.parameters, signatures.c.version, func.count())
        .join(first, first.c.signature_id == signatures.c.id)
        .group_by(signatures.c.parameters, signatures.c.version)
    )
    found = {(kind, made): count for kind, made, count in connection.execute(kinds).all()}
    if not found:
        return ""
    shape = "other shape" if but else "shape"
    wanted = {made: count for (kind, made), count in found.items() if kind == parameters}
    if not wanted:
        numbers: Counter[str] = Counter()
        for (kind, _), count in found.items():
            numbers[kind] += count
        return f"no {shape} has the parameters of the query{_difference(parameters, numbers)}"
    if version not in wanted:
        count = sum(wanted.values())
        were = "was" if count == 1 else "were"
        return f"{counted(count, shape)} {were} computed by another version of unbend than the query"
    return f"no {shape} has the descriptors of this measure"


def none_compares(reason: str) -> tuple[str, ...]:
    """Return the warning of an answer without shapes, if there is a reason."""
    return (f"{reason}. {ADVICE}",) if reason else ()


def _difference(parameters: str, numbers: Counter[str]) -> str:
    """Return the parameters in which a query and the shapes differ, with the number of shapes that have each."""
    own = asdict(Parameters.from_json(parameters))
    kinds = [(asdict(Parameters.from_json(kind)), count) for kind, count in numbers.most_common()]
    names = [name for name in own if any(kind[name] != own[name] for kind, _ in kinds)]
    have = [
        f"{counted(count, 'shape')} {'has' if count == 1 else 'have'} {_named(names, kind)}"
        for kind, count in kinds[:_KINDS]
    ]
    rest = sum(count for _, count in kinds[_KINDS:])
    others = [f"{counted(rest, 'shape')} still others"] if rest else []
    return f", {_named(names, own)}: {', '.join(have + others)}"


def _named(names: Iterable[str], values: dict[str, Any]) -> str:
    return " ".join(assigned({name: values[name] for name in names}))
