"""The machinery of campaigns: what is kept when anything ends at any time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from lunarsim.campaign import store
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.engines.local import LocalEngine, WorkersDieError, deaf
from lunarsim.campaign.outcomes import FLOWN, Finished
from lunarsim.campaign.plan import Work
from lunarsim.campaign.results import load_results, status_of
from lunarsim.campaign.run import run
from lunarsim.campaign.stopping import WidthRule
from lunarsim.campaign.store import Store
from lunarsim.errors import InputError
from lunarsim.evaluation.sequences import share_sequence
from tests.campaign.surrogate import plan
from tests.conftest import ROOT


@pytest.fixture(autouse=True)
def short_parts(monkeypatch):
    monkeypatch.setattr(store, "PART_ROWS", 20)
    monkeypatch.setattr(store, "_AT_ONCE", 7)


def start(at: Path, **options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.campaign.driver", str(at), json.dumps(options)]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def parts(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted((folder / "results").glob("*.parquet"))}


def children(process: int) -> list[int]:
    """Return the workers of a driver: its children but for the tracker of shared memory."""
    path = Path(f"/proc/{process}/task/{process}/children")
    found = [int(word) for word in path.read_text().split()] if path.exists() else []
    return [c for c in found if "spawn_main" in _command(c)]


def _command(process: int) -> str:
    try:
        return Path(f"/proc/{process}/cmdline").read_text()
    except OSError:
        return ""


def wait_for(condition, seconds: float = 60.0):
    until = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < until, "it never came"
        time.sleep(0.1)
    return value


def journalled(folder: Path) -> int:
    """Return the number of rows that a folder holds."""
    try:
        return len(load_results(folder, ["outcome"]).table)
    except (InputError, OSError):
        return 0


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the bytes of an uninterrupted campaign of 40 flights."""
    folder = tmp_path_factory.mktemp("whole") / "c"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "PART_ROWS", 20)
        ran = run(plan(), InlineEngine(), folder)
    assert (ran.state, ran.flown, ran.failed) == ("complete", 80, 0)
    return parts(folder)


def test_rows_hold_inputs_seed_metrics_and_versions(tmp_path):
    run(plan(flights=3), InlineEngine(), tmp_path / "c")
    rows = pq.read_table(tmp_path / "c" / "results").to_pylist()
    assert [row["id"] for row in rows] == ["0-0", "0-1", "1-0", "1-1", "2-0", "2-1"]
    assert [row["level"] for row in rows] == [0.0, 0.5] * 3
    assert rows[0]["wind"] == rows[1]["wind"] == np.random.default_rng([1, 0]).random()
    assert {row["outcome"] for row in rows} == {"flown"}
    assert {(row["seed"], row["version"], len(row["code"])) for row in rows} == {(1, "0.1.0", 12)}
    assert np.isnan(rows[0]["x"]) and rows[2]["name"] == "ünïcode, 0"
    timing = pq.read_table(tmp_path / "c" / "timing").to_pylist()
    assert [t["id"] for t in timing] == [row["id"] for row in rows]
    assert all(t["seconds"] >= 0.0 and t["tries"] == 1 for t in timing)


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
        "it took longer than 0.7 s",
    )
    assert rows["4-1"]["outcome"] == "killed"
    assert "SIGKILL" in rows["4-1"]["error"] and "3 times" in rows["4-1"]["error"]
    tries = {t["id"]: t["tries"] for t in load_results(tmp_path / "c").timing.to_pylist()}
    assert (tries["5-0"], tries["4-1"], tries["0-0"]) == (2, 3, 1)
    assert status_of(tmp_path / "c").outcomes == {
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


def test_a_flight_flown_again_and_then_killed_is_not_forgotten(tmp_path, whole):
    """Its row is in the journal alone, and its part has still the one that failed."""
    folder = tmp_path / "c"
    run(plan(raises=["1-0", "7-1"]), InlineEngine(), folder)
    came = []

    def die(count: int) -> None:
        came.append(count)
        if len(came) == 2:  # the rows that were there, and the first that was flown again
            raise SystemExit

    with pytest.raises(SystemExit):
        run(plan(), InlineEngine(), folder, retry=True, progress=die)
    found = load_results(folder)
    rows = {row["id"]: row["outcome"] for row in found.table.to_pylist()}
    assert (rows["1-0"], rows["7-1"], len(rows)) == ("flown", "error", 80)
    assert found.timing["id"].equals(found.table["id"])
    (line,) = [json.loads(t) for t in (folder / "journal.jsonl").read_text().splitlines()
               if json.loads(t)[0]["id"] == "1-0"]  # fmt: skip
    assert found.timing.to_pylist()[2] == line[1]
    ran = run(plan(), InlineEngine(), folder)
    assert (ran.state, ran.before, ran.flown) == ("complete", 80, 0)
    rows = {row["id"]: row["outcome"] for row in load_results(folder).table.to_pylist()}
    assert (rows["1-0"], rows["7-1"]) == ("flown", "error")
    assert run(plan(), InlineEngine(), folder, retry=True).flown == 1
    assert parts(folder) == whole


POINTS = [
    ("before", "manifest.json", 1),
    ("after", "manifest.json", 1),
    ("before", "results/part-00001.parquet", 1),
    ("after", "results/part-00001.parquet", 1),
    ("before", "timing/part-00002.parquet", 1),
    ("after", "timing/part-00002.parquet", 1),
    ("before", "journal.jsonl", 2),
    ("after", "journal.jsonl", 2),
    ("before", "manifest.json", 3),
]


@pytest.mark.parametrize("point", POINTS, ids=lambda p: f"{p[0]} {p[1]} {p[2]}")
def test_a_kill_at_a_named_point_loses_nothing(tmp_path, whole, point):
    folder = tmp_path / "c"
    first = start(folder, die=point, folder=str(tmp_path), jobs=0)
    first.communicate(timeout=60)
    assert first.returncode == -signal.SIGKILL
    before = journalled(folder)
    ran = run(plan(), InlineEngine(), folder)
    assert (ran.state, ran.before, ran.flown) == ("complete", before, 80 - before)
    assert ran.notes == ()
    assert parts(folder) == whole
    assert not list(folder.rglob(".*.part"))
    # Nothing is flown again: no flight was in the air, and each was kept before anything else.
    told = tmp_path / "flown.txt"
    flown = told.read_text().split() if told.exists() else []
    assert len(flown) == before


def _killed_at_random(tmp_path: Path, whole: dict[str, bytes], rounds: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for number in range(rounds):
        folder = tmp_path / str(number)
        kills = 0
        while True:
            driver = start(folder, sleep=0.01, folder=str(tmp_path))
            had = journalled(folder)
            target = had + int(rng.integers(5, 60))
            wait_for(lambda: driver.poll() is not None or journalled(folder) >= target)  # noqa: B023
            workers = children(driver.pid)
            if driver.poll() is None and workers and rng.random() < 0.5:
                os.kill(int(rng.choice(workers)), signal.SIGKILL)
                time.sleep(0.05)
            if driver.poll() is None:
                driver.kill()
                kills += 1
            driver.communicate(timeout=60)
            wait_for(lambda: not any("spawn_main" in _command(w) for w in workers))  # noqa: B023
            assert journalled(folder) >= had
            if driver.returncode == 0:
                break
        assert parts(folder) == whole, f"round {number} after {kills} kills"
        assert load_results(folder).manifest["state"] == "complete"


def test_kills_at_random_times_lose_nothing(tmp_path, whole):
    _killed_at_random(tmp_path, whole, 1, seed=1)


@pytest.mark.slow
def test_many_kills_at_random_times_lose_nothing(tmp_path, whole):
    _killed_at_random(tmp_path, whole, 20, seed=2)


def test_workers_end_with_a_driver_that_is_killed(tmp_path):
    """Also one that hangs in the midst of a flight."""
    driver = start(tmp_path / "c", flights=4, hangs=["0-0"], folder=str(tmp_path))
    workers = wait_for(lambda: children(driver.pid) if journalled(tmp_path / "c") >= 6 else [])
    driver.kill()
    driver.communicate(timeout=60)
    wait_for(lambda: not any("spawn_main" in _command(w) for w in workers), 2.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_an_interrupt_returns_at_once_and_keeps_what_is_finished(tmp_path, whole, number):
    folder = tmp_path / "c"
    driver = start(folder, hangs=["9-1"], folder=str(tmp_path))
    # All but the flight that hangs; the other worker waits for nothing.
    wait_for(lambda: journalled(folder) >= 60)
    workers = children(driver.pid)
    began = time.monotonic()
    driver.send_signal(number)
    said, _ = driver.communicate(timeout=60)
    assert time.monotonic() - began < 2.0
    assert driver.returncode == 0 and said.startswith("interrupted")
    assert not any("spawn_main" in _command(w) for w in workers)
    assert load_results(folder).manifest["state"] == "interrupted"
    # Everything that was flown is in Parquet now, and there is nothing that was not flown.
    flown = (tmp_path / "flown.txt").read_text().split()
    kept = pq.read_table(folder / "results")["id"].to_pylist()
    assert set(kept) <= set(flown) and len(flown) - len(kept) <= 1
    assert run(plan(), InlineEngine(), folder).before == len(kept)
    assert parts(folder) == whole


def test_nothing_is_loaded_while_an_interrupt_waits(tmp_path):
    """Pandas took 0.3 s, and seconds on a busy machine: rows are written when all is loaded."""
    code = """
import sys
from pathlib import Path
from lunarsim.campaign.outcomes import FLOWN, Finished
from lunarsim.campaign.store import Store
from tests.campaign.surrogate import plan
opened = Store.open(Path(sys.argv[1]), plan())
before = set(sys.modules)
for i in range(12):
    opened.add(Finished(i, 0, FLOWN, {"safe": True, "x": 0.5, "steps": 1, "name": "n"}))
opened.close("interrupted")
print(sorted(m for m in set(sys.modules) - before if "encodings" not in m))
"""
    command = [sys.executable, "-c", code, str(tmp_path / "c")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_processes_do_not_die_of_an_interrupt_while_they_start():
    """The keyboard sends it to all; the parent hears it once the other has been started."""
    # A shell gives what it starts in the background an interrupt that is ignored.
    code = "import signal, time; signal.signal(signal.SIGINT, signal.default_int_handler);"
    code += "print(flush=True); time.sleep(0.3); print('there')"
    before = signal.pthread_sigmask(signal.SIG_BLOCK, set())
    with deaf():
        other = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, set()) == before
    other.stdout.readline()
    other.send_signal(signal.SIGINT)
    assert other.communicate(timeout=60)[0] == "there\n"
    assert other.returncode == 0


def test_a_million_rows_are_not_held_in_memory(tmp_path, monkeypatch):
    """Rows that are in no part yet take what their lines take, not a table of Python's each."""
    monkeypatch.setattr(store, "PART_ROWS", 5000)
    opened = Store.open(tmp_path / "c", plan(flights=5000))
    tracemalloc.start()
    for i in range(1000):
        opened.add(Finished(i, 0, FLOWN, {"safe": True, "x": i / 7, "steps": i, "name": "n"}))
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    opened.abandon()
    line = len((tmp_path / "c" / "journal.jsonl").read_text()) / 1000
    assert held / 1000 < 1.5 * line + 400


def test_an_interrupt_in_the_caller_keeps_what_is_finished(tmp_path, whole):
    came = []

    def progress(count: int) -> None:
        came.append(count)
        if len(came) == 8:
            raise KeyboardInterrupt

    ran = run(plan(), LocalEngine(2), tmp_path / "c", progress=progress)
    assert (ran.state, ran.flown) == ("interrupted", 8)
    run(plan(), InlineEngine(), tmp_path / "c")
    assert parts(tmp_path / "c") == whole


def test_a_truncated_part_is_kept_apart_and_flown_again(tmp_path, whole):
    folder = tmp_path / "c"
    run(plan(), InlineEngine(), folder)
    path = folder / "results" / "part-00001.parquet"
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match="part-00001"):
        load_results(folder)
    ran = run(plan(), InlineEngine(), folder)
    assert (ran.before, ran.flown) == (60, 20)
    assert "part-00001.broken" in ran.notes[0]
    assert parts(folder) == whole
    assert (folder / "results" / "part-00001.broken").exists()


def test_a_flipped_bit_is_found(tmp_path, whole):
    folder = tmp_path / "c"
    run(plan(), InlineEngine(), folder)
    path = folder / "results" / "part-00002.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 0x10
    path.write_bytes(data)
    assert run(plan(), InlineEngine(), folder).flown == 20
    assert parts(folder) == whole


@pytest.mark.parametrize("names", [("00001", "00002"), ("00000", "00003"), ("00002", "00002x")])
def test_a_part_in_the_place_of_another_is_kept_apart_and_flown_again(tmp_path, whole, names):
    folder = tmp_path / "c"
    run(plan(), InlineEngine(), folder)
    came, place = (folder / "results" / f"part-{name}.parquet" for name in names)
    came.replace(place)
    ran = run(plan(), InlineEngine(), folder)
    assert ran.notes and "cannot be read" in ran.notes[0]
    assert ran.state == "complete" and parts(folder) == whole


@pytest.mark.parametrize("edited", ["twice", "other arm"])
def test_a_part_that_was_edited_by_hand_is_kept_apart(tmp_path, whole, edited):
    folder = tmp_path / "c"
    run(plan(), InlineEngine(), folder)
    path = folder / "results" / "part-00001.parquet"
    table = pq.read_table(path)
    rows = table.to_pylist()
    if edited == "twice":
        rows[3] = rows[2]
    else:
        rows[3] |= {"arm": "arm 7"}
    pq.write_table(table.from_pylist(rows, table.schema), path)
    ran = run(plan(), InlineEngine(), folder)
    assert (ran.before, ran.flown) == (60, 20) and "cannot be read" in ran.notes[0]
    assert parts(folder) == whole


def test_lines_of_the_journal_that_are_no_rows_of_it_are_told_of(tmp_path, whole):
    folder = tmp_path / "c"
    driver = start(folder, die=("before", "results/part-00001.parquet", 1), jobs=0)
    driver.communicate(timeout=300)
    before = journalled(folder)
    path = folder / "journal.jsonl"
    row, timing = json.loads(path.read_text().splitlines()[0])
    strange = [
        json.dumps([row | change, timing])
        for change in ({"id": "3-9"}, {"arm": "arm 7"}, {"flight": 39}, {"id": "x"})
    ]
    path.write_text("\n".join([*strange, "{}", "7", path.read_text()]))
    ran = run(plan(), InlineEngine(), folder)
    assert ran.before == before and len(ran.notes) == 6
    assert parts(folder) == whole


def test_half_a_line_in_the_journal_is_dropped(tmp_path, whole):
    folder = tmp_path / "c"
    driver = start(folder, die=("before", "results/part-00001.parquet", 1), jobs=0)
    driver.communicate(timeout=60)
    before = journalled(folder)
    path = folder / "journal.jsonl"
    path.write_bytes(path.read_bytes()[:-25])
    assert journalled(folder) == before - 1
    ran = run(plan(), InlineEngine(), folder)
    assert ran.before == before - 1 and ran.notes == ()
    assert parts(folder) == whole


def test_a_disk_that_takes_no_more_ends_the_run_and_the_next_goes_on(tmp_path, whole):
    """The system cuts a line of the journal off in the midst, as a full disk does."""
    folder = tmp_path / "c"
    driver = start(folder, most_bytes=6000, folder=str(tmp_path), jobs=0)
    _, said = driver.communicate(timeout=60)
    assert driver.returncode == 1
    assert "journal.jsonl" in said and "the same command goes on" in said
    before = journalled(folder)
    assert 0 < before < 20
    assert len((tmp_path / "flown.txt").read_text().split()) - before <= 2
    assert status_of(folder).state == "killed"
    ran = run(plan(), InlineEngine(), folder)
    assert (ran.before, ran.notes) == (before, ())
    assert parts(folder) == whole


def test_a_time_budget_starts_no_flight_later_and_the_next_run_goes_on(tmp_path, whole):
    ran = run(plan(sleep=0.02), InlineEngine(), tmp_path / "c", time_budget=0.3)
    assert ran.state == "out of time" and 4 <= ran.flown <= 20
    rows = load_results(tmp_path / "c").table["flight"].to_pylist()
    assert sorted(set(rows)) == list(range(len(rows) // 2))
    assert run(plan(), InlineEngine(), tmp_path / "c").complete
    assert parts(tmp_path / "c") == whole


@pytest.mark.parametrize("engine", [InlineEngine(), LocalEngine(2)], ids=["inline", "local"])
def test_a_narrow_interval_stops_at_the_first_flight_that_suffices(tmp_path, engine):
    def rule() -> WidthRule:
        return WidthRule("safe", 0.5, 2)

    ran = run(plan(flights=200), engine, tmp_path / "c", rule=rule())
    assert ran.state == "stopped" and ran.complete
    found = load_results(tmp_path / "c")
    safe = np.array(found.table["safe"].to_pylist()).reshape(-1, 2)

    def width(flights: int) -> float:
        intervals = [share_sequence(int(safe[:flights, i].sum()), flights) for i in (0, 1)]
        return max(high - low for low, high in intervals)

    assert width(ran.flights) <= 0.5 < min(width(n) for n in range(1, ran.flights))
    assert len(found.table) == found.wanted == 2 * ran.flights
    again = run(plan(flights=200), InlineEngine(), tmp_path / "c", rule=rule())
    assert (again.state, again.flown, again.flights) == ("stopped", 0, ran.flights)


def test_two_writers_at_once_are_refused(tmp_path):
    opened = Store.open(tmp_path / "c", plan())
    with pytest.raises(InputError, match="no other process"):
        run(plan(), InlineEngine(), tmp_path / "c")
    opened.close("interrupted")
    assert run(plan(), InlineEngine(), tmp_path / "c").complete


def test_a_folder_of_anything_else_is_refused_and_left_alone(tmp_path):
    (tmp_path / "precious.txt").write_text("keep")
    with pytest.raises(InputError, match="holds other files"):
        run(plan(), InlineEngine(), tmp_path)
    with pytest.raises(InputError, match="not a file"):
        run(plan(), InlineEngine(), tmp_path / "precious.txt")
    assert [p.name for p in tmp_path.iterdir()] == ["precious.txt"]
    run(plan(flights=2), InlineEngine(), tmp_path / "c")
    kept = {p: p.read_bytes() for p in (tmp_path / "c").rglob("*") if p.is_file()}
    with pytest.raises(InputError, match=r"seed was 1 there, is 2 now"):
        run(plan(flights=2, seed=2), InlineEngine(), tmp_path / "c")
    for key, value in (("version", "0.0.9"), ("code", "0" * 12), ("format", 99)):
        manifest = json.loads((tmp_path / "c" / "manifest.json").read_text())
        (tmp_path / "c" / "manifest.json").write_text(json.dumps(manifest | {key: value}))
        with pytest.raises(InputError, match=rf"flown with {key} {value}"):
            run(plan(flights=2), InlineEngine(), tmp_path / "c")
        (tmp_path / "c" / "manifest.json").write_bytes(kept[tmp_path / "c" / "manifest.json"])
    for name, value, says in (
        ("numpy", "1.26.4", r"numpy 1\.26\.4 there, .* here"),
        ("numpy", "1.26.4", r"pip install numpy==1\.26\.4"),
        ("torch", "2.0", "torch 2.0 there, none here"),
        ("platform", "linux m68k", "platform linux m68k there"),
    ):
        manifest = json.loads(kept[tmp_path / "c" / "manifest.json"])
        manifest["environment"][name] = value
        (tmp_path / "c" / "manifest.json").write_text(json.dumps(manifest))
        with pytest.raises(InputError, match=says) as refused:
            run(plan(flights=2), InlineEngine(), tmp_path / "c")
        assert refused.value.field == "--out"
    manifest["environment"] = json.loads(kept[tmp_path / "c" / "manifest.json"])["environment"] | {
        "cores": "64", "python": "3.99",
    }  # fmt: skip
    (tmp_path / "c" / "manifest.json").write_text(json.dumps(manifest))
    run(plan(flights=2), InlineEngine(), tmp_path / "c")
    kept = {p: p.read_bytes() for p in (tmp_path / "c").rglob("*") if p.is_file()}
    (tmp_path / "c" / "manifest.json").write_text("{")
    with pytest.raises(InputError, match=r"manifest\.json in order"):
        run(plan(flights=2), InlineEngine(), tmp_path / "c")
    (tmp_path / "c" / "manifest.json").write_bytes(kept[tmp_path / "c" / "manifest.json"])
    assert kept == {p: p.read_bytes() for p in (tmp_path / "c").rglob("*") if p.is_file()}


def test_workers_that_cannot_start_are_told_of(tmp_path):
    lost = replace(plan(), work=Work("tests.campaign.no_such_module:fly"))
    with pytest.raises(WorkersDieError, match="before they were ready"):
        run(lost, LocalEngine(2), tmp_path / "c")
    assert run(plan(flights=1), InlineEngine(), tmp_path / "c").complete


def test_status_while_it_flies_and_after_a_kill(tmp_path):
    folder = tmp_path / "c"
    driver = start(folder, flights=400, sleep=0.02)
    wait_for(lambda: journalled(folder) >= 10)
    found = status_of(folder)
    assert found.state == "flying" and found.wanted == 800
    assert 5.0 < found.rate < 100.0 and found.seconds_left > 5.0
    driver.kill()
    driver.communicate(timeout=60)
    assert status_of(folder).state == "killed"
