"""Writes what the service contains: an SBOM, and the licences of its dependencies.

    python -m benchmarks.release.licences [FOLDER]

Needs the extra `release`. Installs the service with the extra `cluster`, as the container's image does, in a fresh
environment, and writes its components to FOLDER (dist by default) as a CycloneDX document, sbom.json, and the texts of
all licences, licences.txt. Writes the section "licences" of docs/operations.md. Exits with an error if a licence is
none of those in ALLOWED, which permit to distribute the service under the MIT licence.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import sysconfig
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from benchmarks.common import ROOT, table, write_section

PAGE: Final = ROOT / "docs" / "operations.md"
TOOLS: Final = Path(sysconfig.get_path("scripts"))

ALLOWED: Final = (
    "0BSD", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "CC0-1.0", "HPND", "ISC", "LGPL-3.0-only", "MIT", "MIT-0",
    "MIT-CMU", "MPL-2.0", "PSF-2.0", "Unlicense", "Zlib",
    "BSD-2-Clause-Views", "Apache-2.0 WITH LLVM-exception", "GPL-3.0-or-later WITH GCC-exception-3.1",
    "Apache License 2.0", "Apache Software License", "BSD", "BSD License", "ISC License (ISCL)", "MIT License",
    "Mozilla Public License 2.0 (MPL 2.0)", "Python Software Foundation License",
)  # fmt: skip
"""SPDX expressions, and names that older packages use instead. MPL binds changes of its own files only. LGPL binds a
library that anybody can replace, as a package of Python can. The exceptions permit to ship the compilers' libraries
with any program."""


def main() -> None:
    output = Path(sys.argv[1] if sys.argv[1:] else ROOT / "dist")
    output.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix="unbend-licences-") as name:
        python = Path(name, "bin", "python")
        subprocess.run([TOOLS / "uv", "venv", "--quiet", "--python", sys.executable, name], check=True)
        subprocess.run([TOOLS / "uv", "pip", "install", "--quiet", "--python", python, f"{ROOT}[cluster]"], check=True)
        subprocess.run(
            [TOOLS / "cyclonedx-py", "environment", "--pyproject", str(ROOT / "pyproject.toml"), "--of", "JSON",
             "--output-reproducible", "-o", str(output / "sbom.json"), python],
            check=True,
        )  # fmt: skip
        found = licences(python, "--format=json")
        (output / "licences.txt").write_text(
            licences(
                python, "--format=plain-vertical", "--with-license-file", "--with-notice-file", "--no-license-path"
            )
        )
    packages = {row["Name"]: row["License"] for row in json.loads(found) if row["Name"] != "unbend"}
    components = json.loads((output / "sbom.json").read_text())["components"]
    assert packages.keys() <= {component["name"] for component in components} | {"pip", "uv"}
    strange = {name: licence for name, licence in packages.items() if not is_allowed(licence)}
    if strange:
        sys.exit(f"licences: look at {strange}")
    by_licence: dict[str, list[str]] = {}
    for name, licence in sorted(packages.items()):
        by_licence.setdefault(licence, []).append(name)
    rows = [(licence, ", ".join(names)) for licence, names in sorted(by_licence.items())]
    write_section(PAGE, "licences", table(["Licence, as the package names it", "Packages"], rows))


def licences(python: Path, *options: str) -> str:
    """Return what pip-licenses reports about an environment."""
    command = [TOOLS / "pip-licenses", f"--python={python}", "--from=mixed", "--with-system", *options]
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout


def is_allowed(expression: str) -> bool:
    """Return whether each part of an expression is allowed, or one part of each alternative."""
    return all(
        any({part.strip(), part.strip(" ()")} & set(ALLOWED) for part in either.split(" OR "))
        for either in re.split(r" AND |; ", expression)
    )


if __name__ == "__main__":
    main()
