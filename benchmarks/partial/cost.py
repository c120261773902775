"""Time and memory of local signatures, and of a query by them.

python -m benchmarks.partial.cost            # writes the section "pieces-cost" of docs/benchmarks/pieces.md
"""

from __future__ import annotations

from benchmarks.common import BENCHMARKS, DATA, best_of, table, write_section
from benchmarks.partial.cuts import piece
from unbend import compute_signature, read_mesh
from unbend.library.packing import pack_local
from unbend.local.signatures import local_signatures
from unbend.matching.partial import profiles_of, search_parts

MESHES = ("shrec11_simplified/T133.obj", "tosca5k/cat0.off", "shrec07/1.off")

SHAPES = 3000


def main() -> None:
    rows, surfaces = [], [read_mesh(DATA / name) for name in MESHES if (DATA / name).exists()]
    for surface in surfaces:
        signature = best_of(5, lambda surface=surface: compute_signature(surface, threads=1))
        local = best_of(5, lambda surface=surface: local_signatures(surface, threads=1))
        size = len(pack_local(local_signatures(surface, threads=1))) / 1000
        rows.append([len(surface.vertices), f"{signature:.2f} s", f"{local:.2f} s", f"{size:.0f} kB"])
    costs = table(["vertices", "signature", "local signatures", "stored"], rows)
    cat = surfaces[1]
    whole, query = local_signatures(cat), local_signatures(piece(cat, "disc, .45", "cat0"))
    gallery = [profiles_of(whole) for _ in range(SHAPES)]  # each in its own memory, as in a library
    scan = [
        best_of(
            5, lambda any_scale=any_scale: search_parts(query, gallery, _load(whole), any_scale=any_scale, threads=1)
        )
        for any_scale in (False, True)
    ]
    queries = table(
        [f"a query among {SHAPES} shapes", "seconds"],
        [["`partial`", f"{scan[0]:.1f}"], ["`partial_any_scale`", f"{scan[1]:.1f}"]],
    )
    note = "On one core, with the local signatures of the library in memory."
    write_section(BENCHMARKS / "pieces.md", "pieces-cost", f"{note}\n\n{costs}\n\n{queries}")


def _load(whole):
    return lambda rows: [whole] * len(rows)


if __name__ == "__main__":
    main()
