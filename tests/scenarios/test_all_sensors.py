"""All-sensor study: metrics from synthetic counts, result file, and one flight."""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.fusion import FusedMapper
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.rocks.field import RockField
from lunarsim.studies import report_study, run_study
from lunarsim.world.terrain import Terrain
from tests.made_mapper import TERMS, Slow
from tests.worlds import flat_terrain


@dataclass(frozen=True)
class Scan:
    """The parts of a scan that matter for lost returns."""

    time: float
    range: np.ndarray


@pytest.fixture
def study(script):
    return script(".", "sensor_fusion")


@pytest.fixture
def figures(study):
    return importlib.import_module("sensor_fusion_figures")


@pytest.fixture
def flights(study):
    return importlib.import_module("sensor_fusion_flights")


def judged(flights, p, safe, large=None, objects=()):
    """Return the counts of a map that is calibrated everywhere, one cell per position."""
    p, s = np.asarray(p, np.float32), np.asarray(safe, bool)
    grid = Grid(0.0, 0.0, 1.0, 1, len(p))
    seen = np.ones((1, len(p)), bool)
    drawn = HazardMap(grid, p[None], seen, np.zeros((1, len(p)), np.float32), in_domain=seen)
    ground = flights.MapTruth(
        grid.centres().reshape(-1, 2), s, np.zeros(len(p), bool) if large is None else large,
        np.array([[x, 0.0] for x in objects]).reshape(-1, 2),
    )  # fmt: skip
    return json.loads(json.dumps(flights.count_sites(drawn, ground)))


def test_map_metrics(figures, flights):
    truth = [True] * 8 + [False] * 2
    good = judged(flights, [0.9] * 8 + [0.6, 0.1], truth, objects=(8.0, 9.0))
    f = figures.map_metrics([good, good])
    assert f["precision"] == pytest.approx(8 / 9)
    assert f["recall"] == 1.0
    assert f["recall_at_precision"] == 1.0
    assert f["missed_hazard"] == f["missed_objects"] == 0.5
    assert f["ece"] == pytest.approx((8 * 0.1 + 0.6 + 0.1) / 10, abs=1e-6)
    assert f["skill"] == pytest.approx(1.0 - (8 * 0.01 + 0.36 + 0.01) / 10 / 0.16, abs=1e-6)


def test_fused_map_is_compared_with_the_best_other_map_per_field(figures, flights):
    truth = [True] * 5 + [False] * 5
    half = judged(flights, [0.9, 0.9, 0.2, 0.2, 0.2] + [0.4] * 5, truth)
    whole = judged(flights, [0.9] * 5 + [0.1] * 5, truth)
    none = judged(flights, [0.1] * 5 + [0.9] * 5, truth)
    made = [
        flight(
            "made", "100", flights, dem=none, quadtree=none, rocks=half, alone=whole, fused=fused
        )
        for fused in (whole, half)
    ]
    # The fused form of the LiDAR only is no single-mapper map, but is reported as well.
    assert figures.best_single(made, "100") == "rocks"
    assert figures.recall_gains(made, "100", "rocks") == pytest.approx([0.6, 0.0])
    (found,) = figures.comparisons(made, 400.0)
    assert (found.best, found.gain_over_remaining, found.unmet_requirements) == ("rocks", [], [])
    assert found.gain_over_dem_only == pytest.approx([0.0, -0.6])


def flight(row, altitude, flights, **maps):
    return {"row": row, "ms": dict.fromkeys(flights.MAPS, 1.0), "refused": {},
            "maps": {altitude: maps}}  # fmt: skip


def test_large_rocks_are_counted_at_the_recall_of_the_lidar_map(figures, flights):
    """Both maps find four of five safe sites; one and none of these have a rock."""
    truth = np.array([True] * 5 + [False] * 3)
    large = ~truth
    dem = judged(flights, [0.9, 0.9, 0.8, 0.7, 0.1, 0.75, 0.2, 0.2], truth, large)
    fused = judged(flights, [0.9, 0.9, 0.9, 0.9, 0.2, 0.1, 0.1, 0.1], truth, large)
    assert figures.large_rock_fraction([dem], 0.8) == pytest.approx(1 / 5)
    assert figures.large_rock_fraction([fused], 0.8) == 0.0
    assert np.isnan(figures.large_rock_fraction([dem], 0.0))
    others = dict.fromkeys(("dem", "quadtree", "rocks", "alone"), dem)
    for last, aims in ((fused, []), (dem, ["large hazards"])):
        (found,) = figures.comparisons([flight("made", "1000", flights, **others, fused=last)], 4e2)
        assert found.large_dem == pytest.approx(1 / 5)
        assert found.unmet_requirements == aims


def test_fused_map_is_compared_with_the_remaining_sensor_after_a_failure(figures, flights):
    truth = [True] * 5 + [False] * 5
    whole = judged(flights, [0.9] * 5 + [0.1] * 5, truth)
    none = judged(flights, [0.1] * 5 + [0.9] * 5, truth)
    for row, left in (("cameras dead from 400 m on", "dem"), ("LiDAR dead from 400 m on", "rocks")):
        maps = dict.fromkeys(flights.MAPS, none) | {left: whole}
        for altitude, gap in (("500", []), ("200", [-1.0])):
            (found,) = figures.comparisons([flight(row, altitude, flights, **maps)], 400.0)
            assert found.gain_over_remaining == gap
            assert ("worse than the remaining sensor" in found.unmet_requirements) == bool(gap)


def test_time_of_a_requested_surface_counts_for_its_own_mapper(flights, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(flights.time, "perf_counter", lambda: now[0])

    own = Slow(now)
    fused = FusedMapper({"own": own}, TERMS)
    clock = flights.MapperTimer({"own": own, "fused": fused})
    own.update(0.7, None)
    fused.hazard_map()
    told = clock.mean_ms()
    assert told["fused"] == 0.0
    assert told["own"] == 1e3 * now[0] > 0.0


def test_all_mappers_lose_the_same_half_of_the_returns(flights):
    taken = []
    lossy = flights.with_dropouts(lambda scan, estimate: taken.append(scan.range))
    scan = Scan(3.21, np.ones((100, 100)))
    lossy(scan, None)
    lossy(scan, None)
    assert np.isnan(taken[0]).mean() == pytest.approx(0.5, abs=0.03)
    assert np.array_equal(taken[0], taken[1], equal_nan=True)


def test_rocks_in_the_footprint_and_their_heights(flights):
    xy = np.array([[0.0, 0.0], [3.0, 0.0], [8.0, 0.0]])
    middles, radius = np.array([[4.0, 0.0]]), np.array([0.5])
    assert flights.has_rock_in_footprint(xy, middles, radius, 3.0).tolist() == [False, True, False]
    assert flights.has_rock_in_footprint(xy, middles, radius, 3.5).tolist() == [True, True, True]
    assert not flights.has_rock_in_footprint(xy, np.empty((0, 2)), np.empty(0), 3.0).any()
    rocks = RockField.hemispheres([0.0, 5.0], [0.0, 1.0], [0.0, -0.2], [0.5, 0.5])
    terrain = Terrain(flat_terrain(40.0, 2.0).relief, rocks)
    assert flights.rock_heights(terrain) == pytest.approx([0.5, 0.3], abs=1e-6)


def test_every_row_is_a_valid_scenario(flights):
    """Both cameras build one map, and the fused map decides."""
    for row in flights.ROWS.values():
        scenario = flights.scenario_of(row.world, (1000.0, 100.0))
        assert scenario.start.make().position[2] == pytest.approx(1200.0)
        assert scenario.mappers["rocks"].make().sensors == ("narrow", "wide")
        assert set(row.failed_sensors) <= set(scenario.tasking)
        assert row.remaining_map in ("", *flights.MAPS)


def test_study_compares_maps(study, flights, tmp_path, monkeypatch, capsys):
    truth = [True] * 5 + [False] * 5
    counts = judged(flights, [0.9] * 5 + [0.1] * 5, truth, objects=(7.0,))

    def fly(row, altitudes, seed):
        maps = {f"{a:g}": dict.fromkeys(flights.MAPS, counts) for a in altitudes}
        return {"maps": maps, "ms": dict.fromkeys(flights.MAPS, 1.0), "refused": {}}

    monkeypatch.setattr(study, "fly", fly)
    rows = run_study(study.study, count=2, levels={"row": ["level, rocks", "15 % cover"]})
    report_study(study.study, rows, out=tmp_path)
    printed = capsys.readouterr().out
    for words in (*flights.MAPS.values(), "objects", "Mean over rows", "15 % cover"):
        assert words in printed
    assert (tmp_path / "all_sensors.png").stat().st_size > 10_000


def test_joint_site_counts_of_two_maps(flights):
    """Each site counts once; sites that the second map has not observed are separate."""
    grid = Grid(0.0, 0.0, 1.0, 1, 4)
    seen = np.ones((1, 4), bool)
    p, q = np.float32([[0.9, 0.9, 0.1, 1.0]]), np.float32([[0.6, 0.6, 0.2, 0.0]])
    fused, second = HazardMap(grid, p, seen), HazardMap(grid, q, seen & (q > 0.0))
    xy, safe = grid.centres().reshape(-1, 2), np.array([True, False, False, True])
    counts = np.array(flights.count_jointly(fused, second, flights.MapTruth(xy, safe, ~safe, xy)))
    assert counts.sum() == 4
    row, col = (np.searchsorted(flights.ODDS, np.log(v / (1 - v))) - 1 for v in (0.9, 0.6))
    assert counts[0, row, col] == counts[1, row, col] == 1
    assert counts[1, -1, -1] == 1
    assert counts[0, :, -1].sum() == 0


def test_calibration_stage_is_fitted_to_flights(study, script, flights, tmp_path):
    """If the quadtree has information that the fused map lacks, its weight is not zero."""
    fit = script(".", "sensor_fusion_calibration")
    p, q, seen = fit.probability_bins()
    x, y = np.log(p / (1 - p)), np.where(seen, np.log(q / (1 - q)), 0.0)
    chance = 1 / (1 + np.exp(-(0.9 * x + 0.4 * y)))
    shape = 2, len(fit.ODDS) - 1, len(fit.ODDS)
    counts = np.rint(200_000 * np.stack((1 - chance, chance))).reshape(shape)
    made = [{"row": row, "maps": {"100": {"fused": {"joint": counts.tolist()}}}} for row in "ab"]
    file = tmp_path / "fit.json"
    file.write_text(json.dumps({"rows": made}))
    result = CliRunner().invoke(fit.main, [str(file), "--out", str(tmp_path / "c.json")])
    assert result.exit_code == 0, result.output
    told = json.loads((tmp_path / "c.json").read_text())
    weights = told["intercept"], told["slope"], told["other"]
    assert weights == pytest.approx((0.0, 0.9, 0.4), abs=0.02)
    none, _, both = (fit.evaluate_calibration(c, counts)[0] for c in (
        fit.FusedCalibration(), fit.fit_calibration(counts, False, fit.Lander()),
        fit.FusedCalibration(*weights)))  # fmt: skip
    assert both < none
    file.write_text(json.dumps({"rows": made[:1]}))
    alone = CliRunner().invoke(fit.main, [str(file)])
    assert alone.exit_code == 2 and "two or more study conditions" in alone.output


@pytest.mark.slow
def test_flight_is_evaluated(study):
    (kept,) = run_study(
        study.study, count=1, levels={"row": ["cameras dead from 400 m on"]},
        options={"altitude": (120.0,)},
    )  # fmt: skip
    maps = kept["maps"]["120"]
    # Above 400 m no image was mapped, so only the LiDAR map remains.
    assert maps["fused"] == maps["dem"]
    assert maps["dem"]["objects"][0] > 20


def test_rock_position_errors_exclude_shared_errors(script):
    """All rocks have the same offset: error of the mean and the reported covariance."""
    places = script(".", "rock_position_errors")
    rng = np.random.default_rng(0)
    level = np.array([0.0, 0.0, 0.0, 1.0])
    lander = StrapdownState(np.array([-30.0, 10.0, 40.0]), np.zeros(3), level, 1.62)
    rocks = RockFilter.of(lander, StartSigmas(2.0, 0.1, 1e-3))
    true = rng.uniform(-20.0, 20.0, (30, 2))
    rocks.add_known(true + [0.3, -0.1], np.full(30, 0.2), np.full(30, 0.4), np.full(30, 0.01))
    terrain = SimpleNamespace(
        rocks=SimpleNamespace(
            x=true[:, 0] - 5.0, y=true[:, 1] + 7.0, a=np.full(30, 0.4), b=np.full(30, 0.4)
        )
    )
    existence = np.where(np.arange(30) < 24, 0.99, 0.3)
    mapper = SimpleNamespace(tracker=SimpleNamespace(filter=rocks, existence=existence))
    simulation = SimpleNamespace(
        computer=SimpleNamespace(mappers={"rocks": mapper}),
        world=SimpleNamespace(terrain=terrain), navigation_error=np.array([5.0, -7.0, 0.0]),
    )  # fmt: skip
    found = places.position_errors(simulation)
    assert found["rocks"] == 24
    assert found["error_m"] == pytest.approx(np.sqrt(0.05))
    # Rocks that are known a priori share no error with the lander.
    variance = 0.2**2 / 24 + 2.0**2
    assert found["sigma_m"] == pytest.approx(np.sqrt(variance))
    assert found["nees"] == pytest.approx(0.1 / variance)
    existence[4:] = 0.0
    assert np.isnan(list(places.position_errors(simulation).values())).all()
