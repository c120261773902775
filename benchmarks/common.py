"""Tables, timings and paths that the benchmarks share."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BENCHMARKS = ROOT / "docs" / "benchmarks"
DATA = Path(os.environ.get("UNBEND_SHARED_DATA", ROOT.parent / "shared" / "data"))


def best_of(repeats: int, function: Callable[[], object]) -> float:
    """Return the seconds of the quickest run, the run that other processes disturbed least."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def in_turns(functions: dict[str, Callable[[], Any]], turns: int = 5) -> dict[str, tuple[float, Any]]:
    """Call the functions in turns; return the seconds of the quickest call of each, and its result."""
    best: dict[str, tuple[float, Any]] = {}
    for _ in range(turns):
        for name, function in functions.items():
            start = time.perf_counter()
            result = function()
            seconds = time.perf_counter() - start
            if name not in best or seconds < best[name][0]:
                best[name] = seconds, result
    return best


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def with_headings(text: str) -> str:
    """Return Markdown in which each paragraph that begins with a bold term has the term as its heading."""

    def heading(found: re.Match[str]) -> str:
        term, colon, rest = found.groups()
        if term.endswith("."):
            return found[0]
        sentence = rest.strip()[:1].upper() + rest.strip()[1:] if ":" in colon else term + rest
        return f"### {term}\n\n{sentence}".rstrip()

    return re.sub(r"(?:\A|(?<=\n\n))\*\*([^*\n]+?)(\*\*:|:\*\*|\*\*)(.*)", heading, text)


def write_section(page: Path, name: str, text: str) -> None:
    """Replace the part of `page` between the marks of `name`; append a new part if the page has no such marks."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    old = page.read_text() if page.exists() else "# Benchmarks\n"
    if begin not in old:
        old += f"\n{begin}\n{end}\n"
    before, rest = old.split(begin)
    page.write_text(f"{before}{begin}\n{with_headings(text)}\n{end}{rest.split(end)[1]}")
    print(text)
