"""The notebooks of docs/notebooks run from the first cell to the last, and find what they say they find."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from math import pi
from pathlib import Path

import pytest

from tests.support.server import without_settings
from unbend.mesh.shapes import cylinder, ellipsoid, s_bend, sheet
from unbend.mesh.write import write_mesh

for needed in ("ipykernel", "matplotlib", "nbclient", "nbformat", "pandas"):
    pytest.importorskip(needed, reason="the extra `test` is not installed")

import nbformat  # noqa: E402

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "docs" / "notebooks"
NAMES = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
SECONDS = 300
"""Longest time of a cell: its first run may compile kernels on a busy machine."""

Execute = Callable[[str, dict[str, object]], tuple[Path, subprocess.CompletedProcess[str]]]
Run = Callable[..., "Outputs"]


class Outputs:
    """The outputs of the cells of an executed notebook."""

    def __init__(self, notebook: nbformat.NotebookNode) -> None:
        self.all = [output for cell in notebook.cells for output in cell.get("outputs", [])]

    def texts(self) -> str:
        """Return all that the cells print and show as text."""
        return "\n".join(
            output.text if output.output_type == "stream" else output.data.get("text/plain", "") for output in self.all
        )

    def html(self) -> str:
        return "\n".join(output.data.get("text/html", "") for output in self.all if "data" in output)

    def figures(self) -> int:
        return sum("image/png" in output.data for output in self.all if "data" in output)

    def galleries(self) -> list[list[str]]:
        """Return the captions of the pictures of each gallery."""
        found = re.findall(r'<div style="display: flex.*?</div>', self.html(), re.DOTALL)
        return [re.findall(r'<img src="data:image/\w+;base64,[^"]+" alt="([^"]*)"', gallery) for gallery in found]


@pytest.fixture(scope="module")
def execute(tmp_path_factory: pytest.TempPathFactory) -> Execute:
    """A function that executes a notebook in a new folder, with Jupyter's own command, and a home without settings."""
    # Without them, matplotlib reads no style of the user's, IPython no profile, and Jupyter no other kernels.
    environment = {name: value for name, value in without_settings().items() if not is_the_users(name)}
    environment |= {name: str(tmp_path_factory.mktemp(name.lower())) for name in ("HOME", "TMPDIR")}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT / "service"), os.environ.get("PYTHONPATH")]))

    def execute_one(name: str, values: dict[str, object]) -> tuple[Path, subprocess.CompletedProcess[str]]:
        notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
        for variable, value in values.items():
            give(notebook, variable, value)
        path = tmp_path_factory.mktemp(name) / f"{name}.ipynb"
        nbformat.write(notebook, path)
        command = [sys.executable, "-c", "from nbclient.cli import main; main()", str(path), "--inplace"]
        command += [f"--timeout={SECONDS}", "--kernel_name=python3"]
        return path, subprocess.run(command, capture_output=True, text=True, check=False, env=environment)

    return execute_one


@pytest.fixture(scope="module")
def run(execute: Execute) -> Run:
    """A function that executes a notebook, once for the same values, and returns its outputs."""
    done: dict[tuple[str, str], Outputs] = {}

    def succeed(name: str, **values: object) -> Outputs:
        key = (name, repr(values))
        if key not in done:
            path, result = execute(name, values)
            assert result.returncode == 0, result.stderr
            done[key] = Outputs(nbformat.read(path, as_version=4))
        return done[key]

    return succeed


@pytest.fixture(scope="module")
def fails(execute: Execute) -> Callable[..., str]:
    """A function that executes a notebook that ends with an error, and returns what it says."""

    def fail(name: str, **values: object) -> str:
        _, result = execute(name, values)
        assert result.returncode != 0
        return result.stderr

    return fail


def is_the_users(name: str) -> bool:
    return name.startswith(("IPYTHON", "JUPYTER", "MPL", "XDG_"))


def give(notebook: nbformat.NotebookNode, variable: str, value: object) -> None:
    """Give a variable another value, as a reader does who edits the cell `VARIABLE = None`."""
    (cell,) = [cell for cell in notebook.cells if cell.source == f"{variable} = None"]
    cell.source = f"{variable} = {value!r}"


def test_there_are_four_notebooks():
    assert NAMES == ["a-part-against-wholes", "classify-your-folder", "find-near-duplicates", "the-papers-story"]


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_stored_without_outputs(name):
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
    assert set(notebook.metadata) == {"kernelspec", "language_info"}


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_without_warnings(name, run):
    outputs = run(name)
    streams = {output.name for output in outputs.all if output.output_type == "stream"}
    assert streams <= {"stdout"}  # Python prints warnings on stderr
    assert outputs.galleries()
    assert outputs.figures() > 0


def test_the_papers_story(run):
    outputs = run("the-papers-story")
    assert "best class 'biped', known" in outputs.texts()
    assert outputs.galleries() == [["flat", "bent"], ["standing", "kicking"], ["standing", "kicking"]]
    stress = {
        method: float(value) for method, value in re.findall(r"^(\w+) .* (0\.\d+)$", outputs.texts(), re.MULTILINE)
    }
    assert stress["least_squares"] < min(stress["classical"], stress["fast"])
    changes = dict(re.findall(r"^of the (\w+) +(0\.\d+)$", outputs.texts(), re.MULTILINE))
    assert float(changes["signature"]) < float(changes["surface"])


def test_the_small_shapes_are_classified(run):
    text = run("classify-your-folder").texts()
    assert "12 shapes; 0 files refused; 0 with a warning" in text
    for label in ("biped", "hand", "sheet", "snake"):
        assert re.search(rf"^{label}/{label}3.ply +{label} .* True$", text, re.MULTILINE)
    assert re.search(r"nearest class: \w+ - known: False", text)


def test_a_folder_of_the_readers_is_classified(run, tmp_path):
    grid = {"columns": 20, "rows": 10}
    mine = {
        "paper": [sheet(**grid), cylinder(0.5 * pi, **grid), cylinder(pi, **grid), s_bend(**grid)],
        "egg": [ellipsoid((1.0, 1.0, height), subdivisions=2) for height in (1.3, 1.4, 1.45, 1.35)],
    }
    for label, surfaces in mine.items():
        (tmp_path / label).mkdir()
        for number, surface in enumerate(surfaces):
            (tmp_path / label / f"{number}.off").write_bytes(write_mesh(surface.vertices, surface.faces, "off"))
    (tmp_path / "egg" / "0-broken.off").write_text("OFF\n1 0 0\n")
    unknown, kept = tmp_path / "mine.off", tmp_path / "kept.db"
    egg = ellipsoid((1.0, 1.0, 1.37), subdivisions=2)
    unknown.write_bytes(write_mesh(egg.vertices, egg.faces, "off"))
    text = run("classify-your-folder", FOLDER=str(tmp_path), UNKNOWN=str(unknown), LIBRARY=str(kept)).texts()
    assert "mine.off is most likely: egg" in text
    assert kept.exists()
    assert "6 shapes; 1 files refused; 0 with a warning" in text
    assert "egg/0-broken.off: " in text
    assert re.search(r"^egg +3 +0\npaper +0 +3$", text, re.MULTILINE)  # the confusion table
    for label in mine:
        assert re.search(rf"^{label}/3.off +{label} ", text, re.MULTILINE)


@pytest.mark.parametrize(
    ("files", "values", "said"),
    [
        ([], {"FOLDER": "nowhere"}, "FOLDER: there is no folder"),
        (["a.off", "b.off"], {}, "needs a subfolder for each class"),
        (["cat/a.off", "cat/b.off"], {}, "no class has three files, so there is no mesh to ask about"),
        (["cat/a.off", "cat/b.off"], {"UNKNOWN": "nothing.off"}, "UNKNOWN: there is no file"),
    ],
)
def test_a_folder_that_cannot_be_classified_says_why(fails, tmp_path, files, values, said):
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("OFF\n")
    assert said in fails("classify-your-folder", **{"FOLDER": str(tmp_path)} | values)


def test_duplicates_are_found(run):
    outputs = run("find-near-duplicates")
    all_shapes, *groups = outputs.galleries()
    assert len(all_shapes) == 11
    assert groups == [["scan-01", "scan-03", "scan-04"], ["scan-02", "scan-08"], ["scan-06", "scan-10"]]
    assert "False scan-01 11" in outputs.texts()  # the equal file was stored once


def test_the_whole_of_a_part_is_found(run):
    outputs = run("a-part-against-wholes")
    assert "if it is a piece, ask with the measure <code>partial</code>" in outputs.html()
    assert re.search(r"^1 +hand \d .* part ", outputs.texts(), re.MULTILINE)
    matched, vertices = re.search(r"PointMap\((\d+) of (\d+) vertices matched", outputs.texts()).groups()
    assert int(matched) > 0.95 * int(vertices)
    assert outputs.figures() == 5
