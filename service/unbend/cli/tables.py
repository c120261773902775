"""Tables of numbers for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

_WIDTH = 10
_FIRST = 18


def table(heading: str, columns: Sequence[str], rows: Sequence[tuple[str, Mapping[str, float | None]]]) -> str:
    """Return a table as text. Each row has its name and its values of `columns`, "-" for None."""
    first = max([_FIRST, len(heading) + 2, *(len(name) + 2 for name, _ in rows)])
    lines = [f"{heading:<{first}}" + "".join(f"{column:>{_WIDTH}}" for column in columns)]
    lines += [f"{name:<{first}}" + "".join(_cell(values[column]) for column in columns) for name, values in rows]
    return "\n".join(lines)


def _cell(value: float | None) -> str:
    if value is None:
        return f"{'-':>{_WIDTH}}"
    return f"{value:>{_WIDTH}}" if isinstance(value, int) else f"{value:>{_WIDTH}.3f}"
