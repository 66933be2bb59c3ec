"""What a run writes, when it stops, and what it refuses."""

from __future__ import annotations

import itertools
import json
import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

import lunarsim
from lunarsim.campaign import store
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.engines.local import LocalEngine, WorkerStartError
from lunarsim.campaign.outcomes import FLOWN, Finished
from lunarsim.campaign.plan import Work
from lunarsim.campaign.results import load_results, read_status
from lunarsim.campaign.run import IntervalWidthRule, run
from lunarsim.campaign.store import Store
from lunarsim.errors import InputError
from lunarsim.evaluation.sequences import share_confidence_sequence
from tests.campaign.processes import parts, write_manifest
from tests.campaign.surrogate import plan

pytestmark = pytest.mark.usefixtures("short_parts")


def test_rows_hold_inputs_seed_metrics_and_versions(tmp_path):
    run(plan(flights=3), InlineEngine(), tmp_path / "c")
    rows = pq.read_table(tmp_path / "c" / "results").to_pylist()
    assert [row["id"] for row in rows] == ["0-0", "0-1", "1-0", "1-1", "2-0", "2-1"]
    assert [row["level"] for row in rows] == [0.0, 0.5] * 3
    assert rows[0]["wind"] == rows[1]["wind"] == np.random.default_rng([1, 0]).random()
    assert {row["outcome"] for row in rows} == {"flown"}
    assert {(row["seed"], row["version"]) for row in rows} == {(1, lunarsim.__version__)}
    assert {len(row["code"]) for row in rows} == {12}
    assert np.isnan(rows[0]["x"]) and rows[2]["name"] == "ünïcode, 0"
    timing = pq.read_table(tmp_path / "c" / "timing").to_pylist()
    assert [t["id"] for t in timing] == [row["id"] for row in rows]
    assert all(t["seconds"] >= 0.0 and t["attempts"] == 1 for t in timing)


def test_processes_give_the_same_bytes(tmp_path, whole):
    ran = run(plan(), LocalEngine(2), tmp_path / "c")
    assert ran.complete
    assert parts(tmp_path / "c") == whole
    assert len(whole) == 4
    assert (tmp_path / "c" / "journal.jsonl").read_bytes() == b""
    again = run(plan(), LocalEngine(2), tmp_path / "c")
    assert (again.state, again.flown, again.before) == ("complete", 0, 80)


def test_more_flights_go_on_where_fewer_ended(tmp_path, whole):
    assert run(plan(flights=13), InlineEngine(), tmp_path / "c").flown == 26
    ran = run(plan(flights=40), InlineEngine(), tmp_path / "c")
    assert (ran.before, ran.flown) == (26, 54)
    assert parts(tmp_path / "c") == whole


def test_a_worker_does_not_keep_what_flights_leave_in_circles(tmp_path):
    run(plan(flights=40, arms=1, circles=20_000_000), LocalEngine(1), tmp_path / "c")
    megabytes = load_results(tmp_path / "c").table["x"].to_numpy()
    # One flight's 20 MB at a time; all of them would be 800.
    assert megabytes[-10:].max() < megabytes[1] + 60.0


def test_flights_that_fail_are_rows_with_reason_and_seed(tmp_path):
    failing = plan(
        flights=6, folder=str(tmp_path), raises=["1-0"], exits=["2-1"], hangs=["3-0"],
        kills=["4-1"], kills_once=["5-0"],
    )  # fmt: skip
    ran = run(failing, LocalEngine(2, time_limit=0.7), tmp_path / "c")
    assert (ran.state, ran.flown, ran.failed) == ("complete", 12, 4)
    rows = {row["id"]: row for row in load_results(tmp_path / "c").table.to_pylist()}
    assert {name for name, row in rows.items() if row["outcome"] != "flown"} == {
        "1-0", "2-1", "3-0", "4-1",
    }  # fmt: skip
    assert rows["1-0"]["outcome"] == "error"
    assert rows["1-0"]["error"] == "ValueError: no flight 1-0"
    assert "surrogate.py" in rows["1-0"]["traceback"] and rows["1-0"]["safe"] is None
    assert rows["2-1"]["error"] == "SystemExit: 3"
    assert (rows["3-0"]["outcome"], rows["3-0"]["error"]) == (
        "timeout",
        "The flight exceeded the time limit of 0.7 s.",
    )
    assert rows["4-1"]["outcome"] == "killed"
    assert "SIGKILL" in rows["4-1"]["error"] and "3 times" in rows["4-1"]["error"]
    tries = {t["id"]: t["attempts"] for t in load_results(tmp_path / "c").timing.to_pylist()}
    assert (tries["5-0"], tries["4-1"], tries["0-0"]) == (2, 3, 1)
    assert read_status(tmp_path / "c").outcomes == {
        "flown": 8, "error": 2, "timeout": 1, "killed": 1,
    }  # fmt: skip
    # What failed is flown again on demand, and nothing else.
    (tmp_path / "flown.txt").unlink()
    cured = plan(flights=6, folder=str(tmp_path))
    assert run(cured, InlineEngine(), tmp_path / "c").flown == 0
    assert run(cured, InlineEngine(), tmp_path / "c", retry=True).flown == 4
    flown = (tmp_path / "flown.txt").read_text().split()
    assert sorted(flown) == ["1-0", "2-1", "3-0", "4-1"]
    run(plan(flights=6), InlineEngine(), tmp_path / "d")
    assert parts(tmp_path / "c") == parts(tmp_path / "d")


def test_a_million_rows_are_not_held_in_memory(tmp_path, monkeypatch):
    """Rows that are in no part yet take what their lines take, not a table of Python's each."""
    monkeypatch.setattr(store, "PART_ROWS", 5000)
    opened = Store.open(tmp_path / "c", plan(flights=5000))
    tracemalloc.start()
    for i in range(1000):
        opened.add(Finished(i, 0, FLOWN, {"safe": True, "x": i / 7, "steps": i, "name": "n"}))
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    opened.release()
    line = len((tmp_path / "c" / "journal.jsonl").read_text()) / 1000
    assert held / 1000 < 1.5 * line + 400


def test_a_time_budget_starts_no_flight_later_and_the_next_run_goes_on(tmp_path, whole):
    ran = run(plan(sleep=0.02), InlineEngine(), tmp_path / "c", time_budget=0.3)
    assert ran.state == "out of time" and 4 <= ran.flown <= 20
    rows = load_results(tmp_path / "c").table["flight"].to_pylist()
    assert sorted(set(rows)) == list(range(len(rows) // 2))
    assert run(plan(), InlineEngine(), tmp_path / "c").complete
    assert parts(tmp_path / "c") == whole


@pytest.mark.parametrize("jump", [-1e9, 1e9])
def test_a_jump_of_the_clock_does_not_matter_to_a_time_budget(tmp_path, monkeypatch, jump):
    """As when the clock is set by the network, or by a change of the battery."""
    wall, calls = time.time, itertools.count()
    monkeypatch.setattr(time, "time", lambda: wall() + jump * (next(calls) > 3))
    ran = run(plan(flights=10), InlineEngine(), tmp_path / "c", time_budget=60.0)
    assert (ran.state, ran.flown) == ("complete", 20) and next(calls) > 10
    ran = run(plan(sleep=0.02), InlineEngine(), tmp_path / "d", time_budget=0.3)
    assert ran.state == "out of time" and ran.flown <= 20


@pytest.mark.parametrize("engine", [InlineEngine(), LocalEngine(2)], ids=["inline", "local"])
def test_a_narrow_interval_stops_at_the_first_flight_that_suffices(tmp_path, engine):
    def rule() -> IntervalWidthRule:
        return IntervalWidthRule("safe", 0.5, 2)

    ran = run(plan(flights=200), engine, tmp_path / "c", rule=rule())
    assert ran.state == "stopped" and ran.complete
    found = load_results(tmp_path / "c")
    safe = np.array(found.table["safe"].to_pylist()).reshape(-1, 2)

    def width(flights: int) -> float:
        intervals = [
            share_confidence_sequence(int(safe[:flights, i].sum()), flights) for i in (0, 1)
        ]
        return max(high - low for low, high in intervals)

    assert width(ran.flights) <= 0.5 < min(width(n) for n in range(1, ran.flights))
    assert len(found.table) == found.expected_rows == 2 * ran.flights
    again = run(plan(flights=200), InlineEngine(), tmp_path / "c", rule=rule())
    assert (again.state, again.flown, again.flights) == ("stopped", 0, ran.flights)


def test_two_writers_at_once_are_refused(tmp_path):
    opened = Store.open(tmp_path / "c", plan())
    with pytest.raises(InputError, match="another process"):
        run(plan(), InlineEngine(), tmp_path / "c")
    opened.close("interrupted")
    assert run(plan(), InlineEngine(), tmp_path / "c").complete


def test_a_folder_of_anything_else_is_refused_and_left_alone(tmp_path):
    (tmp_path / "precious.txt").write_text("keep")
    with pytest.raises(InputError, match="new or empty folder"):
        run(plan(), InlineEngine(), tmp_path)
    with pytest.raises(InputError, match="not a file"):
        run(plan(), InlineEngine(), tmp_path / "precious.txt")
    assert [p.name for p in tmp_path.iterdir()] == ["precious.txt"]
    run(plan(flights=2), InlineEngine(), tmp_path / "c")
    kept = {p: p.read_bytes() for p in (tmp_path / "c").rglob("*") if p.is_file()}
    with pytest.raises(InputError, match=r"seed: 1 in the folder, 2 in this"):
        run(plan(flights=2, seed=2), InlineEngine(), tmp_path / "c")
    for key, value in (("version", "0.0.9"), ("code", "0" * 12), ("format", 99)):
        manifest = json.loads((tmp_path / "c" / "manifest.json").read_text())
        write_manifest(tmp_path / "c", manifest | {key: value})
        with pytest.raises(InputError, match=rf"{key}: {value} in the folder"):
            run(plan(flights=2), InlineEngine(), tmp_path / "c")
        (tmp_path / "c" / "manifest.json").write_bytes(kept[tmp_path / "c" / "manifest.json"])
    for name, value, says in (
        ("numpy", "1.26.4", r"numpy: 1\.26\.4 in the folder, .* installed"),
        ("numpy", "1.26.4", r"pip install numpy==1\.26\.4"),
        ("torch", "2.0", "torch: 2.0 in the folder, none installed"),
        ("platform", "linux m68k", "platform: linux m68k in the folder"),
    ):
        manifest = json.loads(kept[tmp_path / "c" / "manifest.json"])
        manifest["environment"][name] = value
        write_manifest(tmp_path / "c", manifest)
        with pytest.raises(InputError, match=says) as refused:
            run(plan(flights=2), InlineEngine(), tmp_path / "c")
        assert refused.value.field == "--out"
    manifest["environment"] = json.loads(kept[tmp_path / "c" / "manifest.json"])["environment"] | {
        "cores": "64", "python": "3.99",
    }  # fmt: skip
    write_manifest(tmp_path / "c", manifest)
    run(plan(flights=2), InlineEngine(), tmp_path / "c")
    kept = {p: p.read_bytes() for p in (tmp_path / "c").rglob("*") if p.is_file()}
    (tmp_path / "c" / "manifest.json").write_text("{")
    with pytest.raises(InputError, match=r"a damaged manifest\.json"):
        run(plan(flights=2), InlineEngine(), tmp_path / "c")
    (tmp_path / "c" / "manifest.json").write_bytes(kept[tmp_path / "c" / "manifest.json"])
    assert kept == {p: p.read_bytes() for p in (tmp_path / "c").rglob("*") if p.is_file()}


def test_workers_that_cannot_start_are_reported(tmp_path):
    lost = replace(plan(), work=Work("tests.campaign.no_such_module:fly"))
    with pytest.raises(WorkerStartError, match="before they were ready"):
        run(lost, LocalEngine(2), tmp_path / "c")
    assert run(plan(flights=1), InlineEngine(), tmp_path / "c").complete
