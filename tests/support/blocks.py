"""The code blocks of Markdown pages."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

SHELL = "sh"


@dataclass(frozen=True)
class Block:
    """A code block of a page."""

    page: Path
    line: int
    """The line of its first command, from 1."""
    language: str
    """The word after the fence; a block that is indented is a shell block."""
    text: str
    reason: str
    """Why it cannot run in a test; empty if it can. A comment above the block says so: `<!-- not run: reason -->`."""


def blocks(page: Path) -> list[Block]:
    """Return all code blocks of a page, in their order."""
    found, reason = [], ""
    for token in MarkdownIt().enable("table").parse(page.read_text()):
        if token.type in {"fence", "code_block"}:
            first = (token.map or [0])[0] + 1 + (token.type == "fence")
            language = token.info.strip() if token.type == "fence" else SHELL
            found.append(Block(page, first, language, token.content, reason))
        comment = re.fullmatch(r"<!-- not run: (.+?) -->", token.content.strip(), re.DOTALL)
        reason = comment[1] if token.type == "html_block" and comment else ""
    return found
