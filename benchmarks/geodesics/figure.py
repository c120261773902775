"""The figure of the section "geodesics": error over time, with one marker for each method."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

from benchmarks.geodesics.measure import Result
from benchmarks.geodesics.peers import APPROXIMATE, EXACT, SPHERICAL
from benchmarks.geodesics.session import Timing

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator, NullFormatter

_MARKERS = dict(zip(APPROXIMATE, "DosPXv^", strict=True))


def draw(results: dict[str, dict[str, Result]], path: Path) -> None:
    """Draw a panel for each mesh: mean error over the time of a source, and a line at the time of exact geodesics."""
    page, panels = plt.subplots(
        1, len(results), figsize=(5.2 * len(results), 4.4), sharey=True, layout="constrained", squeeze=False
    )
    for axes, (mesh, of) in zip(panels[0], results.items(), strict=True):
        _draw_panel(axes, of)
        axes.set_title(mesh)
        axes.set_xlabel("time a source, ms (one thread)")
    panels[0, 0].set_ylabel("mean relative error, %")
    path.parent.mkdir(exist_ok=True)
    page.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    page.savefig(path, dpi=110)
    plt.close(page)


def _draw_panel(axes: Any, of: dict[str, Result]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(color="0.9", zorder=0)
    for number, name in enumerate(APPROXIMATE):
        result = of[name]
        timing = result.many if isinstance(result.many, Timing) else result.alone
        if isinstance(timing, str) or isinstance(result.error, str):
            continue
        size = 110 if name == SPHERICAL else 60
        axes.scatter(
            1e3 * timing.seconds, result.error[0], size, f"C{number}", _MARKERS[name], label=name, zorder=3,
            edgecolors="black", linewidths=0.6,
        )  # fmt: skip
    exact = of[EXACT].alone
    if isinstance(exact, Timing):
        axes.axvline(1e3 * exact.seconds, color="0.35", linestyle="--", label=EXACT, zorder=2)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
