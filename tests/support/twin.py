"""The synchronous client as a copy of the asynchronous one: `make client` runs this file."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "service" / "unbend" / "client"
SOURCE, TWIN = FOLDER / "async_client.py", FOLDER / "sync_client.py"

_HEADER = '"""The synchronous client. `make client` writes this file from `async_client.py`: edit that one."""'

_REPLACEMENTS = {
    r'\A""".*?"""': _HEADER,
    r"    Its methods are coroutines:.*?\n\n": "",
    r"import asyncio\n": "",
    r"\basyncio\.sleep\b": "time.sleep",
    r"\bhttpx\.AsyncClient\b": "httpx.Client",
    r"\bAsyncClient\b": "SyncClient",
    r"\bAsyncJob\b": "Job",
    r"\bAsyncIterator\b": "Iterator",
    r"\b(a)(close|read|iter_lines)\(": r"\2(",
    r"__a(enter|exit|iter)__": r"__\1__",
    r"\basync ": "",
    r"\bawait ": "",
}


def synchronous(source: str) -> str:
    """Return the synchronous form of the text of a module, formatted."""
    for pattern, replacement in _REPLACEMENTS.items():
        source = re.sub(pattern, replacement, source, flags=re.DOTALL)
    for command in (["check", "--fix", "--unsafe-fixes", "--quiet", "--select", "I,UP028,UP034"], ["format"]):
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "--stdin-filename", str(TWIN), "-"],
            input=source, capture_output=True, text=True, check=True,
        )  # fmt: skip
        source = done.stdout
    return source


if __name__ == "__main__":
    TWIN.write_text(synchronous(SOURCE.read_text()))
