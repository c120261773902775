"""The number of a shard, and the files that belong to it."""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final, Self

from unbend.errors import ParameterError

MOST_SHARDS: Final = 100_000

_TEXT: Final = re.compile(r"(\d{1,9})/(\d{1,9})")


@dataclass(frozen=True)
class ShardNumber:
    """Shard `number` of `count`, from 1 to `count`."""

    number: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the number of a text such as "3/16"; ParameterError if it is none."""
        match = _TEXT.fullmatch(text)
        found = cls(*map(int, match.groups())) if match else None
        if found is None or not 1 <= found.number <= found.count <= MOST_SHARDS:
            raise ParameterError(f"a shard is I/N with I from 1 to N and N at most {MOST_SHARDS}, not {text!r}")
        return found

    def has(self, path: PurePosixPath) -> bool:
        """Return whether a file belongs to this shard.

        It depends only on the file's path, so that further files change the shard of no file.
        """
        digest = hashlib.sha256(os.fsencode(path.as_posix())).digest()
        return int.from_bytes(digest[:8], "big") % self.count == self.number - 1

    @property
    def stem(self) -> str:
        """The beginning of the names of this shard's files, such as "03-of-16"."""
        return f"{self.number:0{len(str(self.count))}}-of-{self.count}"

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"
