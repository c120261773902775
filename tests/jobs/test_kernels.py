"""`compile_kernels` compiles all that a server runs, so that an image with a read-only disk has every kernel."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys

import pytest

from tests.support.each_kind import use_each_kind
from tests.support.server import Server, small_mesh, stored

ALL_KERNELS = """
from importlib import import_module
from pkgutil import walk_packages
import unbend
from numba.core.dispatcher import Dispatcher
from unbend.jobs.kernels import compile_kernels

compile_kernels()
names = [each.name for each in walk_packages(unbend.__path__, "unbend.")]
modules = [name for name in names if not name.endswith(("__main__", "env"))]
kernels = {
    kernel for name in modules for kernel in vars(import_module(name)).values()
    if isinstance(kernel, Dispatcher) and kernel.__module__.startswith("unbend.")
}
used = {kernel for kernel in kernels if kernel.signatures}
assert len(used) > 50
while called := {
    callee for kernel in used for name in kernel.py_func.__code__.co_names
    if (callee := kernel.py_func.__globals__.get(name)) in kernels
} - used:
    used |= called
print("UNUSED", *sorted(f"{kernel.__module__}.{kernel.__name__}" for kernel in kernels - used))
"""
"""Prints the kernels that `compile_kernels` neither calls nor compiles into those that it calls."""

READ_ONLY = """
set -e
mount --bind "$0" "$0"
for folder in $(findmnt --list --noheadings --output TARGET --types ext4,xfs,btrfs,overlay,tmpfs); do
    [ "$folder" = "$0" ] || mount -o remount,bind,ro "$folder"
done
touch "$0/writable"
! touch /read-only 2>/dev/null
exec "$@"
"""
"""Runs a command that can write only the folder $0."""


def overloads(log: str) -> set[str]:
    """Return the machine code that a process loaded from Numba's cache or wrote there: a file for each signature."""
    return set(re.findall(r"data (?:loaded from|saved to) '(.+)'", log))


@pytest.fixture(scope="module")
def compiled() -> str:
    """The output of a process that compiles all kernels."""
    environment = os.environ | {"NUMBA_DEBUG_CACHE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", ALL_KERNELS], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_kernel_is_compiled(compiled):
    assert compiled.splitlines()[-1].split() == ["UNUSED"]


def test_jobs_of_each_kind_use_only_compiled_kernels(compiled, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_DEBUG_CACHE", "1")
    monkeypatch.setenv("PYTHONUNBUFFERED", "1")
    with Server(tmp_path) as server, server.http() as http:
        use_each_kind(http)
    used = overloads(server.log.read_text())
    assert len(used) > 50
    assert used - overloads(compiled) == set()


def test_a_server_needs_to_write_only_its_library_and_temporary_files(compiled, tmp_path):
    within = ["unshare", "--mount", "sh", "-c", READ_ONLY, str(tmp_path)]
    if not shutil.which("unshare") or subprocess.run([*within, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user may not mount folders read-only")
    with Server(tmp_path, within=within) as server, server.http() as http:
        shape = stored(http, small_mesh(1))
        query = {"shape_id": stored(http, small_mesh(2))["id"]}
        ranking = http.post("/v1/queries", json=query).raise_for_status().json()
        assert [match["id"] for match in ranking["shapes"]] == [shape["id"]]
    assert "at run time" not in server.log.read_text()
