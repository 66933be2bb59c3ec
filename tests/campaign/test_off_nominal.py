"""Campaigns off the nominal case: what is refused, and figures that must not claim too much."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from scipy.stats import norm

from lunarsim.campaign.analysis import compare_campaigns, compute_arm_statistics, differences
from lunarsim.campaign.cache import open_cache
from lunarsim.campaign.dispersions import world_index
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.flight_execution import build_plan
from lunarsim.campaign.plan import Work
from lunarsim.campaign.rare_failures import estimate_failure_shares
from lunarsim.campaign.results import load_results
from lunarsim.campaign.rows import write_plan
from lunarsim.campaign.run import IntervalWidthRule, run
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.rng import flight_seed
from lunarsim.simulation import Flight
from tests.campaign.processes import write_manifest
from tests.campaign.surrogate import COLUMNS, fly, plan
from tests.chance import sample_sizes
from tests.worlds import TINY_FLIGHT

EAST = "start.position_m.0"
NORMAL = {"kind": "normal", "mean": -600.0, "sigma": 10.0}


def parts(folder):
    return {p.name: p.read_bytes() for p in sorted((folder / "results").glob("*.parquet"))}


def spec(**more: object) -> CampaignSpec:
    return CampaignSpec.from_dict({"name": "t", "flights": 4, "scenario": TINY_FLIGHT} | more)


def test_fewer_flights_than_there_are_delete_none(tmp_path):
    run(plan(flights=30), InlineEngine(), tmp_path / "c")
    before = parts(tmp_path / "c")
    with pytest.raises(InputError, match="30 or more") as refused:
        run(plan(flights=5), InlineEngine(), tmp_path / "c")
    assert refused.value.field == "flights" and parts(tmp_path / "c") == before


def test_rows_that_are_gone_are_reported_and_flown_again(tmp_path):
    run(plan(flights=30), InlineEngine(), tmp_path / "c")
    before = parts(tmp_path / "c")
    shutil.rmtree(tmp_path / "c" / "results")
    with pytest.raises(InputError, match="0 of 60 flights"):
        load_results(tmp_path / "c")
    run(plan(flights=30), InlineEngine(), tmp_path / "c")
    assert parts(tmp_path / "c") == before


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [("format", 0, "of format"), ("columns", {"safe": "complex"}, "unknown type of column"),
     ("arms", [], "has rows of arms"), ("inputs", None, "a damaged manifest")],
)  # fmt: skip
def test_a_manifest_that_does_not_fit_is_refused(tmp_path, key, value, says):
    run(plan(flights=3), InlineEngine(), tmp_path / "c")
    path = tmp_path / "c" / "manifest.json"
    data = json.loads(path.read_text()) | {key: value}
    if value is None:
        del data[key]
    write_manifest(tmp_path / "c", data)
    with pytest.raises(InputError, match=says):
        load_results(tmp_path / "c")


def test_junk_in_the_journal_is_left_out(tmp_path):
    run(plan(flights=3), InlineEngine(), tmp_path / "c")
    (tmp_path / "c" / "journal.jsonl").write_text('{"a": 1}\n[1, 2]\n[{"x": 1}, {}]\n')
    assert len(load_results(tmp_path / "c").table) == 6


def names_a_file(study, group, arm, memory):
    if group.flight == 1:
        raise ValueError("no file \udcff")
    return fly(study, group, arm, memory)


def test_an_error_that_utf_8_cannot_hold_is_a_row(tmp_path):
    made = plan(flights=3)
    work = Work("tests.campaign.test_off_nominal:names_a_file", made.work.study)
    ran = run(replace(made, work=work), InlineEngine(), tmp_path / "c")
    assert (ran.state, ran.failed) == ("complete", 2)
    assert "no file \\udcff" in load_results(tmp_path / "c").table["error"][2].as_py()


def test_a_landing_counts_whether_or_not_its_record_could_be_written(tmp_path, monkeypatch):
    whole = spec(flights=2, records="all")
    run(build_plan(whole, tmp_path / "kept"), InlineEngine(), tmp_path / "kept")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Flight, "save", full)
    ran = run(build_plan(whole, tmp_path / "full"), InlineEngine(), tmp_path / "full")
    assert (ran.flown, ran.failed) == (2, 0)
    assert "No space left on device" in ran.unrecorded
    kept, lost = (load_results(tmp_path / name).table for name in ("kept", "full"))
    told = ["id", "outcome", "safe", "propellant_kg", "divert_m"]
    assert lost.select(told).equals(kept.select(told))
    assert all("not written" in error for error in lost["error"].to_pylist())
    assert not list((tmp_path / "full" / "flights").glob("*/0*"))


def test_no_damage_of_a_cache_entry_is_taken_for_it(tmp_path):
    """Heads of arrays too, whose damage reads less of them, and so past their sums."""
    cache = open_cache(tmp_path)
    made = {"x": np.arange(2000.0).reshape(40, 50)}
    cache.get("k", "one", lambda: made)
    (path,) = tmp_path.glob("??/*.npz")
    whole = path.read_bytes()
    for place in (*range(30, 200, 3), *range(len(whole) - 120, len(whole), 3)):
        for bit in (0, 2, 4, 6):
            damaged = bytearray(whole)
            damaged[place] ^= 1 << bit
            path.write_bytes(damaged)
            found = cache.get("k", "one", lambda: made)
            assert list(found) == ["x"] and np.array_equal(found["x"], made["x"])


def test_other_code_of_a_part_from_elsewhere_is_another_campaign(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", "off_nominal_policy")
    source = "from lunarsim.parts import resolve\nclass Mine(resolve('policy', 'safest', '')):\n"
    module = tmp_path / "off_nominal_policy.py"
    seen = []
    for name in ("mine", "mine", "other"):
        module.write_text(f"{source}    name = {name!r}\n")
        seen.append(spec(factors={"policy": ["off_nominal_policy:Mine"]}).identity)
    assert seen[0] == seen[1] != seen[2]
    assert "made from" not in spec().identity


def test_another_terrain_under_the_same_path_is_another_campaign(tmp_path):
    def identity(height: float) -> dict[str, object]:
        with rasterio.open(
            tmp_path / "g.tif", "w", driver="GTiff", height=60, width=60, count=1, dtype="float32",
            crs="+proj=eqc +R=1737400 +units=m",
            transform=rasterio.transform.from_origin(0, 60, 1, 1),
        ) as file:  # fmt: skip
            file.write(np.full((60, 60), height, np.float32), 1)
        terrain = {"kind": "dtm", "path": str(tmp_path / "g.tif")}
        return dict(spec(scenario=TINY_FLIGHT | {"terrain": terrain}).identity)

    assert identity(1.0) == identity(1.0) != identity(2.0)


@pytest.mark.parametrize(
    ("more", "field"),
    [
        ({"dispersions": {EAST: NORMAL, "start.position_m": {"kind": "choice", "values": [[1.0]]}}},
         "dispersions.start.position_m"),
        ({"factors": {"policy": ["safest"], "policy.kind": ["safest"]}}, "arms.policy.kind"),
        ({"dispersions": {"rocks.cover": {"kind": "choice", "values": [2**63]}}},
         "dispersions.rocks.cover.values"),
        ({"dispersions": {"rocks.cover": {"kind": "choice", "values": [0.1, 0.2],
                                          "weights": [1.7e308, 1.7e308]}}},
         "dispersions.rocks.cover.weights"),
        ({"factors": {"policy": ["safest"]}, "arms": 3}, "arms"),
        ({"arms": [{"name": "x" * 300}]}, "arms"),
    ],
)  # fmt: skip
def test_what_would_be_wrong_later_is_refused(more, field):
    with pytest.raises(InputError) as refused:
        spec(**more)
    assert refused.value.field == field


def test_draws_of_lists_and_tables_have_columns(tmp_path):
    tables = [{"kind": "safest"}, {"kind": "no-divert"}]
    made = spec(
        dispersions={
            "target.scatter_m": {"kind": "choice", "values": [[1.0, 1.0], [2.0, 2.0]]},
            "policy": {"kind": "choice", "values": tables},
        }
    )
    assert build_plan(made).inputs == {"target.scatter_m": "text", "policy.kind": "text"}
    write_plan(build_plan(made), tmp_path / "p.csv", ".csv")
    assert "[2.0, 2.0]" in (tmp_path / "p.csv").read_text()


def chance(study, group, arm, memory):
    """The world alone says who lands."""
    rng = np.random.default_rng(flight_seed(study, world_index(group.flight, 8)))
    return {"safe": bool(rng.random(2)[arm] < 0.5), "x": 0.0, "steps": 0, "name": ""}


@sample_sizes(10, 40)
def test_flights_of_a_saltelli_block_do_not_count_as_many(tmp_path, count):
    """Sixteen blocks of eight are 32 worlds: 95 % intervals hold the truth, tests do not cry."""
    keys = [
        *(f"start.position_m.{i}" for i in range(3)),
        "target.position_m.0",
        "target.position_m.1",
    ]
    laws = {
        key: {"kind": "uniform", "low": low, "high": low + 1.0}
        for key, low in zip(keys, (-600.0, 0.0, 500.0, -1.0, -1.0), strict=True)
    }
    held = cried = 0
    for seed in range(count):
        made = spec(method="saltelli", dispersions=laws, flights=128, seed=seed,
                    factors={"policy": ["safest", "no-divert"]})  # fmt: skip
        work = Work("tests.campaign.test_off_nominal:chance", seed)
        folder = tmp_path / str(seed)
        run(replace(build_plan(made), work=work, columns=COLUMNS), InlineEngine(), folder)
        found = load_results(folder)
        figures = compute_arm_statistics(found)[0]
        assert (figures.rows, figures.flown, figures.shares["safe"].total) == (128, 128, 32)
        low, high = figures.shares["safe"].interval
        held += low <= 0.5 <= high
        (made_of_pairs,) = differences(found)
        assert made_of_pairs.pairs == 32
        cried += made_of_pairs.p < 0.05
        assert {v.difference.pairs for v in compare_campaigns(found, found, 0.05)} == {32}
    assert held >= 0.85 * count and cried <= 0.15 * count


def beyond(study, group, arm, memory):
    z = (group.draws[EAST] + 600.0) / 10.0
    return {"safe": bool(z < norm.isf(1e-2)), "z": float(z)}


@pytest.mark.parametrize(("shift", "rough"), [(2.3, False), (8.0, True)])
def test_failures_that_hardly_count_are_said_to_be_few(tmp_path, shift, rough):
    """A shift far beyond the limit: most flights fail, and one or two carry all the weight."""
    made = spec(method="importance", dispersions={EAST: NORMAL}, flights=1500,
                importance={"shifts": {EAST: shift}})  # fmt: skip
    work = Work("tests.campaign.test_off_nominal:beyond")
    run(replace(build_plan(made), work=work, columns={"safe": "bool", "z": "float"}),
    InlineEngine(),
        tmp_path / "c")  # fmt: skip
    (share,) = estimate_failure_shares(load_results(tmp_path / "c"))
    assert share.failures > 500 and share.is_approximate == rough


def lands(study, group, arm, memory):
    return {"safe": group.flight % 10 < study, "x": 0.0, "steps": 0, "name": ""}


def test_diff_is_of_the_same_draws_and_a_gain_is_no_equivalence(tmp_path):
    def flown(name: str, of_ten: int, **more: object):
        work = Work("tests.campaign.test_off_nominal:lands", of_ten)
        made = replace(build_plan(spec(flights=100, **more)), work=work, columns=COLUMNS)
        run(made, InlineEngine(), tmp_path / name)
        return load_results(tmp_path / name)

    poor, good, drawn = flown("a", 5), flown("b", 9), flown("c", 9, dispersions={EAST: NORMAL})
    for first, second, worse in ((poor, good, False), (good, poor, True)):
        (verdict,) = compare_campaigns(first, second, 0.05)
        assert not verdict.equivalent and verdict.worse == worse
    assert compare_campaigns(good, good, 0.05)[0].equivalent
    with pytest.raises(InputError, match="same dispersions"):
        compare_campaigns(good, drawn, 0.05)
    done = CliRunner().invoke(main, ["campaign", "diff", str(tmp_path / "a"), str(tmp_path / "b")])
    assert done.exit_code == 0 and "differ" not in done.output
    flown("d", 9, scenario=TINY_FLIGHT | {"gravity_m_s2": 1.7})
    done = CliRunner().invoke(main, ["campaign", "diff", str(tmp_path / "a"), str(tmp_path / "d")])
    assert done.exit_code == 0 and "scenario.gravity_m_s2" in done.output


def test_a_flight_without_an_outcome_counts_as_no_success_when_it_stops():
    seen, none = IntervalWidthRule("safe", 0.9, 1), IntervalWidthRule("safe", 0.9, 1)
    for flight in range(40):
        none.add(flight, 0, {"safe": None})
        seen.add(flight, 0, {"safe": False})
    assert none.stop == seen.stop is not None
    # Half of them without a verdict: a share about a half takes more flights than one at an end.
    half, ends = IntervalWidthRule("safe", 0.3, 1), IntervalWidthRule("safe", 0.3, 1)
    for flight in range(400):
        half.add(flight, 0, {"safe": True if flight % 2 else None})
        ends.add(flight, 0, {"safe": True})
    assert half.stop > 2 * ends.stop
