"""`unbend openapi`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from unbend.cli.options import output_option


@click.command()
@output_option("Standard output by default.")
def openapi(output: Path | None) -> None:
    """Print the service's OpenAPI document, which is JSON."""
    from unbend.api import Settings, create_app  # noqa: PLC0415

    text = json.dumps(create_app(Settings()).openapi(), indent=2) + "\n"
    if output:
        output.write_text(text)
    else:
        click.echo(text, nl=False)
