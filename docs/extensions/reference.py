"""Directives that make the reference from the code: public names, commands, requests, errors, settings.

Each directive writes Markdown, so that the pages that contain it need no list of their own. A public name that no page
documents is a warning, and so an error of `make docs`.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar

import click
from annotated_types import Ge, Gt, Le, Lt
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

import unbend
from unbend.api import Settings
from unbend.api.schema.problems import STATUS
from unbend.api.server.settings import ENVIRONMENT_PREFIX
from unbend.cli.main import main
from unbend.errors import UnbendError, subclasses

if TYPE_CHECKING:
    from docutils import nodes
    from pydantic.fields import FieldInfo
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment

OPENAPI = Path(__file__).parents[2] / "openapi" / "openapi.json"
BOUNDS = {Ge: ("at least", "ge"), Gt: ("above", "gt"), Le: ("at most", "le"), Lt: ("below", "lt")}
log = logging.getLogger(__name__)


def table(header: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table; cells keep their own bars and lines apart."""
    cells = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(" ".join(c.split()).replace("|", "\\|") for c in row) + " |" for row in cells)


class Generated(SphinxDirective):
    """A directive that is replaced by Markdown."""

    has_content = False

    def text(self) -> str:
        """Return the Markdown."""
        raise NotImplementedError

    def run(self) -> list[nodes.Node]:
        """Parse the Markdown in the place of the directive."""
        return self.parse_text_to_nodes(self.text(), allow_section_headings=True)


class PublicNames(Generated):
    """The public names that the given layers of the package define, each with its docstring."""

    required_arguments = 1
    final_argument_whitespace = True

    def text(self) -> str:
        """Return one autodoc directive for each name."""
        layers = self.arguments[0].split()
        return "\n\n".join(autodoc(name) for name in unbend.__all__ if layer_of(getattr(unbend, name)) in layers)


class ModuleNames(Generated):
    """The public names of a module: those that follow its name, or all of its `__all__`, each with its docstring."""

    required_arguments = 1
    final_argument_whitespace = True

    def text(self) -> str:
        """Return one autodoc directive for each name."""
        path, *names = self.arguments[0].split()
        module = import_module(path)
        return "\n\n".join(autodoc(name, module) for name in names or module.__all__)


def autodoc(name: str, module: ModuleType = unbend) -> str:
    """Return the directive that documents a public name of a module."""
    found = getattr(module, name)
    kind, options = "autofunction", []
    if isinstance(found, type):
        kind, options = "autoclass", ["   :members:"]
        # Other packages have pages of their own for what is inherited from them.
        if all(base.__module__.partition(".")[0] in {"unbend", "builtins", "typing"} for base in found.__mro__):
            options.append("   :inherited-members: Exception, BaseException, tuple")
    members = "".join(f"{option}\n" for option in options)
    return f"```{{eval-rst}}\n.. {kind}:: {module.__name__}.{name}\n{members}```"


def layer_of(found: Any) -> str:
    """Return the layer of the package that defines an object; empty if it is not of the package."""
    package, _, rest = str(found.__module__).partition(".")
    return rest.partition(".")[0] if package == "unbend" else ""


class Commands(Generated):
    """Every command of the terminal."""

    def text(self) -> str:
        """Return a section for each command."""
        return "\n\n".join(sections(click.Context(main, info_name="unbend")))


def sections(context: click.Context) -> Iterator[str]:
    """Yield the section of a command, and those of its own commands."""
    command = context.command
    parts = [f"## `{context.command_path}`", inspect.cleandoc(command.help or "")]
    parts += [f"```text\n{' '.join([context.command_path, *command.collect_usage_pieces(context)])}\n```"]
    options = [parameter for parameter in command.params if isinstance(parameter, click.Option)]
    records = [record for option in options if (record := option.get_help_record(context))]
    if records:
        parts.append(table(["option", "meaning"], [[f"`{names}`", markdown(text)] for names, text in records]))
    yield "\n\n".join(parts)
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            yield from sections(click.Context(command.commands[name], info_name=name, parent=context))


def markdown(text: str) -> str:
    """Return the text of a terminal as Markdown: its defaults and choices are no links."""
    return text.replace("[", "\\[").replace("<", "\\<")


class Errors(Generated):
    """Every error, in the order of the tree."""

    def text(self) -> str:
        """Return a table of codes, HTTP statuses, classes, meanings and advice."""
        rows = [
            [f"`{kind.code}`", str(status_of(kind)), f"`{kind.__name__}`", first_sentence(kind), kind.advice]
            for kind in subclasses(UnbendError)
        ]
        return table(["code", "status", "class", "meaning", "advice"], rows)


def status_of(kind: type[UnbendError]) -> int:
    """Return the HTTP status of an error class."""
    return next(STATUS[base] for base in kind.__mro__ if base in STATUS)


def first_sentence(documented: object) -> str:
    """Return the first paragraph of a docstring."""
    return (documented.__doc__ or "").split("\n\n")[0]


class ServerSettings(Generated):
    """Every setting of a server."""

    def text(self) -> str:
        """Return a table of variables, defaults, bounds and meanings."""
        rows = [
            [f"`{ENVIRONMENT_PREFIX}{name.upper()}`", default_of(field), bounds_of(field), field.description or ""]
            for name, field in Settings.model_fields.items()
        ]
        return table(["variable", "default", "allowed", "meaning"], rows)


def default_of(field: FieldInfo) -> str:
    """Return the default of a setting, as a user would write it."""
    if field.default_factory is not None:
        return "computed"
    value = field.default
    text = str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)
    return f"`{text}`" if text else "empty"


def bounds_of(field: FieldInfo) -> str:
    """Return the bounds of a setting in words."""
    found = [
        f"{words} {getattr(bound, attribute):,}"
        for bound in field.metadata
        for kind, (words, attribute) in BOUNDS.items()
        if isinstance(bound, kind)
    ]
    return ", ".join(found)


class Requests(Generated):
    """Every HTTP request of the OpenAPI document."""

    METHODS: ClassVar = ("get", "post", "patch", "put", "delete")

    def text(self) -> str:
        """Return a section for each request."""
        document = json.loads(OPENAPI.read_text())
        self.env.note_dependency(str(OPENAPI))
        return "\n\n".join(
            request(document, method, path, operations[method])
            for path, operations in document["paths"].items()
            for method in self.METHODS
            if method in operations
        )


def request(document: dict[str, Any], method: str, path: str, operation: dict[str, Any]) -> str:
    """Return the section of one request."""
    parts = [f"## `{method.upper()} {path}`", operation.get("description", operation["summary"])]
    fields = [*parameters(document, operation), *body_fields(document, operation)]
    if fields:
        parts.append(table(["in", "field", "required", "meaning"], fields))
    parts.append(table(["status", "response"], list(responses(document, operation))))
    return "\n\n".join(parts)


def parameters(document: dict[str, Any], operation: dict[str, Any]) -> Iterator[list[str]]:
    """Yield a row for each parameter of a path, a query string or a header."""
    for parameter in operation.get("parameters", ()):
        found = resolved(document, parameter)
        yield row(
            found["in"],
            found["name"],
            found.get("required", False),
            resolved(document, found.get("schema", {})) | found,
        )


def body_fields(document: dict[str, Any], operation: dict[str, Any]) -> Iterator[list[str]]:
    """Yield a row for each field of each body."""
    for media_type, content in operation.get("requestBody", {}).get("content", {}).items():
        schema = resolved(document, content["schema"])
        for name, found in schema.get("properties", {}).items():
            yield row(f"`{media_type}`", name, name in schema.get("required", ()), resolved(document, found))


def row(place: str, name: str, is_required: bool, schema: dict[str, Any]) -> list[str]:
    """Return the row of a field."""
    default = schema.get("default")
    meaning = schema.get("description", "")
    if "enum" in schema:
        meaning = f"{meaning} One of {', '.join(f'`{value}`' for value in schema['enum'])}."
    if default not in (None, ""):
        meaning = f"{meaning} Default: `{json.dumps(default)}`."
    return [place, f"`{name}`", "yes" if is_required else "", meaning]


def resolved(document: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema in the place of a reference to it."""
    if "$ref" not in schema:
        return schema
    _, _, kind, name = schema["$ref"].split("/")
    found: dict[str, Any] = document["components"][kind][name]
    return found


def responses(document: dict[str, Any], operation: dict[str, Any]) -> Iterator[list[str]]:
    """Yield a row for each status."""
    for status, response in operation["responses"].items():
        found = resolved(document, response)
        types = ", ".join(f"`{name}`" for name in found.get("content", ()))
        yield [status, f"{found['description']} {types}"]


def check_public_names(_: Sphinx, env: BuildEnvironment) -> None:
    """Warn of public names that no page documents."""
    documented = {name for name, _, _, _, _, _ in env.domains.python_domain.get_objects()}
    for name in unbend.__all__:
        if f"unbend.{name}" not in documented:
            log.warning("no page of docs/reference documents unbend.%s", name)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("public-names", PublicNames)
    app.add_directive("module-names", ModuleNames)
    app.add_directive("commands", Commands)
    app.add_directive("errors", Errors)
    app.add_directive("settings", ServerSettings)
    app.add_directive("requests", Requests)
    app.connect("env-check-consistency", check_public_names)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
