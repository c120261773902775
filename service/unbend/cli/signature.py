"""`unbend signature`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import click

from unbend.cli.folders.account import account_for, accounting, meshes_of, report_option
from unbend.cli.folders.computing import Machine, machine_options
from unbend.cli.folders.files import MeshPaths
from unbend.cli.group import EXIT_SOME_FAILED
from unbend.cli.mesh_file import read_file
from unbend.cli.options import Values, json_option, parameter_options, policy_options
from unbend.cli.terminal import confirm_file, prepare_kernels, stages

FORMATS: Final = ("json", "npz", "ply", "obj", "off", "glb")


@click.command()
@click.argument("meshes", metavar="MESH...", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="A ply, obj, off, glb, npz or json file; json on standard output by default. A folder for several meshes.",
)
@click.option("--format", "file_type", type=click.Choice(FORMATS), help="Format for several meshes; json by default.")
@click.option("--whole", is_flag=True, help="Place every vertex, not only the samples: the form at full resolution.")
@report_option
@json_option
@machine_options
@parameter_options
@policy_options
def signature(
    meshes: tuple[Path, ...],
    output: Path | None,
    file_type: str | None,
    whole: bool,
    report: Path | None,
    as_json: bool,
    machine: Machine,
    parameters: Values,
    policy: Values,
) -> None:
    """Compute the signature of MESH, or of several meshes and folders of meshes.

    Several meshes are computed on all cores. The signature of DIR/a/cat.off is OUTPUT/a/cat.off.json. Standard error
    says what happened to the files, and --report to each of them. The exit status is 4 if some failed.
    """
    if len(meshes) == 1 and meshes[0].is_file():
        if file_type or report:
            raise click.UsageError("--format and --report are for several meshes")
        if output and output.is_dir():
            raise click.UsageError(f"{output} is a folder, and the output for one mesh is a file")
        _one(meshes[0], output, whole, as_json, parameters, policy)
        return
    if output is None:
        raise click.UsageError("several meshes need a folder for their signatures: -o")
    if output.exists() and not output.is_dir():
        raise click.UsageError(f"{output} is not a folder, and the output for several meshes is a folder")
    from unbend.cli.folders.signatures import write_signatures  # noqa: PLC0415

    source = MeshPaths(meshes, [output, report] if report else [output])
    prepare_kernels()
    with accounting(source.root, report, kept="the signatures of the other files are not written") as account:
        files = meshes_of(source, account)
        written = write_signatures(
            files, account.meshes, source.root, output, file_type or "json", whole, machine, parameters, policy
        )
        account_for(written, account, "computing signatures")
    account.print_result("signatures written", as_json=as_json)
    if account.has_faults:
        sys.exit(EXIT_SOME_FAILED)


def _one(mesh: Path, output: Path | None, whole: bool, as_json: bool, parameters: Values, policy: Values) -> None:
    from unbend.mesh.write import check_format  # noqa: PLC0415
    from unbend.signature.canonical_form import canonical_form  # noqa: PLC0415
    from unbend.signature.export import export_form, export_signature  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415
    from unbend.signature.pipeline import compute_signature  # noqa: PLC0415

    file_type = check_format(output.suffix.lower().lstrip(".") if output else "json")
    chosen = Parameters.from_dict(parameters)
    surface = read_file(mesh, policy)
    with stages(mesh.name) as progress:
        found = compute_signature(surface, chosen, progress=progress)
    if whole:
        form = canonical_form(surface, signature=found)
        data, points = export_form(form, file_type), form.points
    else:
        data, points = export_signature(found, file_type), found.points
    if output:
        output.write_bytes(data)
        count, dimensions = points.shape
        text = f"{count:,} points in {dimensions} dimensions, stress {found.stress:.4g}"
        figures = {"points": count, "dimensions": dimensions, "stress": float(found.stress)}
        confirm_file(output, text, figures, as_json=as_json)
    else:
        click.echo(data.decode())
