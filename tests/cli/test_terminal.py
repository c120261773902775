"""Behaviour that all commands have in common: --json, --verbose, --quiet, help, tables, and advice."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import get_args

import click
import numba
import pytest
from click.shell_completion import BashComplete
from click.testing import CliRunner

from tests.support.commands import failed_with_a_sentence, in_process, on_terminal, succeeded, unbend
from tests.support.server import DAMAGED, SAMPLES, ply, without_settings
from unbend import Library, MeshPolicy, Parameters
from unbend.cli import options
from unbend.cli.group import CommandGroup
from unbend.cli.main import main
from unbend.cli.tables import table
from unbend.correspondence.match import Turn
from unbend.correspondence.pieces import Part
from unbend.embedding.embed import Criterion, Method
from unbend.embedding.weighting import Weighting
from unbend.errors import ParameterError
from unbend.geodesics.distances import Update
from unbend.jit import NotCompiledError, is_compiled, kernel, on_compilation, without_compiling
from unbend.library.keys import Scope
from unbend.matching import partial
from unbend.matching.classification import CLASSIFIERS, DEFAULT_CLASSIFIER
from unbend.matching.measures.registry import DEFAULT_MEASURE, PAIR_MEASURES, VECTOR_MEASURES
from unbend.mesh.policy import Components, Seams
from unbend.mesh.shapes import torus
from unbend.render.colours import ThemeName
from unbend.render.request import Subject, Up
from unbend.results.jobs import JobState
from unbend.results.rankings import DEFAULT_K
from unbend.results.shapes import IfKnown
from unbend.signature.parameters import FirstSample, Scaling


def all_commands(group: click.Group = main, prefix: str = "") -> dict[str, click.Command]:
    """Return every command by its words."""
    found: dict[str, click.Command] = {}
    for name, command in group.commands.items():
        words = f"{prefix} {name}".strip()
        found |= all_commands(command, words) if isinstance(command, click.Group) else {words: command}
    return found


@pytest.fixture
def mesh(tmp_path):
    path = tmp_path / "ring.ply"
    path.write_bytes(ply(torus(columns=10, rows=6)))
    return path


def test_the_names_in_help_are_those_of_the_registries():
    assert tuple(VECTOR_MEASURES) == options.VECTOR_MEASURES
    assert tuple(PAIR_MEASURES) == options.PAIR_MEASURES
    assert tuple(partial.PART_MEASURES) == options.PART_MEASURES
    assert tuple(CLASSIFIERS) == options.CLASSIFIERS
    assert options.VECTOR_MEASURES[0] == DEFAULT_MEASURE
    assert options.CLASSIFIERS[0] == DEFAULT_CLASSIFIER


@pytest.mark.parametrize(
    ("words", "name", "kind"),
    [
        ("signature", "method", Method), ("signature", "update", Update), ("signature", "scaling", Scaling),
        ("signature", "first_sample", FirstSample), ("signature", "weights", Weighting),
        ("signature", "criterion", Criterion), ("signature", "components", Components), ("signature", "seams", Seams),
        ("show", "subject", Subject), ("show", "theme", ThemeName), ("show", "up", Up), ("match", "orientation", Turn),
        ("match", "part", Part), ("jobs", "state", JobState), ("import", "if_known", IfKnown),
        ("keys create", "scope", Scope),
    ],
)  # fmt: skip
def test_the_choices_in_help_are_those_of_the_package(words, name, kind):
    (option,) = (parameter for parameter in all_commands()[words].params if parameter.name == name)
    assert set(option.type.choices) == set(get_args(kind))


def test_the_defaults_in_help_are_those_of_the_package():
    own = {parameter.name: parameter for parameter in all_commands()["query"].params}
    values = Parameters().as_dict() | MeshPolicy().as_dict() | {"k": DEFAULT_K}
    expected = {name: value for name, value in values.items() if value is not None}  # None has no option
    context = click.Context(main)
    assert {name: own[name].get_default(context) for name in expected} == expected


@pytest.mark.parametrize("words", sorted(all_commands()))
def test_help_names_the_places_with_their_defaults_and_variables(words):
    command = all_commands()[words]
    text = " ".join(succeeded(*words.split(), "--help", run=in_process).stdout.split())
    names = {parameter.name for parameter in command.params}
    if "library" in names:
        assert "env var: UNBEND_LIBRARY; default: unbend.db" in text
    if "url" in names:
        assert "env var: UNBEND_URL" in text
        assert "UNBEND_API_KEY" in text
    assert "-v, --verbose" in text
    assert "-q, --quiet" in text
    assert all(parameter.help for parameter in command.params if isinstance(parameter, click.Option))


def test_every_command_that_prints_a_result_has_json():
    without = {
        words
        for words, command in all_commands().items()
        if "as_json" not in {parameter.name for parameter in command.params}
    }
    assert without == {"serve", "worker", "openapi"}


def test_each_result_is_one_json_document(mesh, tmp_path):
    library, new = ["--library", tmp_path / "a.db"], tmp_path / "new"
    few = ["--samples", 30]
    (tmp_path / "in").mkdir()
    (tmp_path / "in/ring.ply").write_bytes(mesh.read_bytes())
    (tmp_path / "landmarks.csv").write_text("3\n")
    expected = {
        ("import", tmp_path / "in", *library, *few): {"attempted": 1, "new": 1, "failed": 0},
        ("compare", mesh, mesh, *few): {"measure": "spectrum", "distance": 0.0},
        ("signature", mesh, "-o", tmp_path / "s.ply", *few): {"output": str(tmp_path / "s.ply"), "points": 30},
        ("flatten", mesh, "-o", tmp_path / "f.obj", *few): {"output": str(tmp_path / "f.obj")},
        ("show", mesh, "-o", tmp_path / "p.png"): {"width": 512, "height": 512, "stress": None},
        ("match", mesh, mesh, "-o", tmp_path / "m.npz", "--samples", 40): {"output": str(tmp_path / "m.npz")},
        ("symmetry", mesh, "-o", tmp_path / "y.npz", "--samples", 40): {"output": str(tmp_path / "y.npz")},
        (
            "transfer", mesh, tmp_path / "landmarks.csv", mesh, "-o", new, "--landmarks", "--samples", 40
        ): {},
        ("export", tmp_path / "out", *library): {"folder": str(tmp_path / "out"), "shapes": 1},
        ("backup", tmp_path / "copy.db", *library): {"path": str(tmp_path / "copy.db"), "shapes": 1},
        ("backup", tmp_path / "copy.db", "--verify"): {"shapes": 1},
        ("restore", tmp_path / "copy.db", "--library", tmp_path / "b.db"): {"shapes": 1},
        ("complete", *library): {"completed": []},
        ("keys", "create", "reader", *library): {"name": "reader", "scope": "read"},
        ("demo", "--write", tmp_path / "demo"): {"place": str(tmp_path / "demo")},
    }  # fmt: skip
    for command, members in expected.items():
        done = succeeded(*command, "--json", run=in_process)
        document = json.loads(done.stdout)
        assert members.items() <= document.items(), command
        assert done.stdout.count("\n") == 1


def test_verbose_says_what_is_done_before_or_after_the_command(mesh):
    command = ["signature", mesh, "--samples", 20]
    plain = succeeded(*command, run=in_process)
    assert plain.stderr == ""
    for words in (["-v", *command], [*command, "--verbose"]):
        done = succeeded(*words, run=in_process)
        assert done.stdout == plain.stdout
        assert "ring.ply: geodesics: " in done.stderr
        assert all(line.startswith("unbend: ") for line in done.stderr.splitlines())


def test_verbose_names_the_requests_to_a_service(server):
    done = succeeded("list", "--url", server.url, "--limit", 1, "-v", run=in_process)
    assert f"GET {server.url}/v1/shapes" in done.stderr
    assert succeeded("list", "--url", server.url, "--limit", 1, run=in_process).stderr == ""


def test_quiet_prints_only_errors(mesh, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/bad.off").write_bytes(DAMAGED)
    (tmp_path / "in/ring.ply").write_bytes(mesh.read_bytes())
    done = in_process("import", tmp_path / "in", "--library", tmp_path / "a.db", "--samples", 20, "--quiet")
    assert (done.returncode, done.stdout) == (4, "")
    (line,) = done.stderr.splitlines()
    assert "bad.off" in line
    done = succeeded("-q", "signature", mesh, "-o", tmp_path / "x.ply", "--samples", 20, run=in_process)
    assert done.stdout == done.stderr == ""
    done = succeeded("-q", "compare", mesh, mesh, "--samples", 20, run=in_process)
    assert (done.stdout, done.stderr) == ("0\n", "")
    failed_with_a_sentence(in_process("-q", "list", "--library", tmp_path / "no.db"), "no library")


@pytest.mark.parametrize("words", [["-q", "-v", "list"], ["-q", "list", "-v"], ["list", "-v", "-q"]])
def test_verbose_and_quiet_exclude_each_other(words):
    failed_with_a_sentence(in_process(*words), "--verbose and --quiet exclude each other", status=2)


@pytest.mark.parametrize(
    ("words", "begun", "offered"),
    [
        ([], "li", {"list"}),
        (["query", "--measure"], "part", {"partial", "partial_any_scale"}),
        (["list"], "--lab", {"--label"}),
        (["show"], "ring", {"ring"}),  # a file: the shell completes it
    ],
)
def test_shells_complete_commands_options_values_and_files(words, begun, offered):
    shell = BashComplete(main, {}, "unbend", "_UNBEND_COMPLETE")
    found = shell.get_completions(words, begun)
    assert {item.value for item in found} == offered
    assert {item.type for item in found} == ({"file"} if words == ["show"] else {"plain"})


@click.group(cls=CommandGroup)
def group() -> None:
    """Group commands that fail."""


@group.command()
def bug() -> None:
    """Fail unexpectedly."""
    raise ZeroDivisionError("by zero")


@group.command()
@click.option("--size", type=int)
def wrong(size: int | None) -> None:
    """Fail because of an argument."""
    raise ParameterError(f"size must be positive, not {size}")


def test_an_unexpected_error_is_a_sentence_and_its_traceback_is_kept_for_verbose():
    done = CliRunner().invoke(group, ["bug"])
    assert done.exit_code == 70
    assert done.stderr.splitlines()[0] == "unbend: unexpected error: ZeroDivisionError: by zero"
    assert "--verbose" in done.stderr
    assert "Traceback" not in done.stderr
    for words in (["-v", "bug"], ["bug", "-v"]):
        done = CliRunner().invoke(group, words)
        assert done.exit_code == 70
        assert "Traceback" in done.stderr
        assert "in bug" in done.stderr


def test_advice_fits_the_command(mesh, tmp_path):
    done = CliRunner().invoke(group, ["wrong", "--size", "-1"])
    assert "`group wrong --help`" in done.stderr.splitlines()[1]
    with Library(str(tmp_path / "a.db")) as library:
        library.add(mesh, parameters=SAMPLES)
    place = ["--library", tmp_path / "a.db"]
    (tmp_path / "copy.db").touch()
    assert "--force" in in_process("backup", tmp_path / "copy.db", *place).stderr
    assert "--force" in in_process("restore", tmp_path / "a.db", "--library", tmp_path / "copy.db").stderr
    taken = in_process("export", tmp_path, *place)
    failed_with_a_sentence(taken, "not an empty folder")
    assert "--force" not in taken.stderr
    assert "UNBEND_URL" in in_process("list", "--url", "http://127.0.0.1:9").stderr
    assert "`unbend keys list`" in in_process("keys", "revoke", "nobody", *place).stderr
    (tmp_path / "x.step").write_text("not a mesh")
    assert "Use an off" in in_process("signature", tmp_path / "x.step").stderr


def test_a_plain_table_keeps_whole_names_on_one_line():
    long = "n" * 300
    text = table(["name", "count"], [[long, 7], ["two\nlines\x1b[31m", None], ["[bold]x", 12]], numbers=("count",))
    lines = text.splitlines()
    assert len(lines) == 4
    assert lines[1] == f"{long}      7"
    assert lines[2].split() == ["two\\nlines\\x1b[31m", "-"]
    assert lines[3].split() == ["[bold]x", "12"]
    assert "\x1b" not in text


def test_a_table_on_a_terminal_folds_long_names(mesh, tmp_path):
    name = "[bold]" + "n" * 150
    with Library(str(tmp_path / "a.db")) as library:
        library.add(mesh, name=name, parameters=SAMPLES)
    command = [sys.executable, "-m", "unbend", "list", "--library", tmp_path / "a.db"]
    status, text = on_terminal(command, "stdout")
    assert status == 0
    assert "[bold]" in text
    assert text.count("n" * 20) >= 2  # folded into several lines
    assert max(len(line) for line in text.splitlines()) < 150
    assert text.count("n") >= 150


@numba.njit
def slow_to_compile(x):  # enough code that its compilation takes longer than a thousandth of a second
    return sum([x**power for power in range(9)])


def test_a_compilation_is_announced_once():
    said: list[str] = []
    stop = on_compilation(lambda: said.append("compiling"), after=0.001)
    try:
        assert said == []
        slow_to_compile(2.0)
        slow_to_compile(2)  # another type: compiled again
        assert said == ["compiling"]
        stop_again = on_compilation(lambda: said.append("more"), after=0.001)
        slow_to_compile(3.0)  # compiled already
        time.sleep(0.05)
        stop_again()
        assert said == ["compiling"]
    finally:
        stop()


def test_a_kernel_on_disk_is_compiled_and_another_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    double = kernel(_double)
    assert not is_compiled(double)
    assert double(2.0) == 4.0
    assert is_compiled(double)


def test_nothing_is_compiled_where_that_is_not_allowed(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    double, again = kernel(_double), kernel(_double)
    with without_compiling(), pytest.raises(NotCompiledError):
        double(2.0)
    assert not is_compiled(double)
    assert double(2.0) == 4.0
    with without_compiling():
        assert again(2.0) == 4.0  # from the disk


def _double(x):
    return 2 * x


def test_the_first_minute_is_not_silent(mesh, tmp_path):
    output = tmp_path / "s.npz"
    succeeded("signature", mesh, "-o", output, "--samples", 20, run=in_process)  # its kernels are on disk
    assert "Compiling" not in unbend("signature", mesh, "-o", output, "--samples", 20).stderr
    command = [sys.executable, "-m", "unbend", "signature", str(mesh), "-o", str(tmp_path / "t.npz")]
    environment = without_settings(NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as cold:
        assert cold.stderr is not None
        assert cold.stderr.readline().startswith("Compiling the kernels, once on this machine")
        cold.kill()
