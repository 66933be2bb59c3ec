from __future__ import annotations

import json

import pandas as pd
import pytest

from lunarsim.campaign import compare
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from tests.worlds import TINY_FLIGHT


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.from_dict(TINY_FLIGHT)


@pytest.fixture(scope="module")
def result(scenario, tmp_path_factory):
    out = tmp_path_factory.mktemp("one") / "out"
    return compare(scenario, ["no-divert", "safest"], flights=2, seed=4, jobs=1, out=out), out


def test_results_are_the_same_bytes_again_and_in_two_processes(scenario, result, tmp_path):
    _, first = result
    for jobs in (1, 2):
        out = tmp_path / str(jobs)
        compare(
            scenario, ["no-divert", "safest"], flights=2, seed=4, jobs=jobs, out=out, figures=False
        )
        assert (out / "results.parquet").read_bytes() == (first / "results.parquet").read_bytes()


def test_folder_holds_what_was_promised(result):
    summary, out = result
    table = pd.read_parquet(out / "results.parquet")
    assert len(table) == 4
    assert list(table["policy"]) == ["no-divert", "safest"] * 2
    assert {p.name for p in (out / "flights" / "safest").iterdir()} == {"00000", "00001"}
    for policy in ("no-divert", "safest"):
        for name in ("descent", "maps"):
            assert (out / "figures" / policy / f"{name}.png").stat().st_size > 20_000
    assert (out / "figures" / "comparison.png").exists()
    assert json.loads((out / "summary.json").read_text())["complete"]
    assert Scenario.load(out / "scenario.toml").name == "tiny"
    assert summary.complete
    assert 0.0 <= summary.safe_share <= summary.safe_share_at_heading <= 1.0


def test_progress_counts_flights(scenario):
    seen = []
    compare(scenario, ["no-divert"], flights=2, seed=1, progress=seen.append)
    assert sum(seen) == 2


def test_interrupt_keeps_what_is_finished(scenario, tmp_path):
    out = tmp_path / "out"

    def stop(_: int) -> None:
        raise KeyboardInterrupt

    result = compare(
        scenario, ["no-divert"], flights=3, seed=1, out=out, progress=stop, figures=False
    )
    assert not result.complete
    assert len(pd.read_parquet(out / "results.parquet")) == 1
    assert not json.loads((out / "summary.json").read_text())["complete"]


def test_an_interrupt_before_the_first_flight_has_ended_is_no_error(
    scenario, tmp_path, monkeypatch
):
    def fly(*_):
        raise KeyboardInterrupt
        yield

    with monkeypatch.context() as patched:
        patched.setattr(InlineEngine, "fly", fly)
        begun = compare(scenario, ["no-divert"], flights=1, seed=1, out=tmp_path / "out")
    assert not begun.complete and begun.rows == [] and begun.failed == []
    gone_on = compare(scenario, ["no-divert"], flights=1, seed=1, out=tmp_path / "out")
    assert gone_on.complete and len(gone_on.rows) == 1


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"policies": ["safets"]}, "--policies"),
        ({"policies": []}, "--policies"),
        ({"policies": ["safest", "safest"]}, "--policies"),
        ({"flights": 0}, "--flights"),
        ({"jobs": 0}, "--jobs"),
    ],
)
def test_bad_requests(scenario, tmp_path, change, field):
    request = {"policies": ["safest"], "flights": 1, "jobs": 1} | change
    with pytest.raises(InputError) as caught:
        compare(scenario, request.pop("policies"), seed=1, out=tmp_path / "o", **request)
    assert caught.value.field == field
    assert not (tmp_path / "o").exists()


def test_other_results_are_not_overwritten(scenario, tmp_path):
    (tmp_path / "precious.txt").write_text("keep")
    with pytest.raises(InputError, match="holds other files"):
        compare(scenario, ["safest"], flights=1, seed=1, out=tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["precious.txt"]
