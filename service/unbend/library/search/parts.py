"""Rankings of wholes for a piece, and of pieces for a whole, by local signatures."""

from __future__ import annotations

import threading
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from sqlalchemy import Connection, select

from unbend.arrays import Floats, Indices
from unbend.errors import NotFoundError, ParameterError
from unbend.library import shape_rows
from unbend.library.requests import QueryRequest
from unbend.library.search.filters import filter_of, kept_seqs
from unbend.library.search.incomparable import none_compares, why_none_compares
from unbend.library.storage.schema import library_state, local_signatures, shapes, signatures
from unbend.library.storage.store import Store
from unbend.local.signatures import LOCAL_VERSION, LocalSignatures
from unbend.matching.classification import ClassMatch
from unbend.matching.classification.calibration import confidences
from unbend.matching.partial import Load, PartSearch, Profiles, profiles_of, search_parts
from unbend.matching.partial.calibration import EXPONENT, MEMBERS, SLACK, unfamiliarity
from unbend.matching.selection import smallest
from unbend.results.rankings import PartRelation, Ranking
from unbend.signature.signature import ALGORITHM_VERSION, Signature

_AT_A_TIME = 256


@dataclass(frozen=True)
class PartGallery:
    """The profiles of all shapes with local signatures of the present version, in the order of adding."""

    seqs: tuple[int, ...]
    labels: tuple[str | None, ...]
    parameters: tuple[str, ...]
    profiles: tuple[Profiles, ...]
    missing: int
    """Shapes without local signatures."""

    def only(self, parameters: str, without: int, among: Collection[int] | None) -> PartGallery:
        """Return the shapes computed with these parameters, except the one at the place `without`.

        If `among` is given, only shapes at those places are returned.
        """
        kept = [
            row
            for row, (seq, found) in enumerate(zip(self.seqs, self.parameters, strict=True))
            if found == parameters and seq != without and (among is None or seq in among)
        ]
        return PartGallery(
            tuple(self.seqs[row] for row in kept), tuple(self.labels[row] for row in kept),
            tuple(self.parameters[row] for row in kept), tuple(self.profiles[row] for row in kept), self.missing,
        )  # fmt: skip


class PartIndex:
    """Profiles in memory. The store is the source of truth; only new shapes are read from it. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._state: tuple[str, int] | None = None
        self._known: dict[int, Profiles] = {}
        self._gallery = PartGallery((), (), (), (), 0)

    def gallery(self, connection: Connection) -> PartGallery:
        """Return what `connection` sees; its transaction should begin with this call."""
        with self._lock:
            epoch, revision = connection.execute(select(library_state.c.epoch, library_state.c.revision)).one()
            if self._state is None or self._state[0] != epoch or revision < self._state[1]:
                self._known = {}
            if self._state != (epoch, revision):
                self._update(connection)
                self._state = epoch, revision
            return self._gallery

    def _update(self, connection: Connection) -> None:
        listed = connection.execute(
            select(shapes.c.seq, shapes.c.label, signatures.c.parameters)
            .join(signatures, shapes.c.signature_id == signatures.c.id)
            .join(local_signatures, local_signatures.c.signature_id == signatures.c.id)
            .where(local_signatures.c.version == LOCAL_VERSION)
            .order_by(shapes.c.seq)
        ).all()
        new = [row.seq for row in listed if row.seq not in self._known]
        for start in range(0, len(new), _AT_A_TIME):
            found = shape_rows.get_locals(connection, new[start : start + _AT_A_TIME])
            self._known |= {seq: profiles_of(local) for seq, local in found.items()}
        self._known = {row.seq: self._known[row.seq] for row in listed}
        count = shape_rows.count_shapes(connection)
        self._gallery = PartGallery(
            tuple(row.seq for row in listed), tuple(row.label for row in listed),
            tuple(row.parameters for row in listed), tuple(self._known.values()), count - len(listed),
        )  # fmt: skip


def rank_parts(store: Store, index: PartIndex, query: Signature | str, request: QueryRequest) -> Ranking:
    """Rank the content of `store` by a measure of parts.

    Raises
    ------
    NotFoundError
        If there is no such shape, or it has no local signatures.
    ParameterError
        If the query is a signature without local signatures.
    """
    measure = request.part_measure
    assert measure is not None  # noqa: S101  the caller chose this function by it
    with store.read() as connection:
        whole = index.gallery(connection)
        local, seq, parameters, warnings = _query_of(connection, query)
        gallery = whole.only(parameters, seq, kept_seqs(connection, filter_of(request)))
        if whole.seqs and not gallery.seqs:
            warnings = (*warnings, *none_compares(why_none_compares(connection, parameters, ALGORITHM_VERSION, seq)))

        def load(rows: Indices) -> Sequence[LocalSignatures]:
            wanted = [gallery.seqs[row] for row in rows]
            found = shape_rows.get_locals(connection, wanted)
            return [found[each] for each in wanted]

        found = search_parts(local, gallery.profiles, load, any_scale=measure.any_scale)
        rows = smallest(found.distances, request.k)
        seqs, distances = [gallery.seqs[row] for row in rows], found.distances[rows].tolist()
        matches = shape_rows.get_matches(connection, seqs, distances)
        classes = _classes(gallery.labels, found.distances)
        known = _known(local, gallery, found, classes, load) if classes else None
    left_out = int(np.isinf(found.distances).sum())
    warnings = (*warnings, *_missing(whole.missing), *_too_different(left_out, any_scale=measure.any_scale))
    detailed = [replace(match, part=_part(found, row)) for match, row in zip(matches, rows.tolist(), strict=True)]
    return Ranking(request.measure, classes, detailed, known, warnings)


def _query_of(connection: Connection, query: Signature | str) -> tuple[LocalSignatures, int, str, Sequence[str]]:
    """Return a query's local signatures, its place in the order of adding (0 if not stored), parameters, warnings."""
    if isinstance(query, Signature):
        if query.local is None:
            raise ParameterError("the signature was computed without local signatures, which measures of parts need")
        return query.local, 0, query.parameters.to_json(), query.warnings
    seq, parameters, _version, warnings = shape_rows.get_place(connection, query)
    found = shape_rows.get_locals(connection, [seq])
    if seq not in found:
        raise NotFoundError(f"shape {query} has no local signatures: run `unbend complete`")
    return found[seq], seq, parameters, warnings


def _known(
    query: LocalSignatures, gallery: PartGallery, found: PartSearch, classes: Sequence[ClassMatch], load: Load
) -> bool | None:
    """Return whether a query is as near to the best class as its members are to each other at the same place."""
    rows = [row for row, each in enumerate(gallery.labels) if each == classes[0].label]
    rows.sort(key=lambda row: (found.distances[row], row))
    if rows[0] not in found.comparisons:
        return None
    nearest, *members = load(np.array(rows[: MEMBERS + 1]))
    next_class = classes[1].distance if len(classes) > 1 else None
    ratio = unfamiliarity(query, found.comparisons[rows[0]], nearest, members, next_class)
    return None if ratio is None else ratio <= SLACK


def _part(found: PartSearch, row: int) -> PartRelation | None:
    compared = found.comparisons.get(row)
    return PartRelation.of(compared) if compared else None


def _classes(labels: Sequence[str | None], distances: Floats) -> list[ClassMatch]:
    """Return the classes by the distance of their nearest member."""
    nearest: dict[str, float] = {}
    for label, distance in zip(labels, distances.tolist(), strict=True):
        if label is not None and np.isfinite(distance):
            nearest[label] = min(distance, nearest.get(label, np.inf))
    ordered = sorted((distance, label) for label, distance in nearest.items())
    if not ordered:
        return []
    shares = confidences(np.array([distance for distance, _ in ordered]), EXPONENT).tolist()
    return [ClassMatch(label, distance, share) for (distance, label), share in zip(ordered, shares, strict=True)]


def _missing(count: int) -> tuple[str, ...]:
    if not count:
        return ()
    shapes_, were = ("shape", "was") if count == 1 else ("shapes", "were")
    sentence = f"{count} {shapes_} without local signatures {were} not compared: run `unbend complete` first"
    return (sentence,)


def _too_different(count: int, *, any_scale: bool) -> tuple[str, ...]:
    """Return a warning about shapes that share no radius of circles with the query."""
    if not count:
        return ()
    shapes_, were = ("shape", "was") if count == 1 else ("shapes", "were")
    advice = "" if any_scale else ": if the units differ, ask with the measure `partial_any_scale`"
    return (f"{count} {shapes_} of a very different size {were} not compared{advice}",)
