"""A damaged folder of a campaign is one error that names the file; flipped bits are noticed."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from lunarsim.campaign import results
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.manifest import read_manifest
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run
from lunarsim.cli import main
from lunarsim.errors import InputError
from tests.campaign.processes import parts, write_manifest
from tests.campaign.surrogate import plan
from tests.security import fuzz

COMMANDS = (
    ("campaign", "status"), ("campaign", "report"), ("campaign", "sensitivity"),
    ("campaign", "rare"),
)  # fmt: skip


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign") / "c"
    run(plan(), InlineEngine(), folder)
    return folder


@pytest.fixture
def folder(flown, tmp_path):
    return shutil.copytree(flown, tmp_path / "c")


def manifest(folder):
    return json.loads((folder / "manifest.json").read_text())


def ends_well(folder, *commands):
    """Run commands on a folder; none may end in a traceback."""
    for command in commands:
        with fuzz.at_most(10.0):
            done = CliRunner().invoke(main, [*command, str(folder)])
        assert done.exception is None or isinstance(done.exception, SystemExit), (
            command, done.exception
        )  # fmt: skip
        assert done.exit_code in (0, 2), (command, done.output)


def test_every_flipped_bit_of_a_part_is_noticed(folder, flown):
    assert set(manifest(folder)["parts"]) == {"results/part-00000.parquet",
                                              "timing/part-00000.parquet"}  # fmt: skip
    rng = np.random.default_rng(1)
    for name in manifest(folder)["parts"]:
        whole = (folder / name).read_bytes()
        for place in rng.integers(len(whole), size=40):
            data = bytearray(whole)
            data[place] ^= 1 << int(rng.integers(8))
            (folder / name).write_bytes(data)
            with pytest.raises(InputError, match=r"digest.*part-00000"):
                load_results(folder)
        if name.startswith("results"):
            ran = run(plan(), InlineEngine(), folder)
            assert (ran.state, ran.flown) == ("complete", 80) and "digest" in ran.notes[0]
            assert parts(folder) == parts(flown)
        (folder / name).write_bytes((flown / name).read_bytes())


def test_no_flipped_bit_of_a_manifest_changes_a_value(folder):
    path, values = folder / "manifest.json", read_manifest(folder)
    whole, noticed = path.read_bytes(), 0
    rng = np.random.default_rng(1)
    for place in rng.choice(len(whole), size=400, replace=False):
        data = bytearray(whole)
        data[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        try:
            # The name of the digest may be damaged, or the space between values.
            assert {key: read_manifest(folder)[key] for key in values} == values
        except InputError as error:
            assert "a damaged manifest.json" in str(error)
            noticed += 1
    assert noticed > 300


def test_a_changed_value_of_a_manifest_is_noticed(folder):
    path = folder / "manifest.json"
    tables = manifest(folder)
    for key, value in (("seed", 3), ("rows", 79), ("state", "running"), ("engine", "other")):
        path.write_text(json.dumps(tables | {key: value}))
        for read in (load_results, lambda folder: run(plan(), InlineEngine(), folder)):
            with pytest.raises(InputError, match=r"a damaged manifest\.json \(.*digest"):
                read(folder)
    # Folders of versions that wrote no digest are read.
    path.write_text(json.dumps({key: tables[key] for key in tables if key != "digest"}))
    assert len(load_results(folder).table) == 80


def test_digests_follow_the_parts(tmp_path):
    """Also where a campaign goes on, flies again what failed, or is cut down."""
    folder = tmp_path / "c"
    run(plan(flights=5), InlineEngine(), folder)
    first = manifest(folder)["parts"]
    run(plan(flights=8), InlineEngine(), folder)
    second = manifest(folder)["parts"]
    assert first != second and len(load_results(folder).table) == 16
    run(plan(flights=8), InlineEngine(), folder, retry=True)
    assert manifest(folder)["parts"] == second and len(load_results(folder).table) == 16


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("flights", "40"), ("flights", 1e300), ("flights", 10**12), ("flights", True), ("rows", -1),
        ("seed", None), ("seed", 1.5), ("arms", {}), ("arms", [{"name": "a"}]), ("arms", ["a"]),
        ("columns", []), ("columns", {"id": "text"}), ("inputs", {"x": "float"}), ("state", 3),
        ("identity", []), ("identity", {"method": "subset"}), ("identity", {"method": 1}),
        ("identity", {"method": "importance"}), ("environment", {"python": 3}), ("parts", [1]),
    ],
)  # fmt: skip
def test_fields_of_a_manifest_have_types(folder, key, value):
    write_manifest(folder, manifest(folder) | {key: value})
    clash = ("inputs", *(["columns"] if value else []))
    for read in (load_results, lambda folder: run(plan(), InlineEngine(), folder)):
        with pytest.raises(
            InputError, match=f"a damaged manifest.json.*{'occurs twice' if key in clash else key}"
        ):
            read(folder)
    ends_well(folder, *COMMANDS)


@pytest.mark.parametrize("text", [b"[" * 100_000, b"\xff\xfe", b"", b"1" * 5000, b'{"a": NaN}'])
def test_deep_or_odd_json_is_one_error(folder, text):
    (folder / "manifest.json").write_bytes(text)
    with pytest.raises(InputError, match=r"a damaged manifest\.json"):
        load_results(folder)


@pytest.mark.parametrize("key", ["name", "seed", "arms", "columns", "inputs"])
def test_a_manifest_that_contradicts_the_spec_is_not_continued(folder, key):
    tables = manifest(folder)
    changed = {"name": "x", "seed": 7, "arms": tables["arms"][::-1], "inputs": {}, "columns": {}}
    write_manifest(folder, tables | {key: changed[key]})
    with pytest.raises(InputError, match=key):
        run(plan(), InlineEngine(), folder)


@pytest.mark.parametrize(
    "line",
    ["[" * 100_000, '[{"id": "0-0", "flight": "x", "arm": 3}, {}]', '[{"id": []}, []]',
     '[{"id": "0-0", "flight": 0, "arm": "a0", "safe": "x"}, {"id": 1}]'],
)  # fmt: skip
def test_a_damaged_line_of_the_journal_is_flown_again(folder, flown, line):
    for name in manifest(folder)["parts"]:
        (folder / name).unlink()
    (folder / "journal.jsonl").write_text(line + "\n")
    try:
        load_results(folder)
    except InputError as error:
        assert "journal" in str(error) or "0 of 80 flights" in str(error)
    assert run(plan(), InlineEngine(), folder).flown == 80
    assert parts(folder) == parts(flown)


def damaged(folder, flown, seed):
    """Damage one file of a campaign."""
    rng = np.random.default_rng(seed)
    names = ["manifest.json", *manifest(flown)["parts"]]
    for name in names:
        (folder / name).write_bytes((flown / name).read_bytes())
    if rng.random() < 0.7:
        tables = manifest(flown)
        if rng.random() < 0.5:
            del tables["digest"]  # so that damage reaches the code behind it
        (folder / "manifest.json").write_bytes(fuzz.damaged_json(tables, rng))
    else:
        name = names[int(rng.integers(1, 3))]
        (folder / name).write_bytes(fuzz.damaged_bytes((flown / name).read_bytes(), rng))


def test_damaged_folders_end_in_one_error(folder, flown):
    for seed in range(40):
        damaged(folder, flown, seed)
        ends_well(folder, COMMANDS[seed % len(COMMANDS)])
        fuzz.survives(lambda: load_results(folder), f"campaign {seed}")
        fuzz.survives(lambda: run(plan(), InlineEngine(), folder), f"continued {seed}")
        shutil.rmtree(folder)
        shutil.copytree(flown, folder)


@pytest.mark.parametrize(
    "name",
    ["journal.jsonl", ".lock", "spec.toml", "manifest.json", "results", "flights/a/00000",
     "timing/part-00007.parquet"],
)  # fmt: skip
@pytest.mark.parametrize("to", ["file", "folder", "gone", "pipe"])
def test_links_and_pipes_in_a_campaign_are_refused(folder, tmp_path, name, to):
    """Nothing outside is read, emptied, created or written to, and nothing waits for a pipe."""
    outside, path = tmp_path / "outside", folder / name
    outside.mkdir()
    (outside / "file").write_text("secret")
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    if to == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(outside if to == "folder" else outside / to)
    for read in (load_results, lambda folder: run(plan(), InlineEngine(), folder)):
        with (
            fuzz.at_most(10.0),
            pytest.raises(InputError, match=r"link, pipe|manifest|empty folder"),
        ):
            read(folder)
    assert [p.name for p in outside.iterdir()] == ["file"]
    assert (outside / "file").read_text() == "secret"


def test_a_lock_that_is_a_link_creates_no_file(tmp_path):
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / ".lock").symlink_to(tmp_path / "created")
    with pytest.raises(InputError, match="link, pipe or device"):
        run(plan(), InlineEngine(), tmp_path / "c")
    assert not (tmp_path / "created").exists()


def test_a_report_shows_files_that_are_no_utf_8(folder):
    for name in ("spec.toml", "scenario.toml"):
        (folder / name).write_bytes(b"\xff\xfe")
    ends_well(folder, ("campaign", "report"))
    assert (folder / "report.html").stat().st_size > 1000


def test_a_report_makes_no_terrain_of_gigabytes(folder):
    (folder / "scenario.toml").write_text("[terrain]\nsize_m = 4999.0\nposting_m = 0.25\n")
    ends_well(folder, ("campaign", "report"))


def test_a_manifest_of_a_million_arms_is_refused_at_once(folder):
    """A parser would take seconds for each part."""
    (folder / "manifest.json").write_text(json.dumps(manifest(folder)) + " " * 9_000_000)
    with pytest.raises(InputError, match="larger than 8 MiB"):
        load_results(folder)


@pytest.mark.parametrize(
    "change",
    [{"name": "\x1b]0;x\x07"}, {"arms": [{"name": "\x9b31m", "values": {}}]},
     {"identity": {"method": "sobol", "dispersions": {"gone": {"kind": "uniform"}}}}],
)  # fmt: skip
def test_names_for_a_terminal_and_draws_without_a_column_are_refused(folder, change):
    (folder / "manifest.json").write_text(json.dumps(manifest(folder) | change))
    ends_well(folder, *COMMANDS)
    with pytest.raises(InputError, match=r"a damaged manifest\.json.*(name|has no column)"):
        load_results(folder)


def test_a_part_that_expands_to_gigabytes_is_refused(folder):
    part = folder / "results" / "part-00000.parquet"
    table = pq.read_table(part)
    tables = manifest(folder)
    for odd in (
        {"error": pa.DictionaryArray.from_arrays(np.zeros(5000, np.int32), ["x" * 2_000_000])},
        {"error": pa.array(["x" * 200_000] * 2000)},
        dict.fromkeys("abcdefgh", pa.array(np.zeros(5_000_000, np.int8))),
    ):
        pq.write_table(pa.table(odd), part)
        assert part.stat().st_size < 3_000_000
        without = {k: v for k, v in tables.items() if k not in ("parts", "digest")}
        (folder / "manifest.json").write_text(json.dumps(without))
        with pytest.raises(InputError, match="when decompressed"):
            load_results(folder)
    ran = run(plan(), InlineEngine(), folder)
    assert ran.flown == len(table) and "when decompressed" in ran.notes[0]


def test_a_report_runs_no_script_of_a_manifest(tmp_path):
    folder, evil = tmp_path / "c", "</script><script>alert(1)</script>"
    given = plan()
    arms = [(evil + name, values) for name, values in given.arms]
    run(replace(given, arms=arms, name=evil), InlineEngine(), folder)
    (folder / "spec.toml").write_text(f"# </pre>{evil}")
    ends_well(folder, ("campaign", "report"))
    page = (folder / "report.html").read_text()
    assert "alert(1)" in page and "<script>alert" not in page


def test_a_part_that_changes_while_it_is_read_is_read_again(folder, monkeypatch):
    """As in a campaign that is flying."""
    now = results.read_manifest(folder)
    before = now | {"parts": dict.fromkeys(now["parts"], "of the part before")}
    answers = [before, now, now]
    monkeypatch.setattr(results, "read_manifest", lambda folder: answers.pop(0))
    assert len(load_results(folder).table) == 80
