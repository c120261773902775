"""`unbend demo`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.options import chosen_objects, json_option, library_option, objects_option
from unbend.cli.terminal import confirm, prepare_kernels, progress
from unbend.names import printable


@click.command()
@library_option
@objects_option
@click.option(
    "--write",
    "folder",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Write the meshes and labels.csv to DIR instead.",
)
@json_option
def demo(library: str, folder: Path | None, as_json: bool) -> None:
    """Fill a library with generated bent shapes: sheets, tubes, animals, hands, each in several poses."""
    count = _write(folder) if folder else _store(library)
    place = printable(str(folder or library))
    confirm({"shapes": count, "place": place}, f"{count} demo shapes in {place}", as_json=as_json)


def _store(url: str) -> int:
    from unbend.library import Library  # noqa: PLC0415
    from unbend.mesh.shapes import DEMO_COUNT, demo_shapes  # noqa: PLC0415

    prepare_kernels()
    with Library(url, objects=chosen_objects()) as library:
        if len(library) >= DEMO_COUNT:
            return len(library)
        with progress(demo_shapes(), "computing demo shapes", DEMO_COUNT) as bar:
            for shape in bar:
                library.add(shape.as_ply(), name=shape.name, label=shape.label)
        return len(library)


def _write(folder: Path) -> int:
    from unbend.mesh.shapes import DEMO_COUNT, demo_shapes  # noqa: PLC0415

    folder.mkdir(parents=True, exist_ok=True)
    lines = ["path,class"]
    with progress(demo_shapes(), "writing demo shapes", DEMO_COUNT) as bar:
        for shape in bar:
            (folder / f"{shape.name}.ply").write_bytes(shape.as_ply())
            lines.append(f"{shape.name}.ply,{shape.label}")
    (folder / "labels.csv").write_text("\n".join(lines) + "\n")
    return len(lines) - 1
