"""Subset simulation that is broken off, killed or damaged goes on to the same bytes."""

from __future__ import annotations

import signal
import time
from dataclasses import replace

import numpy as np
import pytest

from lunarsim.campaign import store
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.engines.local import LocalEngine
from lunarsim.campaign.flight_execution import build_plan, replay
from lunarsim.campaign.fly_spec import write_files
from lunarsim.campaign.rare_failures import estimate_failure_shares, load_chains
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run
from lunarsim.errors import InputError
from tests.campaign.processes import journalled, parts, start
from tests.campaign.subset_surrogate import planned, spec


@pytest.mark.parametrize("ends", [(40,), (290, 310), (333, 700, 900)])
def test_it_goes_on_from_wherever_it_ended_and_gives_the_same_bytes(
    tmp_path, whole_subset, monkeypatch, ends
):
    monkeypatch.setattr(store, "PART_ROWS", 200)
    folder = tmp_path / "c"
    for end in ends:
        done = len(load_results(folder).table) if folder.exists() else 0
        came: list[int] = []

        def progress(count: int, left: int = end - done, came: list[int] = came) -> None:
            came.append(count)
            if len(came) > left:
                raise KeyboardInterrupt

        assert run(planned("linear"), InlineEngine(), folder, progress=progress).state == (
            "interrupted"
        )
    before = len(load_results(folder).table)
    ran = run(planned("linear"), InlineEngine(), folder)
    assert (ran.state, ran.before, ran.notes) == ("complete", before, ())
    assert parts(folder) == parts(whole_subset)


def test_processes_give_the_same_bytes(tmp_path, whole_subset, monkeypatch):
    monkeypatch.setattr(store, "PART_ROWS", 200)
    ran = run(planned("linear"), LocalEngine(2), tmp_path / "c")
    assert ran.complete and parts(tmp_path / "c") == parts(whole_subset)
    again = run(planned("linear"), LocalEngine(2), tmp_path / "c")
    assert (again.state, again.flown) == ("complete", 0)
    assert parts(tmp_path / "c") == parts(whole_subset)


@pytest.mark.parametrize(
    "point",
    [("after", "results/part-00001.parquet", 1), ("before", "journal.jsonl", 3)],
    ids=lambda p: f"{p[0]} {p[1]}",
)
def test_a_killed_driver_loses_nothing_of_its_chains(tmp_path, whole_subset, monkeypatch, point):
    """Part 1 ends in the midst of the second level; flights of the third follow from it."""
    monkeypatch.setattr(store, "PART_ROWS", 200)
    folder = tmp_path / "c"
    options = {"subset": "linear", "part_rows": 200, "die": point, "jobs": 0}
    driver = start(folder, **options)
    _, said = driver.communicate(timeout=300)
    assert driver.returncode == -signal.SIGKILL, said
    before = len(load_results(folder).table)
    assert before == (400 if point[0] == "after" else 600)
    ran = run(planned("linear"), InlineEngine(), folder)
    assert (ran.state, ran.before, ran.notes) == ("complete", before, ())
    assert parts(folder) == parts(whole_subset)


@pytest.mark.slow
def test_kills_at_random_times_lose_nothing_of_chains(tmp_path, whole_subset):
    rng = np.random.default_rng(5)
    for number in range(5):
        folder, kills = tmp_path / str(number), 0
        while True:
            driver = start(folder, subset="linear", part_rows=200)
            had = journalled(folder)
            target = had + int(rng.integers(20, 600))
            while driver.poll() is None and journalled(folder) < target:
                time.sleep(0.02)
            kills += driver.poll() is None
            driver.kill()
            driver.communicate(timeout=60)
            assert journalled(folder) >= had
            if driver.returncode == 0:
                break
        assert kills and parts(folder) == parts(whole_subset)


def test_failed_flights_flown_again_take_what_followed_from_them_along(tmp_path):
    """Else chains would go on from flights that nobody has flown any more."""
    folder = tmp_path / "c"
    run(planned("patchy"), InlineEngine(), folder)
    ran = run(planned("linear"), InlineEngine(), folder, retry=True)
    assert "depend on flights that are missing" in ran.notes[0]
    run(planned("linear"), InlineEngine(), tmp_path / "d")
    whole, again = (load_chains(load_results(f)).levels for f in (tmp_path / "d", folder))
    # One flight in ten still has no slope in the folder, unlike in the whole one.
    assert len(again) >= 3 and again[0].missing_count == 30 and whole[0].missing_count == 0
    table = load_results(folder).table.to_pandas()
    assert table["flight"].tolist() == list(range(len(table)))
    assert set(table["outcome"]) == {"flown"}


def test_a_part_that_is_lost_is_flown_again_with_what_followed(tmp_path, whole_subset, monkeypatch):
    monkeypatch.setattr(store, "PART_ROWS", 200)
    run(planned("linear"), InlineEngine(), tmp_path / "c")
    path = tmp_path / "c" / "results" / "part-00001.parquet"
    path.write_bytes(path.read_bytes()[:-40])
    ran = run(planned("linear"), InlineEngine(), tmp_path / "c")
    assert (ran.state, ran.before) == ("complete", 200)
    assert parts(tmp_path / "c") == parts(whole_subset)


def test_rows_that_do_not_follow_from_each_other_are_refused(tmp_path, whole_subset):
    found = load_results(whole_subset)
    place = found.table.column_names.index("slope_deg")
    values = found.table["slope_deg"].to_numpy().copy()
    values[5] += 9.0
    other = replace(found, table=found.table.set_column(place, "slope_deg", [values]))
    with pytest.raises(InputError, match="does not match the flights that it depends on"):
        estimate_failure_shares(other)


def test_real_flights_are_drawn_flown_and_flown_again(tmp_path):
    """Tiny flights by the margin of their touchdowns; replay finds what they were drawn from."""
    subset = {"metric": "touchdown_margin", "below": 0.0, "levels": 3, "keep": 0.5}
    made = spec(20, subset=subset)
    folder = tmp_path / "c"
    progress = []

    def stop(count: int) -> None:
        progress.append(count)
        if len(progress) == 21:
            raise KeyboardInterrupt

    plan = build_plan(made, folder)
    run(plan, InlineEngine(), folder, files=lambda at: write_files(made, at), progress=stop)
    found = load_results(folder)
    table = found.table.to_pandas()
    assert len(table) == 21 and table["touchdown_margin"].notna().all()
    assert ((table["touchdown_margin"] < 0.0) == ~table["safe"]).all()
    later = table[table["level"] == 1]
    again = replay(folder, later["id"].iloc[-1])
    assert again.differences == []
    with pytest.raises(InputError, match="must not depend on flights") as refused:
        replay(folder, "35-0")
    assert refused.value.field == "--flight"
    (share,) = estimate_failure_shares(found)
    assert np.isnan(share.value) == (load_chains(found).stop is None)
