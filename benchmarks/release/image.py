"""Builds the container's image in a clean root, and uses a server of it whose disk is read-only.

    python -m benchmarks.release.image [FOLDER]

Needs root, Debian's packages buildah and debootstrap, and the extra `release`. Lints the Dockerfile with hadolint,
runs its steps with buildah, and prints the sizes of the image's parts. Then mounts the image read-only, with a tmpfs
at /tmp and a folder at /library, starts its server as the image's user without capabilities, and makes a job of each
kind. Exits with an error if a step fails, if the driver of PostgreSQL is missing, if a kernel was compiled at run
time, or if the user of the image can write anywhere else. Keeps the images in FOLDER, so that the next run repeats only
what has changed.

No registry of images is needed: a stand-in for the image `python:3.13-slim` is made of Debian's packages. It has the
same Debian and the same version of Python.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import httpx

from benchmarks.common import ROOT, table, write_section
from tests.support.each_kind import use_each_kind

PAGE: Final = ROOT / "docs" / "operations.md"
IMAGE: Final = "unbend:check"
MIRROR: Final = "http://deb.debian.org/debian"
PACKAGES: Final = "ca-certificates,python3,python3-pip,python3-venv"
CERTIFICATES: Final = Path("/etc/ssl/certs/ca-certificates.crt")
LONGEST_SECONDS: Final = 900.0

PRIVATE: Final = """
set -e
root=$1 library=$2; shift 2
mount --bind "$root" "$root"
mount -o remount,bind,ro "$root"
mount -t tmpfs -o size=1g,mode=1777,nosuid,nodev,noexec none "$root/tmp"
mount --bind "$library" "$root/library"
mount --rbind /dev "$root/dev"
mount --rbind /proc "$root/proc"
exec chroot "$root" setpriv --reuid=10001 --regid=10001 --clear-groups --no-new-privs --bounding-set=-all "$@"
"""
"""Runs a command in the mounted image as Docker does with `read_only`, `cap_drop` and `no-new-privileges`."""


DRIVER: Final = "import procrastinate, psycopg; assert psycopg.pq.__impl__ == 'binary'"
"""Fails unless the image can open a library in PostgreSQL, by a driver whose libraries are in the image."""


@dataclass(frozen=True)
class Engine:
    """buildah, with its storage in a folder."""

    folder: Path

    def __call__(self, *arguments: str) -> str:
        """Run a command, and return its output."""
        command = ["buildah", "--root", str(self.folder / "images"), "--runroot", str(self.folder / "run"), *arguments]
        environment = os.environ | {"BUILDAH_ISOLATION": "chroot"}
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        return done.stdout.strip()

    @contextmanager
    def mounted(self, image: str) -> Iterator[tuple[Path, dict[str, Any]]]:
        """Mount a container of an image; give its root, and the configuration of the image."""
        name = self("from", "--pull-never", image)
        try:
            described = json.loads(self("inspect", "--type", "container", name))
            yield Path(self("mount", name)), described["OCIv1"]["config"]
        finally:
            self("rm", name)


def main() -> None:
    missing = [name for name in ("buildah", "debootstrap", "unshare", "setpriv") if not shutil.which(name)]
    if missing or os.geteuid():
        sys.exit(f"image: needs root, and Debian's packages buildah and debootstrap; missing: {missing}")
    subprocess.run([str(Path(sysconfig.get_path("scripts"), "hadolint")), str(ROOT / "Dockerfile")], check=True)
    with TemporaryDirectory(prefix="unbend-image-") as name:
        folder = Path(sys.argv[1] if sys.argv[1:] else name)
        folder.mkdir(exist_ok=True)
        engine = Engine(folder)
        make_stand_in(engine)
        engine("build", "--pull-never", "--layers", "--format", "docker", "--tag", IMAGE, str(ROOT))
        with engine.mounted(IMAGE) as (root, configuration):
            report = [*sizes(root), "", *read_only(root, configuration, folder / "library")]
    write_section(PAGE, "image", "\n".join(report))


def make_stand_in(engine: Engine) -> None:
    """Make an image of Debian's packages, with the name of the image that the Dockerfile begins with."""
    (base,) = re.findall(r"^FROM (\S+:\S+) AS", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    if base in engine("images", "--format", "{{.Name}}:{{.Tag}}").replace("docker.io/library/", "").split():
        return
    with TemporaryDirectory(prefix="unbend-debian-", dir=engine.folder) as name:
        context = Path(name)
        subprocess.run(
            [
                str(shutil.which("debootstrap")),
                "--variant=minbase",
                f"--include={PACKAGES}",
                "stable",
                str(context / "debian"),
                MIRROR,
            ],
            stdout=subprocess.DEVNULL,
            check=True,
        )
        # A machine behind a proxy has certificates of its own. The build uses them, and so must pip and npm.
        shutil.copy(CERTIFICATES, context / "certificates")
        (context / "Dockerfile").write_text(
            "FROM scratch\nADD debian /\n"
            f"COPY certificates {CERTIFICATES}\n"
            f"ENV NODE_EXTRA_CA_CERTS={CERTIFICATES} PIP_CERT={CERTIFICATES}\n"
            "RUN ln -s python3 /usr/bin/python && rm -rf /var/cache/apt/archives/*.deb\n"
        )
        engine("build", "--tag", f"docker.io/library/{base}", str(context))


def sizes(root: Path) -> Iterator[str]:
    """Return the sizes of the parts that the image adds to its base."""
    packages = next((root / "opt/unbend/venv/lib").glob("python*/site-packages"))
    folders = {
        "all of `/opt/unbend`": root / "opt/unbend",
        "compiled kernels": root / "opt/unbend/kernels",
        **{f"{path.name}": path for path in packages.iterdir() if path.is_dir() and size(path) > 5},
    }
    rows = sorted(((f"{size(path):.0f}", name) for name, path in folders.items()), key=lambda row: -float(row[0]))
    yield table(["Part", "MB"], [(name, megabytes) for megabytes, name in rows])


def size(folder: Path) -> float:
    """Return the bytes of all files below a folder, in millions."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if not path.is_dir()) / 1e6


def read_only(root: Path, configuration: dict[str, Any], library: Path) -> Iterator[str]:
    """Use a server of the image, and return what was found."""
    shutil.rmtree(library, ignore_errors=True)
    library.mkdir()
    os.chown(library, 10001, 10001)
    environment = dict(line.split("=", 1) for line in configuration["Env"])
    inside = ["unshare", "--mount", "sh", "-c", PRIVATE, "sh", str(root), str(library)]
    places = run([*inside, "find", "/", "-xdev", "-writable", "-not", "-type", "l"], environment)
    if set(places) != {"/tmp", "/library"}:  # noqa: S108
        sys.exit(f"image: the user of the image can write to {places}")
    subprocess.run([*inside, "python", "-c", DRIVER], env=environment, check=True)
    log = library.parent / "server.log"
    command = [*inside, *configuration["Entrypoint"], "serve", "--host", "127.0.0.1", "--port", "0", "--workers", "2"]
    with log.open("w") as stream:
        process = subprocess.Popen(command, env=environment, stdout=stream, stderr=stream)
    try:
        url = wait_for(lambda: re.search(r"running on (http://[\d.:]+)", log.read_text()), process, log)[1]
        wait_for(lambda: httpx.get(f"{url}/v1/readyz").is_success, process, log)
        with httpx.Client(base_url=url, timeout=300.0) as http:
            kinds = use_each_kind(http)
    finally:
        process.terminate()
        process.wait(60)
    compiled = re.findall(r"compiled <function (\w+)", log.read_text())
    if compiled:
        sys.exit(f"image: kernels were compiled at run time: {compiled}")
    yield f"The server made {kinds} jobs and files without compiling a kernel."


def run(command: Sequence[str], environment: dict[str, str]) -> list[str]:
    found = subprocess.run(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False
    )
    return found.stdout.split()


def wait_for(find: Any, process: subprocess.Popen[bytes], log: Path) -> Any:
    """Poll until `find` returns something."""
    end = time.monotonic() + LONGEST_SECONDS
    while process.poll() is None and time.monotonic() < end:
        if found := find():
            return found
        time.sleep(0.02)
    sys.exit(f"image: the server failed:\n{log.read_text()}")


if __name__ == "__main__":
    main()
