"""Memory, file descriptors and threads of a running process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_KB = 1024


@dataclass(frozen=True)
class Footprint:
    """The resources of a process; memory is in bytes."""

    resident: int
    own: int
    """Private memory, which would be free if the process ended."""
    handles: int
    threads: int


def footprint(pid: int) -> Footprint:
    """Return the resources of a process; raise OSError if there is no such process."""
    folder = Path(f"/proc/{pid}")
    rows = dict(line.split(":", 1) for line in (folder / "smaps_rollup").read_text().splitlines()[1:])
    kilobytes = {name: int(value.split()[0]) for name, value in rows.items()}
    return Footprint(
        resident=kilobytes["Rss"] * _KB,
        own=(kilobytes["Private_Clean"] + kilobytes["Private_Dirty"]) * _KB,
        handles=sum(1 for _ in (folder / "fd").iterdir()),
        threads=sum(1 for _ in (folder / "task").iterdir()),
    )


def is_asleep(pid: int) -> bool:
    return _state(pid) == "S"


def writes_to_a_pipe(pid: int) -> bool:
    """Tell whether a process waits to write to a full pipe; False if the system does not show this."""
    try:
        return "pipe_w" in Path(f"/proc/{pid}/wchan").read_text()
    except OSError:
        return False


def processes_with(setting: str) -> list[int]:
    """Return the processes that were started with an environment variable, given as `NAME=value`."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            environment = (folder / "environ").read_bytes()
        except OSError:
            continue
        if setting.encode() in environment.split(b"\0") and _state(int(folder.name)) not in {"Z", None}:
            found.append(int(folder.name))
    return sorted(found)


def _state(pid: int) -> str | None:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return None
