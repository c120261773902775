"""The command group."""

from __future__ import annotations

import os

import click

from unbend import __version__
from unbend.cli.backup import backup, restore
from unbend.cli.compare import compare
from unbend.cli.complete import complete
from unbend.cli.compute import compute
from unbend.cli.demo import demo
from unbend.cli.evaluate import evaluate
from unbend.cli.export import export
from unbend.cli.flatten import flatten
from unbend.cli.group import CommandGroup
from unbend.cli.importing import import_folder
from unbend.cli.index import index
from unbend.cli.jobs import jobs
from unbend.cli.keys import keys
from unbend.cli.label import label
from unbend.cli.listing import list_shapes
from unbend.cli.match import match
from unbend.cli.migrate import migrate, migrate_library
from unbend.cli.openapi import openapi
from unbend.cli.query import query
from unbend.cli.remove import remove
from unbend.cli.serve import serve
from unbend.cli.show import show
from unbend.cli.signature import signature
from unbend.cli.sweep import sweep
from unbend.cli.symmetry import symmetry
from unbend.cli.transfer import transfer
from unbend.cli.worker import worker

# Set before NumPy is loaded. unbend uses all cores with its own threads and processes. OpenBLAS' threads would slow
# them down, because they spin while they wait, and unbend's matrices are too small to gain from them.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_ENVIRONMENT = """\b
Environment:
  UNBEND_LIBRARY  the library, if --library is not given
  UNBEND_OBJECTS  its object store, if --objects is not given
  UNBEND_URL      the address of a service, if --url is not given
  UNBEND_API_KEY  the key that is sent to the service
  UNBEND_CONFIG   the file of settings of `unbend serve`
"""


@click.group(cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"]}, epilog=_ENVIRONMENT)
@click.version_option(__version__, prog_name="unbend")
def main() -> None:
    """Recognise shapes however they bend."""


for command in (
    serve, signature, flatten, show, compare, match, transfer, symmetry, compute, import_folder, export, list_shapes,
    label, remove, query, evaluate, jobs, complete, backup, restore, migrate, migrate_library,
    keys, openapi, demo, worker, index, sweep,
):  # fmt: skip
    main.add_command(command)
