"""Campaigns on Ray: the same rows as here, also where a node is taken away."""

from __future__ import annotations

import sys
import threading
import time

import pytest

from lunarsim.campaign.engines import engine_of
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.run import run
from lunarsim.errors import InputError
from tests.campaign.surrogate import plan


def parts(folder):
    return {p.name: p.read_bytes() for p in sorted((folder / "results").glob("*.parquet"))}


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "127.0.0.1:x"])
def test_an_address_that_does_not_answer_is_refused(address):
    with pytest.raises(InputError, match="--address"):
        engine_of("ray", 1, address, None)


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install \"lunarsim\[ray\]\""):
        engine_of("ray", 1, None, None)


@pytest.mark.slow
def test_a_node_that_is_taken_away_changes_nothing(tmp_path):
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    second = cluster.add_node(num_cpus=1)
    flown = []

    def progress(count: int) -> None:
        flown.append(count)
        if len(flown) == 20:
            threading.Thread(target=cluster.remove_node, args=(second,)).start()

    try:
        engine = engine_of("ray", 1, cluster.address, None)
        ran = run(plan(sleep=0.05), engine, tmp_path / "c", progress=progress)
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert (ran.state, ran.flown, ran.failed) == ("complete", 80, 0)
    run(plan(), InlineEngine(), tmp_path / "d")
    assert parts(tmp_path / "c") == parts(tmp_path / "d")


@pytest.mark.slow
def test_flights_that_fail_on_ray_are_rows(tmp_path):
    failing = plan(flights=5, raises=["1-0"], hangs=["2-1"], kills=["3-0"])
    began = time.monotonic()
    ran = run(failing, engine_of("ray", 2, None, 1.0), tmp_path / "c")
    assert (ran.state, ran.flown, ran.failed) == ("complete", 10, 3)
    assert time.monotonic() - began < 120.0
