"""Folders with parts that are broken or not their own, and a disk that is full."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.results import load_results, read_status
from lunarsim.campaign.run import run
from lunarsim.errors import InputError
from tests.campaign.processes import fly_alone, journalled, parts, start, write_part
from tests.campaign.surrogate import plan

pytestmark = pytest.mark.usefixtures("short_parts")


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
    write_part(path, table.from_pylist(rows, table.schema))
    ran = run(plan(), InlineEngine(), folder)
    assert (ran.before, ran.flown) == (60, 20) and "cannot be read" in ran.notes[0]
    assert parts(folder) == whole


def journal_of_a_kill(tmp_path: Path) -> tuple[Path, int, Path]:
    """Return a folder whose driver was killed, the rows that it has, and its journal."""
    folder = tmp_path / "c"
    fly_alone(folder, die=("before", "results/part-00001.parquet", 1))
    return folder, journalled(folder), folder / "journal.jsonl"


def test_lines_of_the_journal_that_are_no_rows_of_it_are_reported(tmp_path, whole):
    folder, before, path = journal_of_a_kill(tmp_path)
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
    folder, before, path = journal_of_a_kill(tmp_path)
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
    assert "journal.jsonl" in said and "repeat the command" in said
    before = journalled(folder)
    assert 0 < before < 20
    assert len((tmp_path / "flown.txt").read_text().split()) - before <= 2
    assert read_status(folder).state == "killed"
    ran = run(plan(), InlineEngine(), folder)
    assert (ran.before, ran.notes) == (before, ())
    assert parts(folder) == whole
