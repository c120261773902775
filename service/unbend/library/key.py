"""What makes two uploads the same."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Self

from unbend.mesh.policy import MeshPolicy
from unbend.signature.parameters import Parameters
from unbend.signature.signature import ALGORITHM_VERSION


@dataclass(frozen=True)
class UploadKey:
    """A file's bytes, how they are read, and what is computed of them: done and stored once for each key."""

    sha256: str
    parameters: str
    policy: str
    version: str = ALGORITHM_VERSION

    @classmethod
    def of(cls, data: bytes, parameters: Parameters, policy: MeshPolicy) -> Self:
        """Return the key of a file to be computed by this version."""
        return cls(hashlib.sha256(data).hexdigest(), parameters.to_json(), policy.to_json())
