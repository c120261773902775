"""Options of an import, and how they apply to each file."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from unbend.cli.folders.computing import Machine
from unbend.cli.folders.files import LabelledFile
from unbend.cli.options import Values
from unbend.errors import MeshReadError
from unbend.mesh.policy import MeshPolicy

if TYPE_CHECKING:
    from unbend.results.shapes import IfKnown, ShapeRecord

labels_option = click.option(
    "--labels", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="CSV: path, class."
)


def check_labels(labels: Path | None, label_from: str | None) -> None:
    """Check the options for classes; UsageError if they exclude each other, or the file can be read only once."""
    if labels and label_from:
        raise click.UsageError("--labels and --label-from exclude each other")
    if labels and not labels.is_file():
        raise click.UsageError("--labels must be a file on disk, because it is read twice")


KEPT_CLASS: Final = "class kept because the row has none"


@dataclass(frozen=True)
class ImportOptions:
    """The options of an import. Those that are given for all files override those of a file."""

    parameters: Values
    policy: Values
    if_known: IfKnown
    with_parts: bool
    """Whether to compute the local signatures too."""
    machine: Machine

    def check(self) -> None:
        """Raise ParameterError if the options are invalid; otherwise every file would fail."""
        from unbend.signature.parameters import Parameters  # noqa: PLC0415

        Parameters.from_dict(self.parameters)
        MeshPolicy.from_dict(self.policy)

    def parameters_of(self, file: LabelledFile) -> Values:
        """Return the parameters of a file."""
        return file.parameters | self.parameters

    def policy_of(self, file: LabelledFile) -> Values:
        """Return the reading policy of a file."""
        return file.policy | self.policy

    def if_known_of(self, first: Path | None) -> IfKnown:
        """Return what a known shape takes from a file; `first` is an earlier file of the same content.

        A later one changes nothing. Otherwise files of the same content and different classes would change the shape in
        each import.
        """
        return "keep" if first else self.if_known

    def content_of(self, file: LabelledFile) -> tuple[str, bytes]:
        """Return the SHA-256 of a file, and a key that is equal for files that are one shape.

        Raises
        ------
        MeshReadError
            If the file cannot be read.
        """
        try:
            with file.path.open("rb") as opened:
                sha256 = hashlib.file_digest(opened, "sha256").hexdigest()
        except OSError as error:
            raise MeshReadError(f"the file cannot be read: {error.strerror}") from None
        content = json.dumps([sha256, self.parameters_of(file), self.policy_of(file)], sort_keys=True)
        return sha256, hashlib.sha256(content.encode()).digest()


def kept_class(file: LabelledFile, shape: ShapeRecord) -> str:
    """Return why a known shape keeps its class although a row of the file of labels has none; empty otherwise."""
    return KEPT_CLASS if file.is_row and file.label is None and shape.label is not None else ""


def description_of(file: LabelledFile) -> dict[str, Any]:
    """Return the given fields of a file's shape."""
    given = {"name": file.name, "label": file.label, "metadata": file.metadata}
    return {field: value for field, value in given.items() if value is not None}
