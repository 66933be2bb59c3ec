"""The cache of campaigns: results never depend on it, whatever state it is in."""

from __future__ import annotations

import os
import resource

import numpy as np
import pytest

from lunarsim.campaign import world_truth
from lunarsim.campaign.cache import CacheWarning, DiskCache, open_cache
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.engines.local import LocalEngine
from lunarsim.campaign.flight_execution import build_plan
from lunarsim.campaign.fly_spec import compile_kernels, fly_spec
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.campaign.world_truth import WorldTruthProvider
from lunarsim.cli_common import open_cache as open_command_cache
from lunarsim.errors import InputError
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from tests.worlds import TINY_FLIGHT


def spec(**changes: object) -> CampaignSpec:
    given = {"name": "c", "flights": 2, "seed": 3, "scenario": TINY_FLIGHT} | changes
    return CampaignSpec.from_dict(given)


def entries(folder):
    return sorted(folder.glob("??/*.npz"))


@pytest.fixture
def made(monkeypatch):
    """Return a list that grows by one whenever a safe fraction or a raster is computed."""
    calls = []
    for name in ("safe_fraction", "raster_safety"):
        computed = getattr(world_truth.TerrainTruth, name)

        def counted(*args, _computed=computed, **kwargs):
            calls.append(args)
            return _computed(*args, **kwargs)

        monkeypatch.setattr(world_truth.TerrainTruth, name, counted)
    return calls


def test_results_are_the_same_bytes_without_with_and_from_a_cache(tmp_path, made):
    arms = [
        {"name": "a", "set": {"policy": "no-divert"}},
        {"name": "b", "set": {"policy": "safest"}},
        {"name": "c", "set": {"vehicle.slope_limit_deg": 4.0}},
        {"name": "d", "set": {"rocks.cover": 0.12}},
    ]
    results = []
    for name, folder in (("without", None), ("cold", "c"), ("warm", "c")):
        cache = None if folder is None else open_cache(tmp_path / folder)
        before = len(made)
        fly_spec(spec(arms=arms, flights=1), InlineEngine(), tmp_path / name, cache=cache)
        # Policies share truth; other limits of the vehicle or other rocks have their own. The
        # fraction is computed for all headings and for one.
        assert len(made) - before == (0 if name == "warm" else 3 * 2)
        results.append((tmp_path / name / "results" / "part-00000.parquet").read_bytes())
    assert results[0] == results[1] == results[2]
    assert len(entries(tmp_path / "c")) == 3


def test_other_seeds_terrains_and_targets_are_other_entries(tmp_path, made):
    cache = open_cache(tmp_path)
    tiny = Scenario.from_dict(TINY_FLIGHT)
    for seed, scenario in (
        (flight_seed(1, 0), tiny),
        (flight_seed(1, 1), tiny),
        (flight_seed(2, 0), tiny),
        (flight_seed(1, 0), tiny.changed(rocks={"cover": 0.07})),
    ):
        memory = {}
        WorldTruthProvider(seed, memory, cache).raster(scenario)
    assert len(made) == 4
    world, stored, elevation = WorldTruthProvider(flight_seed(1, 0), {}, cache).raster(tiny)
    assert len(made) == 4
    truth = world_truth.TerrainTruth.of(world, tiny.vehicle.make())
    fresh = truth.raster_safety()
    assert stored.grid == fresh.grid
    for name in ("slope", "roughness", "safe", "observed"):
        a, b = (np.asarray(getattr(found, name)) for found in (stored, fresh))
        assert a.dtype == b.dtype and a.tobytes() == b.tobytes()
    assert elevation.tobytes() == world.terrain.raster(truth.grid).tobytes()
    here = WorldTruthProvider(flight_seed(1, 0), {}, cache).shares(tiny, truth)
    wide = tiny.changed(target={"scatter_m": [9.0, 9.0]})
    there = WorldTruthProvider(flight_seed(1, 0), {}, cache).shares(wide, truth)
    assert here != there
    turned = tiny.changed(start={"heading_deg": 45.0})
    assert WorldTruthProvider(flight_seed(1, 0), {}, cache).shares(turned, truth) != here
    assert WorldTruthProvider(flight_seed(1, 0), {}, cache).shares(tiny, truth) == here


def test_parts_from_elsewhere_are_not_kept(tmp_path, made):
    given = TINY_FLIGHT | {
        "terrain": {"kind": "lunarsim.world.terrain_models.fractal:FractalTerrain"}
    }
    for _ in range(2):
        cache = open_cache(tmp_path)
        WorldTruthProvider(flight_seed(1, 0), {}, cache).raster(Scenario.from_dict(given))
    assert len(made) == 2 and not entries(tmp_path)


def arrays(value: float = 1.0, size: int = 1000):
    return {"x": np.full(size, value), "y": np.arange(5)}


def test_damaged_entries_are_generated_again(tmp_path):
    cache = open_cache(tmp_path)
    cache.get("k", "one", arrays)
    (path,) = entries(tmp_path)
    whole = path.read_bytes()
    flipped = [bytearray(whole) for _ in range(8)]
    for i, data in enumerate(flipped):
        data[int((i + 0.5) / 8 * len(whole))] ^= 0x10
    damages = [b"", whole[:100], whole[:-1], whole[: len(whole) // 2], b"x" * len(whole)]
    for damage in [*damages, *map(bytes, flipped)]:
        path.write_bytes(damage)
        found = cache.get("k", "one", arrays)
        assert np.array_equal(found["x"], np.ones(1000)) and np.array_equal(found["y"], range(5))
        assert path.read_bytes() == whole
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_an_entry_is_made_once_and_another_key_is_another(tmp_path):
    cache = open_cache(tmp_path)
    for key, value in (("one", 1.0), ("two", 2.0)):
        cache.get("k", key, lambda v=value: arrays(v))
    for key, value in (("one", 1.0), ("two", 2.0)):
        assert cache.get("k", key, lambda: pytest.fail("made again"))["x"][0] == value


def test_old_entries_make_room_and_those_in_use_do_not(tmp_path):
    size = 8 * 12_500
    old = DiskCache(tmp_path, limit=10 * size, since=0.0)
    for i in range(9):
        old.get("k", str(i), lambda: arrays(size=12_500))
    for i, path in enumerate(sorted(entries(tmp_path), key=lambda p: p.stat().st_mtime)):
        os.utime(path, (1000.0 + i, 1000.0 + i))
    new = DiskCache(tmp_path, limit=10 * size, since=2000.0)
    made = [i for i in range(9) if new.get("k", str(i), lambda: arrays(0.0, 12_500))["x"][0] == 0.0]
    assert made == []
    before = {p.name for p in entries(tmp_path)}
    # All are in use by now: what comes is not kept, and nothing is thrown out.
    for i in range(20, 25):
        new.get("k", str(i), lambda: arrays(size=12_500))
    assert {p.name for p in entries(tmp_path)} == before
    later = DiskCache(tmp_path, limit=5 * size, since=4e9)
    later.get("k", "last", lambda: arrays(size=12_500))
    left = entries(tmp_path)
    assert sum(p.stat().st_size for p in left) <= 5 * size and len(left) == 4
    assert later.get("k", "last", lambda: pytest.fail("thrown out"))["x"][0] == 1.0


def test_a_full_disk_is_reported_once_and_changes_nothing(tmp_path):
    cache = open_cache(tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.warns(CacheWarning, match="Cannot write to the cache") as told:
            found = [cache.get("k", str(i), lambda: arrays(size=50_000)) for i in range(3)]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert len(told) == 1 and all(f["x"].sum() == 50_000 for f in found)
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []


def test_folders_that_will_not_do(tmp_path):
    with pytest.warns(CacheWarning, match="results are the same"):
        assert open_cache(tmp_path.__class__("/proc/lunarsim")) is None
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="a folder, not a file"):
        open_cache(tmp_path / "file")


def test_kernels_are_compiled_once_before_workers_start(tmp_path):
    cache, said = open_cache(tmp_path / "c"), []
    one = spec(flights=1, factors={"policy": ["no-divert"]}, time_limit_s=300.0)
    ran = fly_spec(one, LocalEngine(1, 300.0), tmp_path / "a", cache=cache, notify=said.append)
    assert ran.complete and ran.flown == 1
    assert len(said) == 2 and "1 flights" in said[0] and "ready" in said[1]
    # Other numbers choose no other kernel; another part does.
    numbers = spec(factors={"rocks.cover": [0.03, 0.04], "policy": ["no-divert"]})
    for again in (one, numbers):
        compile_kernels(again, build_plan(again), cache, said.append)
    assert len(said) == 2
    other = spec(factors={"policy": ["no-divert", "safest"]})
    with pytest.raises(InterruptedError, match="1 flights"):
        compile_kernels(other, build_plan(other), cache, interrupt)


def interrupt(text: str) -> None:
    raise InterruptedError(text)


def test_the_size_of_a_cache_is_reported_in_gib(tmp_path):
    assert open_command_cache(tmp_path, 0.5).limit == 2**29
    assert open_command_cache(tmp_path, 0.0) is None
