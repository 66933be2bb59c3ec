"""Campaigns on Ray: the same rows as here, also where a node is taken away."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from lunarsim.campaign.engines import make_engine, ray_cluster
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.plan import Group
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.errors import InputError
from lunarsim.parts.module_permission import ALLOW_MODULES_VARIABLE
from tests.campaign.surrogate import plan
from tests.worlds import TINY_FLIGHT


def parts(folder):
    return {p.name: p.read_bytes() for p in sorted((folder / "results").glob("*.parquet"))}


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "127.0.0.1:x"])
def test_an_address_that_does_not_answer_is_refused(address):
    with pytest.raises(InputError, match="--address"):
        make_engine("ray", 1, address, None)


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install \"\.\[ray\]\""):
        make_engine("ray", 1, None, None)


def test_a_node_of_other_code_or_packages_flies_nothing(monkeypatch):
    """Its rows would name this machine's."""
    flights = plan(flights=1)
    (group,) = (Group(0, (0, 1), flights.draws(0)),)
    here = ray_cluster.node_environment()
    assert len(ray_cluster.fly_group(flights.work, group, None, here)) == 2
    for change, told in (
        ({"numpy": "1.26.4"}, rf"numpy {np.__version__} \(here 1\.26\.4\)"),
        ({"lunarsim": "code 123"}, r"lunarsim code \w{12} \(here code 123\)"),
        ({"torch": "2.0"}, r"torch none \(here 2\.0\)"),
    ):
        came = ray_cluster.fly_group(flights.work, group, None, here | change)
        assert isinstance(came, ray_cluster.NodeMismatch) and re.search(told, came.differences)
        engine = object.__new__(ray_cluster.RayEngine)
        engine.address = "10.0.0.1:6379"
        with pytest.raises(InputError, match=told) as refused:
            engine.check_node(came)
        assert refused.value.field == "--address"
    same = here | {"python": "3.99", "cores": "64"}
    assert len(ray_cluster.fly_group(flights.work, group, None, same)) == 2


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
        engine = make_engine("ray", 1, cluster.address, None)
        ran = run(plan(sleep=0.05), engine, tmp_path / "c", progress=progress)
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert (ran.state, ran.flown, ran.failed) == ("complete", 80, 0)
    run(plan(), InlineEngine(), tmp_path / "d")
    assert parts(tmp_path / "c") == parts(tmp_path / "d")


@pytest.mark.slow
def test_an_interrupt_waits_for_no_farewell_and_leaves_nobody(tmp_path):
    """Ray's own end takes up to nine seconds, and its agents' a minute where it is not told."""
    spec = {"scenario": TINY_FLIGHT, "flights": 400, "seed": 1}
    (tmp_path / "s.toml").write_text(CampaignSpec.from_dict(spec).to_toml())
    folder = tmp_path / "c"
    words = ["campaign", "run", tmp_path / "s.toml", "--out", folder, "--engine", "ray"]
    command = [sys.executable, "-m", "lunarsim.cli", *map(str, words), "--jobs", "2"]
    driver = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    journal, until = folder / "journal.jsonl", time.monotonic() + 300.0
    while not (journal.exists() and journal.stat().st_size):
        assert driver.poll() is None and time.monotonic() < until
        time.sleep(0.1)
    others = _below(driver.pid)
    assert len(others) > 3
    began = time.monotonic()
    driver.send_signal(signal.SIGINT)
    said = driver.communicate(timeout=60)[0]
    assert time.monotonic() - began < 2.0
    assert driver.returncode == 130 and "interrupted" in said
    found = load_results(folder)
    assert found.manifest["state"] == "interrupted" and len(found.table) > 0
    until = time.monotonic() + 10.0
    while any(_runs(other) for other in others):
        assert time.monotonic() < until
        time.sleep(0.2)


def _below(process: int) -> list[int]:
    """Return the numbers of all processes that come from one."""
    path = Path(f"/proc/{process}/task/{process}/children")
    mine = [int(word) for word in path.read_text().split()]
    return mine + [other for child in mine for other in _below(child)]


def _runs(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
def test_flights_that_fail_on_ray_are_rows(tmp_path, monkeypatch):
    failing = plan(flights=5, raises=["1-0"], hangs=["2-1"], kills=["3-0"])
    with monkeypatch.context() as patch, pytest.raises(InputError, match=r"here 1\.26"):
        other = ray_cluster.node_environment() | {"numpy": "1.26"}
        patch.setattr(ray_cluster, "node_environment", lambda: other)
        run(failing, make_engine("ray", 1, None, 1.0), tmp_path / "c")
    assert not load_results(tmp_path / "c").table.num_rows
    began = time.monotonic()
    ran = run(failing, make_engine("ray", 2, None, 1.0), tmp_path / "c")
    assert (ran.state, ran.flown, ran.failed) == ("complete", 10, 3)
    assert time.monotonic() - began < 120.0


@pytest.mark.slow
def test_a_permission_given_here_holds_on_a_node_started_without_it(tmp_path, monkeypatch):
    """The nodes of a cluster do not inherit the variables of the process that submits."""
    from ray.cluster_utils import Cluster

    (tmp_path / "own_policy.py").write_text(
        "from lunarsim.onboard.policies.library import Safest\n\n\nclass Mine(Safest):\n    pass\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv(ALLOW_MODULES_VARIABLE, raising=False)
    scenario = TINY_FLIGHT | {"policy": {"kind": "own_policy:Mine"}}
    spec = {"scenario": scenario, "flights": 2, "seed": 1}
    (tmp_path / "s.toml").write_text(tomli_w.dumps(spec))
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    words = ["campaign", "run", "s.toml", "--engine", "ray", "--address", cluster.address]
    try:
        for extra, status in (([], 2), (["--allow-module", "own_policy"], 0)):
            done = subprocess.run(
                [sys.executable, "-m", "lunarsim", *words, "--out", "c", *extra],
                check=False, capture_output=True, text=True, cwd=tmp_path, timeout=300,
            )  # fmt: skip
            assert done.returncode == status, done.stderr
    finally:
        cluster.shutdown()
    assert load_results(tmp_path / "c").manifest["state"] == "complete"
