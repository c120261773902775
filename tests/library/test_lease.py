"""The lease of a library: only one process holds it, and it ends with that process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from unbend import Library
from unbend.errors import StoreError, StoreInUseError
from unbend.library.storage.lease import Lease

HOLD = """
import sys
from unbend.library.storage.lease import Lease

held = Lease(sys.argv[1])
print("held", flush=True)
input()
"""


def test_a_second_lease_is_refused_with_the_id_of_the_first_process(tmp_path):
    url = str(tmp_path / "library.db")
    with Lease(url), pytest.raises(StoreInUseError, match=f"process {os.getpid()}"):
        Lease(url)
    with Lease(url), Library(url) as library:  # the lease does not prevent reading and writing
        assert len(library) == 0


def test_a_lease_ends_when_its_process_is_killed(tmp_path):
    url = str(tmp_path / "library.db")
    with subprocess.Popen([sys.executable, "-c", HOLD, url], stdout=subprocess.PIPE, stdin=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(StoreInUseError, match=f"process {other.pid}"):
            Lease(url)
        other.send_signal(signal.SIGKILL)
        other.wait(30)
    Lease(url).close()


def test_a_link_to_a_library_has_the_same_lease(tmp_path):
    link = tmp_path / "elsewhere" / "link.db"
    link.parent.mkdir()
    link.symlink_to(tmp_path / "library.db")
    with Lease(str(tmp_path / "library.db")), pytest.raises(StoreInUseError, match=f"process {os.getpid()}"):
        Lease(str(link))


def test_libraries_in_memory_have_no_lease():
    with Lease("sqlite://"), Lease("sqlite://"):
        pass


def test_a_lease_in_a_missing_folder_is_a_store_error(tmp_path):
    with pytest.raises(StoreError, match="No such file"):
        Lease(str(tmp_path / "nowhere" / "library.db"))
