"""The sources of a server's settings, and the checks before it starts."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from tomllib import TOMLDecodeError
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, TomlConfigSettingsSource
from sqlalchemy import make_url
from sqlalchemy.exc import ArgumentError

from unbend.api.server.settings import ENVIRONMENT_PREFIX, Settings
from unbend.errors import ParameterError

OTHER_VARIABLES: Final = frozenset(
    {
        "UNBEND_CONFIG", "UNBEND_URL", "UNBEND_API_KEY", "UNBEND_SHARED_DATA", "UNBEND_REQUIRE_SHARED",
        "UNBEND_REQUIRE_BROWSER", "UNBEND_REQUIRE_POSTGRES", "UNBEND_CHROMIUM", "UNBEND_WITHOUT_PAGE",
    }
)  # fmt: skip
"""Variables with the prefix that are not settings: those of the command line, the clients, and the tests."""

TRACING: Final = ("opentelemetry.sdk", "opentelemetry.exporter.otlp.proto.http", "opentelemetry.instrumentation.asgi")
"""Packages of the extra `traces`."""

_LINK: Final = re.compile(
    r"UNBEND_(\w+_)?(SERVICE_(HOST|PORT(_\w+)?)=.*|PORT_\d+_(TCP|UDP|SCTP)(_(PROTO|PORT|ADDR))?=.*|PORT=\w+://.*)"
)
"""Variables that Kubernetes sets in all containers for a service named unbend or unbend-something."""

_SECRET: Final = frozenset({"library", "traces"})  # URLs may contain a password

Written = Callable[[str], str]
"""Returns the name of a setting as its source has it: an option, variable or key."""


@dataclass(frozen=True)
class _File:
    """A settings file; `path` is None if there is none."""

    path: Path | None
    source: TomlConfigSettingsSource

    @property
    def values(self) -> Mapping[str, Any]:
        return self.source.toml_data

    def written(self, name: str) -> str:
        return f"{self.path}: {name}"


def read_settings(options: Mapping[str, Any], path: Path | None = None) -> Settings:
    """Read the settings of a server, and check them.

    Parameters
    ----------
    options : mapping
        Values of command line options, by field. They override the environment, which overrides the file.
    path : Path, optional
        A TOML file whose keys are the names of the fields.

    Raises
    ------
    ParameterError
        If a value is invalid, or a name is unknown. The message names each setting as its source does.
    """
    try:
        file = _open(path.expanduser() if path else None)
    except RuntimeError:
        raise ParameterError(f"{path}: there is no such user") from None
    if problems := [*_unknown_variables(os.environ), *_wrong_keys(file)]:
        raise ParameterError("; ".join(problems))

    class Given(Settings):
        @classmethod
        def settings_customise_sources(
            cls,
            settings_cls: type[BaseSettings],  # noqa: ARG003
            init_settings: PydanticBaseSettingsSource,
            env_settings: PydanticBaseSettingsSource,
            dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003
            file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            return init_settings, env_settings, file.source

    written = _places(options, file)
    try:
        settings = Given(**options)
    except ValidationError as error:
        problems = [_sentence(problem, str(problem["loc"][0]), written) for problem in error.errors()]
        raise ParameterError("; ".join(problems)) from None
    if problem := library_problem(settings.library):
        raise ParameterError(f"{written('library')}: the library cannot be opened: {problem}")
    if settings.traces and not all(map(_is_installed, TRACING)):
        raise ParameterError(f"{written('traces')}: traces need more packages: pip install 'unbend[traces]'")
    return settings


def library_problem(url: str) -> str | None:
    """Return the reason why a library's file cannot be used; None if there is none. Other databases are not checked."""
    try:
        parsed = make_url(url) if "://" in url else None
    except ArgumentError:
        return "neither a path nor the URL of a database"
    if parsed is not None and parsed.get_backend_name() != "sqlite":
        return None
    name = url if parsed is None else parsed.database or ":memory:"
    if name == ":memory:" or name.startswith("file:"):
        return "it must be in a file, which worker processes can open"
    try:
        return _path_problem(Path(name))
    except OSError as error:
        return f"{error.filename}: {error.strerror}"
    except ValueError:  # a NUL character
        return f"{name!r} is not a path"


def _path_problem(given: Path) -> str | None:
    try:
        path = given.expanduser()
    except RuntimeError:
        return f"{given}: there is no such user"
    folder = path.parent
    if path.is_dir():
        return f"{path} is a folder"
    if not folder.is_dir():
        return f"there is no folder {folder}"
    if not _may(folder, os.W_OK | os.X_OK):  # SQLite creates files next to the library
        return f"the folder {folder} cannot be written"
    return f"{path} cannot be written" if path.exists() and not _may(path, os.R_OK | os.W_OK) else None


def _may(path: Path, mode: int) -> bool:
    return os.access(path, mode, effective_ids=os.access in os.supports_effective_ids)


def _is_installed(package: str) -> bool:
    try:
        return find_spec(package) is not None
    except ModuleNotFoundError:  # its parent package is not installed either
        return False


def _open(path: Path | None) -> _File:
    if path and not path.is_file():  # pydantic ignores missing files
        raise ParameterError(f"{path}: there is no such settings file")
    try:
        return _File(path, TomlConfigSettingsSource(Settings, path))
    except OSError as error:
        raise ParameterError(f"{path}: {error.strerror}") from None
    except (TOMLDecodeError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: not TOML: {error}") from None


def _unknown_variables(environment: Mapping[str, str]) -> list[str]:
    known = {f"{ENVIRONMENT_PREFIX}{name.upper()}" for name in Settings.model_fields}
    return [
        f"{name} is not a setting{_nearest(name.upper(), known)}"
        for name, value in sorted(environment.items())
        if name.upper().startswith(ENVIRONMENT_PREFIX)
        and name.upper() not in known | OTHER_VARIABLES
        and not _LINK.fullmatch(f"{name}={value}")
    ]


def _nearest(name: str, known: Collection[str]) -> str:
    """Return the end of a sentence, which suggests the most similar known name."""
    bare = {each.removeprefix(ENVIRONMENT_PREFIX): each for each in known}
    found = get_close_matches(name.removeprefix(ENVIRONMENT_PREFIX), bare, n=1)
    return f"; did you mean {bare[found[0]]}?" if found else ""


def _wrong_keys(file: _File) -> list[str]:
    """Return the problems of a file: unknown keys, and values with a wrong TOML type."""
    problems = []
    for key, value in file.values.items():
        field = Settings.model_fields.get(key)
        if field is None:
            problems.append(f"{file.written(key)} is not a setting{_nearest(key, Settings.model_fields)}")
            continue
        try:
            TypeAdapter[Any](field.annotation or object).validate_python(value, strict=True)
        except ValidationError as error:
            problems += [_sentence(problem, key, file.written) for problem in error.errors()]
    return problems


def _places(options: Mapping[str, Any], file: _File) -> Written:
    def written(name: str) -> str:
        variable = f"{ENVIRONMENT_PREFIX}{name.upper()}"
        if name in options:
            return f"--{name}"
        found = [each for each in os.environ if each.upper() == variable]
        return found[0] if found else file.written(name) if name in file.values else variable

    return written


def _sentence(problem: ErrorDetails, name: str, written: Written) -> str:
    context = problem.get("ctx", {})
    text = str(context.get("error", problem["msg"]))
    if "setting" in context:  # a conflict with another setting
        text = text.replace(context["setting"], written(context["setting"]))
    value = "" if name in _SECRET else f" is {problem['input']!r}"
    return f"{written(name)}{value}: {text[0].lower()}{text[1:]}"
