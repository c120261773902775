"""Tables: aligned text in a pipe or a file, and drawn by Rich on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from typing import Final

from unbend.names import printable

_GAP: Final = "  "


def table(columns: Sequence[str], rows: Sequence[Sequence[object]], *, numbers: Collection[str] = ()) -> str:
    """Return a table as text; the columns `numbers` are aligned to the right, and None is "-".

    In a pipe or a file it is plain text with one line for each row, however long names are. On a terminal, long cells
    are folded to its width.
    """
    cells = [[_text(value) for value in row] for row in rows]
    right = [column in numbers for column in columns]
    if sys.stdout.isatty():
        return _drawn(columns, cells, right)
    widths = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    return "\n".join(_GAP.join(map(_aligned, line, widths, right)).rstrip() for line in [columns, *cells])


def figures_table(heading: str, columns: Sequence[str], rows: Sequence[tuple[str, Mapping[str, float | None]]]) -> str:
    """Return a table of numbers. Each row has its name and its values of `columns`."""
    cells = [[name, *(_figure(values[column]) for column in columns)] for name, values in rows]
    return table([heading, *columns], cells, numbers=columns)


def timestamp(time: datetime | None) -> str | None:
    """Return a time as a cell, to the second."""
    return f"{time:%Y-%m-%d %H:%M:%S}" if time else None


def _figure(value: float | None) -> object:
    return f"{value:.3f}" if isinstance(value, float) else value


def _text(value: object) -> str:
    return "-" if value is None else visible(str(value))


def visible(name: str) -> str:
    """Return a name without line breaks and escape sequences: names may contain anything."""
    text = printable(name)
    return text if text.isprintable() else "".join(map(_escaped, text))


def _escaped(character: str) -> str:
    return character if character.isprintable() else character.encode("unicode_escape").decode()


def _aligned(text: str, width: int, right: bool) -> str:
    return text.rjust(width) if right else text.ljust(width)


def _drawn(columns: Sequence[str], cells: Sequence[Sequence[str]], right: Sequence[bool]) -> str:
    from rich import box  # noqa: PLC0415
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    drawn = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading, is_number in zip(columns, right, strict=True):
        drawn.add_column(Text(heading), justify="right" if is_number else "left", overflow="fold")
    for row in cells:
        drawn.add_row(*map(Text, row))
    console = Console(file=sys.stdout)
    with console.capture() as captured:
        console.print(drawn)
    return captured.get().rstrip("\n")
