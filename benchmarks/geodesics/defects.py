"""Distances on thousands of small damaged meshes: each mesh must give correct distances or a typed error.

Compares with exact geodesics of the repaired mesh. Writes "defects" of docs/benchmarks/distances.md; --print only
prints.
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import TimeoutError as HangError
from concurrent.futures import as_completed
from dataclasses import dataclass

import numpy as np
from pebble import ProcessExpired, ProcessPool

from benchmarks.common import BENCHMARKS, table, write_section
from tests.support.defects import COARSE, UPDATES, Mesh, examine, random_defective

CHUNK = 50
CHUNK_SECONDS = 120  # includes compiling; a mesh takes about 10 ms
MESH_SECONDS = 20

MEAN = 0.1
"""A mean error above this counts as wrong. On ordinary defects, 99.9 % of the mean errors are below 0.07."""


@dataclass(frozen=True)
class Result:
    """The outcome of one mesh and, for each update, the mean absolute error and the largest and smallest error."""

    seed: int
    outcome: str
    coarse: bool
    errors: tuple[tuple[float, float, float], ...] = ()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=20_000)
    parser.add_argument("--print", action="store_true", dest="only_print", help="leave the page alone")
    options = parser.parse_args()
    text = report(list(run(options.count)))
    if options.only_print:
        print(text)
    else:
        write_section(BENCHMARKS / "distances.md", "defects", text)


def run(count: int) -> Iterator[Result]:
    """Examine `count` meshes in two processes; a chunk that crashes or hangs is repeated mesh by mesh."""
    chunks = [range(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
    with ProcessPool(max_workers=2) as pool:
        futures = {pool.schedule(examine_all, [chunk], timeout=CHUNK_SECONDS): chunk for chunk in chunks}
        for future in as_completed(futures):
            try:
                yield from future.result()
            except (ProcessExpired, HangError):
                for seed in futures[future]:
                    yield alone(pool, seed)


def alone(pool: ProcessPool, seed: int) -> Result:
    try:
        return pool.schedule(examine_all, [[seed]], timeout=MESH_SECONDS).result()[0]
    except ProcessExpired:
        return Result(seed, "crash", coarse=is_coarse(seed))
    except HangError:
        return Result(seed, "hang", coarse=is_coarse(seed))


def mesh_of(seed: int) -> tuple[Mesh, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return random_defective(rng), rng


def is_coarse(seed: int) -> bool:
    return any(step.split(":")[0] in COARSE for step in mesh_of(seed)[0].story)


def examine_all(seeds: range | list[int]) -> list[Result]:
    warnings.simplefilter("error")
    return [examine_one(seed) for seed in seeds]


def examine_one(seed: int) -> Result:
    mesh, rng = mesh_of(seed)
    coarse = is_coarse(seed)
    try:
        outcome = examine(mesh, rng, ("largest", "bridge")[seed % 2])
    except Exception as error:  # noqa: BLE001 - any exception is a result
        first = (str(error) or type(error).__name__).strip().splitlines()[0].split(" by ")[0]
        return Result(seed, f"wrong: {type(error).__name__}: {first[:60]}", coarse)
    if outcome.error is not None:
        assert str(outcome.error)
        return Result(seed, f"typed error: {type(outcome.error).__name__}", coarse)
    errors = tuple(_spread(outcome.relative[update]) for update in UPDATES)
    right = all(mean < MEAN for mean, _, _ in errors)
    return Result(seed, "right distance" if right else f"wrong: mean error above {MEAN:.0%}", coarse, errors)


def _spread(relative: np.ndarray) -> tuple[float, float, float]:
    if len(relative) == 0:
        return 0.0, 0.0, 0.0
    return float(np.abs(relative).mean()), float(relative.max()), float(relative.min())


def report(results: list[Result]) -> str:
    groups = (False, True)
    counts = {group: Counter(result.outcome for result in results if result.coarse == group) for group in groups}
    outcomes = sorted(counts[False] | counts[True])
    rows = [[outcome, *(f"{counts[group][outcome]:,}" for group in groups)] for outcome in outcomes]
    parts = [table([f"{len(results):,} meshes", "ordinary defects", "with needles or far spikes"], rows)]
    lines = [line for group in groups for line in _error_lines([r for r in results if r.coarse == group], group)]
    header = ["defects", "update", "mean", "99 % of means", "99.9 %", "worst mean", "longest", "shortest"]
    parts.append(table(header, lines))
    wrong = [r for r in results if r.outcome.startswith(("wrong", "crash", "hang")) and not r.coarse]
    parts += [f"{r.seed}: {r.outcome}, {' '.join(mesh_of(r.seed)[0].story)}" for r in wrong[:20]]
    return "\n\n".join(parts)


def _error_lines(results: list[Result], coarse: bool) -> Iterator[list[str]]:
    for place, update in enumerate(UPDATES):
        errors = np.array([result.errors[place] for result in results if result.errors])
        if len(errors) == 0:
            continue
        mean, longest, shortest = errors.T
        figures = [mean.mean(), *np.quantile(mean, [0.99, 0.999, 1]), longest.max(), shortest.min()]
        name = "needles, far spikes" if coarse else "ordinary"
        yield [name, update, *(f"{figure:.3%}" for figure in figures)]


if __name__ == "__main__":
    main()
