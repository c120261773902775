"""The upright axis that `up="auto"` chooses, on meshes whose axis we know, and the ones where it is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from benchmarks.common import DATA
from unbend import Surface, read_mesh
from unbend.mesh.shapes import figure
from unbend.render.upright import upright_axis

NEITHER = ("sphere", "cube", "3holes")  # single models that stand on any side


def main() -> None:
    known = list(_known())
    found = {name: (upright_axis(surface), axis) for name, axis, surface in known}
    wrong = [name for name, (chosen, axis) in found.items() if chosen != axis]
    print(f"{len(wrong)} of {len(known)} wrong: {', '.join(wrong)}")
    for always in ("y", "z"):
        print(f"always {always}: {sum(axis != always for _, axis in found.values())} wrong")


def _known() -> Iterator[tuple[str, str, Surface]]:
    """Yield the name, the upright axis as seen by eye, and the surface, of each mesh."""
    for folder, axis in (("tosca5k", "z"), ("faust5k", "y"), ("single", "y")):
        for path in sorted((DATA / folder).iterdir()):
            if path.suffix in {".off", ".obj"} and not path.stem.startswith(NEITHER):
                yield _name(path), axis, read_mesh(path)
    for kind in ("biped", "quadruped"):
        for pose in range(6):
            yield f"{kind} {pose}", "z", figure(kind, pose)


def _name(path: Path) -> str:
    return f"{path.parent.name}/{path.stem}"


if __name__ == "__main__":
    main()
