"""Computation of many files in processes."""

from __future__ import annotations

import os
import time
from concurrent.futures import Future

import pytest

from tests.support.server import DAMAGED, ENDLESS, SAMPLES, endless_mesh, ply, workers_of
from unbend import Parameters, compute_signature, read_mesh
from unbend.errors import UnbendError, WorkerLostError
from unbend.jobs.batch import Batch, compute_path, compute_paths
from unbend.mesh.shapes import torus
from unbend.render.picture import render_picture
from unbend.render.request import PictureRequest


@pytest.mark.parametrize("picture", [None, PictureRequest(width=32, height=24, theme="transparent")])
def test_paths_have_a_signature_and_only_the_requested_picture(tmp_path, picture):
    good, bad = tmp_path / "good.ply", tmp_path / "bad.off"
    good.write_bytes(ply(torus(columns=12, rows=8)))
    bad.write_bytes(DAMAGED)
    parameters = Parameters(**SAMPLES)
    outcomes = dict(compute_paths([bad, good], parameters, picture=picture))
    failed, found = outcomes[0], outcomes[1]
    assert isinstance(failed, UnbendError)
    surface = read_mesh(good)
    assert (found.signature.points == compute_signature(surface, parameters).points).all()
    assert found.picture == (render_picture(picture, surface) if picture else None)


def started(futures, taken):
    for place, future in enumerate(futures):
        taken.append(place)
        yield place, future


def test_few_items_are_taken_at_a_time_and_keep_their_order_while_that_delays_nothing():
    futures = [Future() for _ in range(100)]
    taken: list[int] = []
    with Batch(1) as batch:
        lists = batch.settled(started(futures, taken))
        for place in (1, 0):  # the second is done first
            futures[place].set_result(None)
        assert [place for place, _ in next(lists)] == [0, 1]
        assert len(taken) <= 4
        for future in futures[3:]:  # the third is slow, and others must not wait for it
            future.set_result(None)
        places = [place for place, _ in next(lists)]
        assert places == list(range(3, 3 + len(places)))
        assert len(taken) <= 12
        futures[2].set_result(None)
        rest = [place for ready in lists for place, _ in ready]
    assert rest == [2, *range(3 + len(places), 100)]


def test_a_done_item_waits_for_an_earlier_one_only_for_a_moment():
    futures = [Future(), Future()]
    futures[1].set_result(None)
    with Batch(2) as batch:
        lists = batch.settled(started(futures, []))
        assert [place for place, _ in next(lists)] == [1]
        futures[0].set_result(None)
        assert [place for place, _ in next(lists)] == [0]


def test_the_end_of_a_batch_kills_processes_that_compute(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(endless_mesh())
    begun = time.monotonic()
    with Batch(1) as batch:
        future = batch.submit(compute_path, path, Parameters(**ENDLESS), None)
        while not workers_of(os.getpid()):
            time.sleep(0.02)
    assert isinstance(future.exception(), WorkerLostError)
    assert workers_of(os.getpid()) == []
    assert time.monotonic() - begun < 60
