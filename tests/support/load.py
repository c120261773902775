"""Clients that send random requests to a real server, and check later responses against earlier ones."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import httpx
import numpy as np

from tests.support.server import DAMAGED, SAMPLES, ply
from unbend.mesh.shapes import torus

ENDED: Final = {"succeeded", "failed", "cancelled"}
SIZES: Final = ((10, 6), (12, 8), (14, 10), (18, 14))
"""Columns and rows of the tori that clients send, of 60 to 252 vertices."""

MIX: Final = {"upload": 30, "query": 25, "look": 10, "again": 5, "damaged": 5, "change": 10, "remove": 10, "cancel": 5}
"""Frequency of each call, in percent."""

_MOST_PENDING: Final = 4
_SAMPLE: Final = 20


@dataclass(frozen=True)
class Pending:
    """An acknowledged job, and the states in which it may end."""

    kind: str
    data: bytes
    ends: frozenset[str]


@dataclass(frozen=True)
class Kept:
    """An acknowledged shape: its file, and its possible labels."""

    data: bytes
    labels: frozenset[str | None]


class Caller:
    """A client that uploads, queries, changes, removes and cancels at random, and remembers the responses.

    No other client sends the same meshes. A request without a response, because the server was killed, may have had
    its effect or not. An acknowledged effect must persist.

    Parameters
    ----------
    number : int
        Number of the caller, unique in a run.
    seed : int
    most_kept : int, optional
        Largest number of shapes that the caller keeps in the library; beyond it, the caller removes its oldest shape.
    """

    def __init__(self, number: int, seed: int, *, mix: dict[str, int] = MIX, most_kept: int | None = None) -> None:
        self.faults: list[str] = []
        self.acknowledged = 0
        self.kept: dict[str, Kept] = {}
        self.gone: set[str] = set()
        self.ended: dict[str, dict] = {}
        self._number = number
        self._random = np.random.default_rng([seed, number])
        self._calls = list(mix)
        self._shares = np.array(list(mix.values())) / sum(mix.values())
        self._most_kept = most_kept
        self._sent = 0
        self._pending: dict[str, Pending] = {}
        self._removing: set[str] = set()
        self._recent: set[str] = set()

    def run(self, url: str, going_on: Callable[[], bool]) -> None:
        """Send random requests while `going_on` returns true, or until the server is gone."""
        with self._http(url) as http, contextlib.suppress(httpx.TransportError):
            while going_on():
                self._step(http)

    def settle(self, url: str) -> None:
        """Wait for the end of every job."""
        with self._http(url) as http:
            while self._pending:
                self._wait(http)

    def check(self, url: str, *, everything: bool = False) -> None:
        """Check all recent acknowledgements and a sample of earlier ones, or everything."""
        with self._http(url) as http:
            for shape_id in [*self._removing]:
                self._find_out(http, shape_id)
            for shape_id in self._chosen(self.kept, everything):
                self._check_shape(http, shape_id)
            for shape_id in self._chosen(self.gone, everything):
                self._expect(http.get(f"/v1/shapes/{shape_id}"), 404)
            for job_id in self._chosen(self.ended, everything):
                if not _is_still(http.get(f"/v1/jobs/{job_id}").json(), self.ended[job_id]):
                    self.faults.append(f"job {job_id} changed after its end")
        self._recent.clear()

    # Calls

    def _step(self, http: httpx.Client) -> None:
        if len(self._pending) >= _MOST_PENDING:
            self._wait(http)
        elif self._most_kept is not None and len(self.kept) > self._most_kept:
            self._remove(http)
        else:
            getattr(self, f"_{self._random.choice(self._calls, p=self._shares)}")(http)

    def _upload(self, http: httpx.Client) -> None:
        label = str(self._random.choice(["ring", "tyre"]))
        self._send(http, "shapes", self._mesh(), {"succeeded"}, label=label)

    def _query(self, http: httpx.Client) -> None:
        data = self._mesh()
        if self._random.random() < 0.5:
            self._send(http, "queries", data, {"succeeded"})
            return
        self.acknowledged += 1  # the request waits for the result
        response = self._post(http, "queries", data, headers={"Prefer": "wait=60"})
        self._expect(response, 200)

    def _damaged(self, http: httpx.Client) -> None:
        self._sent += 1
        kind = "shapes" if self._random.random() < 0.5 else "queries"
        self._send(http, kind, DAMAGED + f"# {self._number} {self._sent}\n".encode(), {"failed"}, name="mesh.off")

    def _again(self, http: httpx.Client) -> None:
        if shape_id := self._any():
            response = self._post(http, "shapes", self.kept[shape_id].data)
            if self._expect(response, 200) and response.json()["id"] != shape_id:
                self.faults.append(f"the file of shape {shape_id} was answered with another shape")

    def _look(self, http: httpx.Client) -> None:
        if shape_id := self._any():
            self._expect(http.post("/v1/queries", json={"shape_id": shape_id}), 200)

    def _change(self, http: httpx.Client) -> None:
        if shape_id := self._any():
            kept, label = self.kept[shape_id], f"label {self._random.integers(3)}"
            self.kept[shape_id] = Kept(kept.data, kept.labels | {label})
            self._recent.add(shape_id)
            if self._expect(http.patch(f"/v1/shapes/{shape_id}", json={"label": label}), 200):
                self.kept[shape_id] = Kept(kept.data, frozenset({label}))

    def _remove(self, http: httpx.Client) -> None:
        if self.kept:
            shape_id = next(iter(self.kept))
            self._removing.add(shape_id)
            if self._expect(http.delete(f"/v1/shapes/{shape_id}"), 204):
                self._removed(shape_id)

    def _cancel(self, http: httpx.Client) -> None:
        for _ in range(_MOST_PENDING):  # the last of several jobs is probably still queued
            job_id = self._send(http, "shapes", self._mesh(), {"succeeded"})
        if job_id:
            self._pending[job_id] = Pending("shapes", self._pending[job_id].data, frozenset(ENDED - {"failed"}))
            self._note(job_id, http.delete(f"/v1/jobs/{job_id}").raise_for_status().json())

    def _wait(self, http: httpx.Client) -> None:
        job_id = next(iter(self._pending))
        response = http.get(f"/v1/jobs/{job_id}", params={"wait": 20})
        if self._expect(response, 200):
            self._note(job_id, response.json())
        else:
            del self._pending[job_id]

    # Acknowledgements

    def _send(
        self, http: httpx.Client, kind: str, data: bytes, ends: set[str], *, name: str = "mesh.ply", **fields: str
    ) -> str | None:
        response = self._post(http, kind, data, name=name, **fields)
        if not self._expect(response, 202):
            return None
        self.acknowledged += 1
        job_id = response.json()["id"]
        self._pending[job_id] = Pending(kind, data, frozenset(ends))
        return job_id

    def _post(
        self,
        http: httpx.Client,
        kind: str,
        data: bytes,
        *,
        name: str = "mesh.ply",
        headers: dict[str, str] | None = None,
        **fields: str,
    ) -> httpx.Response:
        fields |= {"parameters": json.dumps(SAMPLES)}
        return http.post(f"/v1/{kind}", files={"file": (name, data)}, data=fields, headers=headers)

    def _note(self, job_id: str, job: dict) -> None:
        if job["state"] not in ENDED:
            return
        pending = self._pending.pop(job_id)
        if job["state"] not in pending.ends:
            self.faults.append(
                f"job {job_id} must end as {'/'.join(pending.ends)}, but is {job['state']}: {job['error']}"
            )
        self.ended[job_id] = job
        self._recent.add(job_id)
        if job["shape_id"]:
            self.kept[job["shape_id"]] = Kept(pending.data, frozenset({None, "ring", "tyre"}))
            self._recent.add(job["shape_id"])

    def _removed(self, shape_id: str) -> None:
        self._removing.discard(shape_id)
        del self.kept[shape_id]
        self.gone.add(shape_id)
        self._recent.add(shape_id)

    def _find_out(self, http: httpx.Client, shape_id: str) -> None:
        """Find out whether a shape is gone; its removal was requested, but not acknowledged."""
        if http.get(f"/v1/shapes/{shape_id}").status_code == httpx.codes.NOT_FOUND:
            self._removed(shape_id)
        self._removing.discard(shape_id)

    def _check_shape(self, http: httpx.Client, shape_id: str) -> None:
        kept, response = self.kept[shape_id], http.get(f"/v1/shapes/{shape_id}")
        if not self._expect(response, 200):
            return
        label = response.json()["label"]
        if label not in kept.labels:
            self.faults.append(f"shape {shape_id} has the label {label} instead of {set(kept.labels)}")
        self.kept[shape_id] = Kept(kept.data, frozenset({label}))
        if http.get(f"/v1/shapes/{shape_id}/mesh").content != kept.data:
            self.faults.append(f"the file of shape {shape_id} differs from the upload")

    def _expect(self, response: httpx.Response, status: int) -> bool:
        if response.status_code != status:
            asked = f"{response.request.method} {response.request.url.path}"
            self.faults.append(f"{asked}: {response.status_code} instead of {status}: {response.text[:200]}")
        return response.status_code == status

    def _chosen(self, reported: dict | set, everything: bool) -> list[str]:
        names = sorted(reported)
        if everything or len(names) <= _SAMPLE:
            return names
        some = self._random.choice(names, _SAMPLE, replace=False).tolist()
        return sorted({*some, *self._recent.intersection(reported)})

    def _any(self) -> str | None:
        return str(self._random.choice(list(self.kept))) if self.kept else None

    def _mesh(self) -> bytes:
        """Return a torus that no caller has sent."""
        self._sent += 1
        columns, rows = SIZES[self._sent % len(SIZES)]
        minor = 0.1 + 0.8 * ((self._sent * 0.6180339887498949 + self._number * 0.1) % 1.0)
        return ply(torus(major=1.0 + 1e-3 * self._number, minor=minor, columns=columns, rows=rows))

    def _http(self, url: str) -> httpx.Client:
        return httpx.Client(base_url=url, timeout=90.0)


def work(callers: Sequence[Caller], url: str, jobs: int) -> None:
    """Have callers send this number of jobs in total, concurrently and at random; wait until all jobs have ended."""

    def share(caller: Caller) -> None:
        enough = caller.acknowledged + jobs // len(callers)
        caller.run(url, lambda: caller.acknowledged < enough)
        caller.settle(url)

    in_threads(lambda caller=caller: share(caller) for caller in callers)


def in_threads(functions: Iterable[Callable[[], object]]) -> None:
    """Run functions in threads, and wait for all of them."""
    threads = [threading.Thread(target=function) for function in functions]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _is_still(job: dict, then: dict) -> bool:
    """Tell whether an ended job is unchanged.

    Removed shapes and classes may be missing from its result, and the names of shapes may have changed.
    """
    result, before = job.pop("result"), then["result"]
    if job != {name: value for name, value in then.items() if name != "result"}:
        return False
    if result is None or before is None:
        return result == before
    parts = {"shapes": ("id", "distance"), "classes": ("label", "distance", "confidence")}
    same = {name: value for name, value in result.items() if name not in parts}.items() <= before.items()
    return same and all(_of(result, *part) <= _of(before, *part) for part in parts.items())


def _of(result: dict, part: str, names: tuple[str, ...]) -> set[tuple[object, ...]]:
    return {tuple(entry[name] for name in names) for entry in result[part]}
