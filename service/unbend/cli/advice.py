"""Advice on errors in the words of the command line: the advice of an error is for callers of Python and HTTP."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import click

from unbend import errors

_LATER: Final = "Run the command again later."

_ADVICE: Final[Mapping[type[errors.UnbendError], str]] = MappingProxyType(
    {
        errors.MeshFormatError: "Use an off, obj, ply, stl or glb file.",
        errors.NotFoundError: "Check the identifier: `{listing}` prints those that exist.",
        errors.KeyRequiredError: "Set UNBEND_API_KEY; `unbend keys create` makes keys, where the library is.",
        errors.KeyInvalidError: "Check UNBEND_API_KEY; the key may be revoked, or belong to another library.",
        errors.ServiceError: "Check that `unbend serve` runs there, and the address in --url or UNBEND_URL.",
        errors.StoreError: "Check --library, or UNBEND_LIBRARY.",
        errors.RateLimitError: _LATER,
        errors.BusyError: _LATER,
        errors.QueueFullError: _LATER,
        errors.CallTimeoutError: "Use fewer samples or another measure, or raise UNBEND_CALL_SECONDS of the service.",
    }
)
"""Advice on errors that have none, or whose advice names HTTP headers or Python methods. {listing} is a command."""

_LISTINGS: Final[Mapping[str, str]] = MappingProxyType({"jobs": "unbend jobs", "revoke": "unbend keys list"})
"""The command that prints the identifiers of jobs or keys, by the name of the command that takes them."""


def advice_for(error: errors.UnbendError, command: click.Command | None, context: click.Context) -> str:
    """Return what to do about an error of `command`, which the group of `context` ran; empty if there is no advice."""
    name = (command and command.name) or ""
    own = error.advice
    if own and own != type(error).advice:  # advice on this error, not on its class
        return own
    if isinstance(error, errors.ExistsError):
        return "Name another place, or replace it with --force." if _has(command, "force") else "Name another place."
    if type(error) is errors.ParameterError:
        return f"Correct the argument named in the message; `{context.command_path} {name} --help` describes it."
    return _ADVICE.get(type(error), own).format(listing=_LISTINGS.get(name, "unbend list"))


def _has(command: click.Command | None, option: str) -> bool:
    return command is not None and any(parameter.name == option for parameter in command.params)
