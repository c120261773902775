"""`unbend show`: the picture that it writes, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from tests.support.commands import failed_with_a_sentence, in_process, succeeded
from tests.support.server import ply
from unbend import Parameters, canonical_form, read_mesh
from unbend.mesh.shapes import torus
from unbend.render.picture import render_picture
from unbend.render.request import PictureRequest


@pytest.fixture(scope="module")
def mesh(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("meshes") / "ring.ply"
    path.write_bytes(ply(torus(columns=12, rows=8)))
    return path


def test_a_surface_is_drawn(mesh, tmp_path):
    output = tmp_path / "picture.PNG"
    done = succeeded("show", mesh, "-o", output)
    assert done.stdout == ""
    assert "512 x 512 pixels" in done.stderr
    assert output.read_bytes() == render_picture(PictureRequest(), read_mesh(mesh))


def test_every_option_reaches_the_picture(mesh, tmp_path):
    output = tmp_path / "picture.webp"
    done = succeeded(
        "show", mesh, "-o", output, "--subject", "both", "--size", "300x200", "--theme", "dark", "--from", 3, "--to",
        40, "--contours", "--azimuth", 20, "--elevation", 5, "--up", "y", "--samples", 20, run=in_process,
    )  # fmt: skip
    assert "300 x 200 pixels, stress" in done.stderr
    request = PictureRequest(
        width=300, height=200, format="webp", subject="both", theme="dark", azimuth=20.0, elevation=5.0, up="y",
        distances_from=3, contours=True, path=(3, 40),
    )  # fmt: skip
    surface = read_mesh(mesh)
    form = canonical_form(surface, Parameters(samples=20))
    assert output.read_bytes() == render_picture(request, surface, form)
    with Image.open(output) as picture:
        assert picture.size == (300, 200)


def test_a_dimension_brings_its_number_of_dimensions(mesh, tmp_path):
    output = tmp_path / "picture.png"
    succeeded("show", mesh, "-o", output, "--dimension", 5, "--samples", 20, run=in_process)
    form = canonical_form(read_mesh(mesh), Parameters(samples=20, dimensions=5))
    assert output.read_bytes() == render_picture(PictureRequest(dimension=5), read_mesh(mesh), form)
    refused = in_process("show", mesh, "-o", output, "--dimension", 5, "--dimensions", 4, "--samples", 20)
    failed_with_a_sentence(refused, "no dimension 5")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--size", "8x300"], "width must be"),
        (["--to", "3"], "--to goes with --from"),
        (["--from", "999"], "--from: the mesh has no vertex 999"),
        (["--from", "-1"], "--from must be"),
        (["--from", "1", "--to", "999"], "--from or --to: the mesh has no vertex 999"),
        (["--dimension", "3"], "--dimension must be"),
        (["--from", "1", "--dimension", "4"], "--dimension: give --from or --dimension"),
        (["--contours"], "--contours go with --from or --dimension only"),
        (["--elevation", "100"], "elevation must be"),
        (["--samples", "2"], "samples must be"),
    ],
)
def test_what_is_out_of_range_is_refused_with_a_sentence(mesh, tmp_path, options, words):
    output = tmp_path / "picture.png"
    failed_with_a_sentence(in_process("show", mesh, "-o", output, *options), words)
    assert not output.exists()


@pytest.mark.parametrize("options", [["--size", "300"], ["--size", "ax3"], ["--theme", "red"], ["--up", "w"]])
def test_options_that_cannot_be_understood_show_the_usage(mesh, tmp_path, options):
    failed_with_a_sentence(in_process("show", mesh, "-o", tmp_path / "picture.png", *options), "Usage", status=2)


def test_an_unknown_kind_of_file_is_refused(mesh, tmp_path):
    failed_with_a_sentence(in_process("show", mesh, "-o", tmp_path / "picture.gif"), "png, webp")
