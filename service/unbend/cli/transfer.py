"""`unbend transfer`."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from unbend.brief import counted
from unbend.cli.match import doubts, figures, orientation_option, part_option, quality, samples_option
from unbend.cli.mesh_file import read_file
from unbend.cli.options import Values, json_option, mesh_path, policy_options
from unbend.cli.terminal import confirm, warn, warn_of
from unbend.names import printable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from unbend.correspondence.correspondence import Correspondence
    from unbend.mesh.surface import Surface


@click.command()
@click.argument("specimen", type=mesh_path)
@click.argument("values", type=mesh_path)
@click.argument("targets", type=mesh_path, nargs=-1, required=True)
@click.option(
    "-o", "--output", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder of the results."
)
@click.option(
    "--landmarks", is_flag=True, help="VALUES has vertices of SPECIMEN, one a line, not values of all vertices."
)
@orientation_option
@part_option
@samples_option
@json_option
@policy_options
def transfer(
    specimen: Path,
    values: Path,
    targets: tuple[Path, ...],
    output: Path,
    landmarks: bool,
    orientation: str,
    part: str,
    samples: int,
    as_json: bool,
    policy: Values,
) -> None:
    """Carry VALUES from SPECIMEN, a marked mesh, to all TARGETS.

    VALUES is a csv file without a header, or an npy file, with one row for each vertex of SPECIMEN. Numbers with a
    decimal point are interpolated; whole numbers and words are labels. Each result is a csv file in the folder of
    --output, named after its target, with one row for each vertex of the target. With --landmarks, each result has
    instead one vertex of the target, counted from 0, for each line of VALUES.
    """
    from typing import cast  # noqa: PLC0415

    from unbend.correspondence.match import match  # noqa: PLC0415

    _check_names(targets)
    source = read_file(specimen, policy)
    given = _at_surface(source, _read(values), landmarks)
    output.mkdir(parents=True, exist_ok=True)
    results: list[Values] = []
    for target in targets:
        surface = read_file(target, policy)
        found = match(surface, source, samples=samples, orientation=cast("Any", orientation), part=cast("Any", part))
        path = output / _result_name(target)
        path.write_text(_table(_carried(found, surface, given, landmarks)))
        warn_of(path, doubts(found))
        if not as_json:
            warn(f"{path}: {quality(found, source)}")
        results.append({"output": printable(str(path)), **figures(found, source)})
    confirm({"results": results}, f"{printable(str(output))}: {counted(len(results), 'file')}", as_json=as_json)


def _result_name(target: Path) -> str:
    return f"{target.stem}.csv"


def _check_names(targets: Sequence[Path]) -> None:
    """Raise UsageError if the results of two targets would be the same file."""
    named: dict[str, Path] = {}
    for target in targets:
        other = named.setdefault(_result_name(target), target)
        if other is not target:
            raise click.UsageError(f"the results of {other} and {target} would both be {_result_name(target)}")


def _read(path: Path) -> NDArray[Any]:
    import numpy as np  # noqa: PLC0415

    from unbend.errors import ParameterError  # noqa: PLC0415

    if path.suffix.lower() == ".npy":
        try:
            return np.asarray(np.load(path, allow_pickle=False))
        except (ValueError, EOFError) as error:
            raise ParameterError(f"{path}: {error}") from None
    try:
        rows = [row for row in csv.reader(io.StringIO(path.read_text())) if row]
    except UnicodeDecodeError:
        raise ParameterError(f"{path} is neither text nor an npy file") from None
    if not rows or len({len(row) for row in rows}) > 1:
        raise ParameterError(f"{path} must have rows of equal length")
    words = np.array([[word.strip() for word in row] for row in rows])
    words = words[:, 0] if words.shape[1] == 1 else words
    for kind in (np.int64, np.float64):
        try:
            return words.astype(kind)
        except ValueError:
            continue
    return words


def _at_surface(source: Surface, given: NDArray[Any], landmarks: bool) -> NDArray[Any]:
    """Return values at the vertices of the surface, or landmarks as vertices of the surface."""
    import numpy as np  # noqa: PLC0415

    from unbend.errors import ParameterError  # noqa: PLC0415
    from unbend.mesh.correspondence import file_vertices, surface_vertex  # noqa: PLC0415

    if landmarks:
        if given.dtype.kind not in "iu" or given.ndim != 1:
            raise ParameterError("VALUES must have one vertex, a whole number, on each line")
        return np.array([surface_vertex(source, int(vertex), "VALUES") for vertex in given], np.int64)
    count = len(source.vertices if source.vertex_map is None else source.vertex_map)
    if len(given) != count:
        raise ParameterError(f"VALUES must have one row for each of the {count} vertices of SPECIMEN, not {len(given)}")
    return np.asarray(given[file_vertices(source)])


def _carried(found: Correspondence, surface: Surface, given: NDArray[Any], landmarks: bool) -> NDArray[Any]:
    import numpy as np  # noqa: PLC0415

    from unbend.correspondence.transfer import transfer as carry  # noqa: PLC0415
    from unbend.correspondence.transfer import transfer_landmarks  # noqa: PLC0415
    from unbend.mesh.correspondence import at_file_vertices, file_vertices  # noqa: PLC0415

    if landmarks:
        return np.asarray(file_vertices(surface)[transfer_landmarks(found, given)])
    carried = carry(found, given)
    return at_file_vertices(surface, carried, np.nan if carried.dtype.kind == "f" else carried.dtype.type())


def _table(values: NDArray[Any]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(values.reshape(len(values), -1).tolist())
    return text.getvalue()
