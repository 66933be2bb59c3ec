"""Matrix of worlds, and the two calibrations on it."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import click
import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console
from scipy.special import expit

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    LOG_ODDS_MARGIN,
)
from lunarsim.onboard.calibration.evidence import UNCONSTRAINED_FEATURES
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.studies import report_study, run_study
from lunarsim.world import World
from lunarsim.world.terrain import Heightfield, Terrain, place_rocks
from lunarsim.world.truth import TerrainTruth
from tests.conftest import SCENARIOS
from tests.given_truth import GivenTruth
from tests.made_mapper import Slow


def first(module, **changes):
    """Return a small scene at short range."""
    scene = next(iter(module.sample_matrix(8, 1)))
    return replace(scene, distance=140.0, angle_deg=0.0, relief="fractal-6", **changes)


def test_every_part_of_the_matrix_is_used(script):
    worlds = script("lidar_maps", "worlds")
    deck = list(worlds.sample_matrix(240, 3))
    for name, cards in (
        ("relief", worlds.RELIEFS), ("rocks", worlds.ROCKS), ("lander", tuple(worlds.LANDERS)),
    ):  # fmt: skip
        counts = [sum(getattr(s, name) == card for s in deck) for card in cards]
        assert max(counts) - min(counts) <= 1, name
    assert deck == list(worlds.sample_matrix(240, 3))
    assert len({s.seed for s in deck}) == 240


def test_time_of_the_requested_surface_counts_for_the_mapper(script, monkeypatch):
    flown = script("lidar_maps", "mapper_flights")
    now = [0.0]
    monkeypatch.setattr(flown.time, "perf_counter", lambda: now[0])

    mapper = Slow(now)
    clock = flown.SingleMapperTimer(mapper)
    mapper.terrain_surface()
    assert clock.seconds == 3.0


@pytest.mark.parametrize("name", ["calibration", "quadtree_calibration"])
def test_scene_evaluation_is_repeatable(script, name):
    study = script("lidar_maps", name)
    scene = first(study, rocks="golombek-5", lander="small")
    a, b = study.evaluate_scene(scene), study.evaluate_scene(scene)
    assert np.array_equal(a.features, b.features)
    assert np.array_equal(a.safe, b.safe)
    assert len(a.safe) > 20
    assert (
        len(a.features)
        == len(a.safe)
        == len(a.known)
        == len(a.outside_domain_bound)
        == len(a.observed_terrain_bound)
    )
    assert np.isfinite(a.features).all()
    done = CliRunner().invoke(study.main, ["--scenes", "2"])
    assert done.exit_code == 2


def test_scene_cache_is_exact_and_rejects_other_scenes(script, tmp_path):
    kept = script("lidar_maps", "scene_cache")
    worlds = script("lidar_maps", "worlds")
    drawn = []

    def judge(scene, add=0.0):
        drawn.append(scene)
        rng = scene.rng(9)
        n = int(rng.integers(2, 6))
        return kept.SceneSites(
            scene, rng.random((n, 3), np.float32), rng.random(n) < 0.5, rng.random(n) + add,
            rng.random(n), rng.random(n), rng.random(n) < 0.5, float(rng.random()),
            rng.random(n) < 0.5,
        )  # fmt: skip

    deck, other = (
        [kept.LidarScene(**asdict(s)) for s in worlds.sample_matrix(8, seed)] for seed in (3, 4)
    )
    file, console = tmp_path / "scenes.npz", Console(quiet=True)
    first = kept.load_or_evaluate(judge, deck, file, 1, console)
    drawn.clear()
    again = kept.load_or_evaluate(judge, deck, file, 1, console)
    assert drawn == deck[:1]
    for one, same in zip(first, again, strict=True):
        assert (one.scene, one.rough_fraction) == (same.scene, same.rough_fraction)
        assert all(np.array_equal(getattr(one, n), getattr(same, n)) for n in kept.ARRAYS)
    with pytest.raises(click.ClickException, match="other scenes"):
        kept.load_or_evaluate(judge, other, file, 1, console)
    with pytest.raises(click.ClickException, match="another version"):
        kept.load_or_evaluate(lambda s: judge(s, 1e-6), deck, file, 1, console)
    file.write_bytes(file.read_bytes()[:300])
    with pytest.raises(click.ClickException, match="not a file of scenes"):
        kept.load_or_evaluate(judge, deck, file, 1, console)


def test_held_out_rows_are_evaluated_by_a_fit_without_them(script, monkeypatch):
    study = script("lidar_maps", "calibration")
    rng = np.random.default_rng(1)
    deck = list(study.sample_matrix(24, 2))

    def judged(scene):
        x = rng.uniform(0.0, 1.0, (60, GAUSSIAN_DEM.count)).astype(np.float32)
        x[:, 0] = 1.0
        safe = rng.random(60) < 1.0 / (1.0 + np.exp(-(8.0 * x[:, UNCONSTRAINED_FEATURES] - 4.0)))
        ones = np.ones(60)
        known, claimable = rng.random(60) < 0.8, rng.random(60) < 0.5
        return study.SceneSites(scene, x, known, ones, ones, ones, claimable, 0.005, safe)

    scenes = [judged(s) for s in deck]
    rows = list(study.split_by_scene_type(scenes))
    assert {name.split()[0] for name, _, _ in rows} == {"relief", "rocks", "lander", "range"}
    for _, others, kept in rows:
        assert len(others) + len(kept) == 24
        assert not {id(j) for j in others} & {id(j) for j in kept}
    name, others, kept = rows[0]
    sites = study.PooledSites.of(kept)
    # A fit for each kind of relief, of which `others` has all but one.
    monkeypatch.setattr(study, "AXES", study.AXES[:1])
    model = study.fit_model(others)
    assert name not in model.without
    assert set(model.without) == {r for r, _, _ in rows if r.startswith("relief")} - {name}
    plain, _ = study.predict_safety(
        model, sites, replace(GAUSSIAN_DEM, outside_margin=LOG_ODDS_MARGIN)
    )
    assert study.calibration_metrics(plain, sites.safe)["skill"] > 0.0
    p, claimed = study.predict_safety(model, sites)
    assert (p <= plain).all()
    assert np.array_equal(
        p[claimed & (p >= ALMOST_CERTAINLY_SAFE_P)],
        plain[claimed & (plain >= ALMOST_CERTAINLY_SAFE_P)],
    )
    assert not claimed[~sites.known].any()
    # Sites that cannot be classified as unsafe are claimed only if they are certainly safe.
    assert not claimed[~sites.may_be_claimed_unsafe & (p < ALMOST_CERTAINLY_SAFE_P)].any()
    assert study.predict_safety(
        model, replace(sites, may_be_claimed_unsafe=~sites.may_be_claimed_unsafe)
    )[1][claimed & (p >= ALMOST_CERTAINLY_SAFE_P)].all()
    assert (p <= expit(sites.features @ np.array(model.weights).T).min(axis=1) + 1e-9).all()
    # A constant has no calibration error and no skill.
    flat = study.calibration_metrics(np.full(len(p), sites.safe.mean()), sites.safe)
    assert flat["ece"] < 0.01
    assert flat["skill"] == pytest.approx(0.0, abs=1e-9)
    assert study.table_of([study.HeldOutPrediction(name, p, claimed, sites)]).row_count == 1


@pytest.fixture
def small_world(script, monkeypatch, tmp_path):
    """The comparison of mappers on one small world."""
    flown = script("lidar_maps", "mapper_flights")
    compare = script("lidar_maps", "compare_mappers")
    # A short descent, with position fixes as in the study.
    small = Scenario.load(SCENARIOS / "golombek.toml").changed(
        terrain={"size_m": 90.0}, target={"scatter_m": [10.0, 10.0]},
        start={"position_m": [-300.0, 0.0, 250.0], "velocity_m_s": [18.0, 0.0, -12.0]},
        sensors={**flown.WITH_FIXES["sensors"], "flash": {"rows": 128, "cols": 128}},
        tasking={"flash": {"altitudes_m": [220.0, 120.0]}},
        mappers={"dem": {"posting_m": 0.4, "size_m": 70.0}},
    )  # fmt: skip
    small.save(tmp_path / "small.toml")
    monkeypatch.setattr(flown, "SCENARIOS", tmp_path)
    monkeypatch.setattr(flown, "WORLDS", {"small": ("small.toml", {"rocks": {"cover": 0.04}})})
    monkeypatch.setattr(compare, "fly", flown.fly)
    return flown, compare


@pytest.mark.slow
def test_mappers_are_compared_on_the_same_returns(small_world, tmp_path):
    flown, compare = small_world
    rows = run_study(compare.study, count=2, levels={"world": ["small"]})
    report_study(compare.study, rows, out=tmp_path)
    figures = json.loads((tmp_path / "figures.json").read_text())["small"]
    assert [f["flights"] for f in figures["landings"].values()] == [2] * len(flown.WAYS)
    cells = {
        tuple(s["cells"] for s in m["last"]["strata"].values()) for m in figures["maps"].values()
    }
    assert len(cells) == 1, "all maps are judged on the same cells"
    calibrated = figures["maps"]["calibrated"]
    assert calibrated["last"]["precision"][0] > 0.8
    assert calibrated["first"] != calibrated["last"], "maps grow between decisions"
    assert (tmp_path / "mappers.png").stat().st_size > 20_000


def test_extra_mappers_do_not_change_a_flight(small_world):
    flown, _ = small_world
    plain = flown.scenario_of("small")
    both = [
        Simulation(flown.with_mappers(plain, carried), 3, "safest").run()
        for carried in (("calibrated",), tuple(flown.MAPPERS))
    ]
    for column, values in both[0].trajectory.items():
        assert np.array_equal(values, both[1].trajectory[column], equal_nan=True), column


def test_map_evaluation_counts_cells(script):
    flown = script("lidar_maps", "mapper_flights")
    rng = np.random.default_rng(2)
    grid = Grid.centred((0.0, 0.0), 8.0, 0.2)
    p = rng.random(grid.shape).astype(np.float32)
    seen, known = rng.random(grid.shape) < 0.7, rng.random(grid.shape) < 0.5
    hazard_map = HazardMap(grid, np.where(seen, p, 0).astype(np.float32), seen, in_domain=known)
    safe, where = rng.random(grid.shape) < 0.4, rng.random(grid.shape) < 0.9
    strata = rng.integers(0, 4, grid.shape)
    judged = flown.evaluate_map(hazard_map, where, safe, strata)
    for k in range(4):
        hits = false = missed = rejected = 0
        number = good = squares = 0.0
        for cell in zip(*np.nonzero(where & (strata == k)), strict=True):
            called = bool(seen[cell] and p[cell] > 0.5)
            hits += called and safe[cell]
            false += called and not safe[cell]
            missed += safe[cell] and not called
            rejected += not safe[cell] and not called
            if seen[cell] and known[cell]:
                number, good = number + 1, good + safe[cell]
                squares += (float(p[cell]) - safe[cell]) ** 2
        assert judged.counts[k].tolist() == [hits, false, missed, rejected]
        assert judged.claimed[k] == pytest.approx([number, good, squares])
    assert judged.table[:, 0].sum() == judged.claimed[:, 0].sum()


def test_map_is_compared_with_the_terrain_under_it(script):
    flown = script("lidar_maps", "mapper_flights")
    # Safe terrain ends 1 m east; the truth ends 3 m south.
    own = Grid.centred((0.0, 0.0), 12.0, 0.5)
    east, north = own.centres()[..., 0], own.centres()[..., 1]
    truth = GivenTruth(own, east < 1.0, north > -3.0)
    # The map is shifted by 2 m to the east.
    grid = Grid.centred((2.0, 0.0), 8.0, 0.5)
    x, y = grid.centres()[..., 0], grid.centres()[..., 1]
    hazard_map = HazardMap(grid, (x < 3.0).astype(np.float32), np.ones(grid.shape, bool))
    error = np.array([2.0, 0.0, 0.5])
    judged = flown.evaluate_maps({"one": hazard_map}, error, truth, np.where(east < -1.0, 1, 0))[
        "one"
    ]
    known, west = y > -3.0, x < 1.0
    hits, rejected = known & (x < 3.0), known & (x >= 3.0)
    assert judged.counts.sum(axis=0).tolist() == [hits.sum(), 0, 0, rejected.sum()]
    assert judged.counts[1].tolist() == [(hits & west).sum(), 0, 0, 0]


def test_maps_on_different_grids_are_evaluated_on_the_same_terrain(script):
    flown = script("lidar_maps", "mapper_flights")
    own = Grid.centred((0.0, 0.0), 30.0, 0.5)
    east = own.centres()[..., 0]
    truth = GivenTruth(own, east < 1.0)
    maps = {}
    for name, middle in (("one", 0.0), ("other", 4.0)):
        grid = Grid.centred((middle, 0.0), 20.0, 0.5)
        x, y = grid.centres()[..., 0], grid.centres()[..., 1]
        seen = (np.abs(x) < 5.0) & (np.abs(y) < 5.0)
        maps[name] = HazardMap(grid, ((x < 1.0) & seen).astype(np.float32), seen)
    judged = flown.evaluate_maps(maps, np.zeros(3), truth, np.zeros(own.shape, int))
    for name in maps:
        hits, false, missed, _ = judged[name].counts.sum(axis=0)
        assert (false, missed) == (0, 0)
        assert hits == 12 * 20
    assert np.array_equal(judged["one"].counts, judged["other"].counts)


def test_strata_depend_on_slope_and_rocks(script):
    flown = script("lidar_maps", "mapper_flights")
    lander = Lander()
    limit = np.tan(lander.slope_limit)
    grid = Grid.centred((0.0, 0.0), 60.0, 0.5)
    x = grid.centres()[..., 0]
    for share, expected in ((0.2, 0), (0.7, 1), (1.2, 3)):
        relief = Heightfield(grid, (share * limit * x).astype(np.float32))
        rocks = place_rocks(relief, np.full(3, 1.5), np.random.default_rng(0))
        world = World(Terrain(relief, rocks), 1.62)
        strata = flown.strata_of(world, TerrainTruth.of(world, lander))
        found, counts = np.unique(strata[30:-30, 30:-30], return_counts=True)
        assert found[np.argmax(counts)] == expected
        assert (2 in found) == (expected < 2), "near a rock, unless too steep anyway"
