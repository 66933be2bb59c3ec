"""Lanes against a descent flown plainly, and against themselves in other company."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.scenario import Scenario
from lunarsim.vehicle.domain_randomization import RANDOM_QUANTITIES
from lunarsim.vehicle.state import State
from lunarsim.vehicle.touchdown import evaluate_touchdown, pad_contacts
from lunarsim.world import World
from lunarsim.world.terrain import Heightfield, Terrain
from lunarsim_envs.descent.batch import FLYING, LANDED, LATE, LOST, DescentBatch, VehicleParams
from lunarsim_envs.descent.worlds import WorldPool
from tests.reference import descent as plain
from tests.reference.raster import RasterGround

TABLES = {
    "terrain": {"kind": "fractal", "rms_slope_deg": 6.0, "size_m": 160.0},
    "rocks": {"cover": 0.08},
    "target": {"position_m": [3.0, -2.0], "scatter_m": [6.0, 4.0]},
    "start": {
        "position_m": [-18.0, 6.0, 22.0], "velocity_m_s": [4.0, -1.0, -5.0],
        "position_sigma_m": 2.0, "velocity_sigma_m_s": 1.0,
    },
    "simulation": {"max_time_s": 12.0},
}  # fmt: skip
ROUGH = Scenario.from_dict(TABLES)
VARIED = ROUGH.changed(domain_randomization={
    "payload_kg": 80.0, "specific_impulse_s": 15.0, "thrust_scale": 0.05, "thrust_lag_s": 0.05,
    "thrust_offset_m": 0.01, "engine_failure": 0.5, "torque_failure": 0.6,
    "min_remaining_fraction": 0.8,
    "latest_failure_s": 3.0,
})  # fmt: skip
RATES = {True: 5.0, False: 50.0}


@pytest.fixture(scope="module")
def worlds():
    return WorldPool.of(ROUGH, 2, 5)


def lanes_of(worlds, count, guided, first_key=11, scenario=ROUGH):
    lanes = DescentBatch(
        count, VehicleParams.of(scenario), worlds, guided=guided, rate=RATES[guided]
    )
    every = np.ones(count, bool)
    lanes.seed(every, np.arange(first_key, first_key + count, dtype=np.uint64) * np.uint64(977))
    lanes.begin(every)
    return lanes


def random_actions(lanes, rng):
    """Return actions that come down somewhere, more or less upright."""
    d = lanes.craft.dynamics
    noise = rng.normal(0.0, 0.2, (10_000, 3))[: lanes.count]  # lane i has the same in any company
    if not lanes.guided:
        return np.column_stack((2200.0 + 500.0 * noise[:, 0], 20.0 * noise))
    p, v = lanes.y[:, :3] - lanes.target, lanes.y[:, 3:6]
    wanted = -0.1 * p[:, :2] - 0.6 * v[:, :2]
    up = d.gravity - 0.8 * (v[:, 2:] + np.where(p[:, 2:] > 5.0, 4.0, 1.8))
    return np.hstack((wanted, up)) + noise


def ground_of(lanes, lane):
    return RasterGround(lanes.worlds.terrains[lanes.world[lane]], lanes.worlds.frame)


def end_of(path, lander, ground, gravity):
    """Return the last state of a path, and the verdict if it touched the ground there."""
    y = None
    for y in path:
        state = State.from_vector(y)
        pads = state.position + Rotation.from_quat(state.attitude).apply(lander.pads)
        if pads[:, 2].min() > lander.com_height + 30.0:
            continue
        if (pads[:, 2] <= pad_contacts(lander, state, ground)[:, 2]).any():
            return y, evaluate_touchdown(lander, state, ground, gravity)
    return y, None


def against_plain(worlds, guided, count, scenario=ROUGH):
    """Fly lanes and each of them plainly, to their ends; return how they ended."""
    lanes = lanes_of(worlds, count, guided, scenario=scenario)
    c, d = lanes.craft, lanes.craft.dynamics
    drawn = [plain.ALIKE] * count
    if c.domain_randomization is not None:
        drawn = [plain.varied((11 + i) * 977, 0, c.domain_randomization) for i in range(count)]
    ones = [
        plain.Lander(y, d, c.gains, c.heading, c.max_tilt, changes)
        for y, changes in zip(lanes.y, drawn, strict=True)
    ]
    heavy = [
        replace(d.lander, dry_mass=d.lander.dry_mass + changes["payload_kg"]) for changes in drawn
    ]
    rng = np.random.default_rng(3)
    while (lanes.ended == FLYING).any():
        flying = np.flatnonzero(lanes.ended == FLYING)
        actions = random_actions(lanes, rng)
        lanes.move(actions)
        for i in flying:
            path = (
                ones[i].guided(actions[i], lanes.steps) if guided
                else ones[i].driven(actions[i, 0], actions[i, 1:], lanes.steps)
            )  # fmt: skip
            y, verdict = end_of(path, heavy[i], ground_of(lanes, i), d.gravity)
            assert lanes.y[i] == pytest.approx(y, rel=1e-9, abs=1e-9)
            assert (verdict is not None) == (lanes.ended[i] == LANDED)
            if verdict is not None:
                assert lanes.failure_causes(i) == verdict.failure_causes
                assert lanes.safe[i] == verdict.safe
                slope = lanes.touchdown_values[i, 4]
                assert slope == pytest.approx(verdict.touchdown.slope, abs=1e-9)
    return lanes


def test_no_terrain_rises_faster_than_its_bound(worlds):
    """Points up to 0.3 m apart; the bound is less than four times the steepest of 50,000 pairs."""
    rng = np.random.default_rng(3)
    x0, y0, posting = worlds.frame
    for z, bound in zip(worlds.terrains, worlds.max_slopes, strict=True):
        elevation = RasterGround(z, worlds.frame).elevation
        extent = posting * (np.array(z.shape[::-1]) - 1.0)
        xy = np.array([x0, y0]) + rng.uniform(0.3, extent - 0.3, (50_000, 2))
        distance, angle = rng.uniform(0.001, 0.3, 50_000), rng.uniform(0.0, 2.0 * np.pi, 50_000)
        there = xy + (distance * np.array([np.cos(angle), np.sin(angle)])).T
        slope = (elevation(there) - elevation(xy)) / distance
        assert np.abs(slope).max() <= bound * (1.0 + 1e-6) < 4.0 * np.abs(slope).max()


def test_the_bound_of_the_slopes_changes_no_touchdown_beside_unknown_terrain():
    """Bands and points of unknown terrain, with steps of 2 m across the bands."""
    scenario = ROUGH.changed(rocks={"cover": 0.0}, target={"scatter_m": [0.0, 0.0]})
    grid = Grid.centred((3.0, -2.0), 40.0, 0.1)
    rng = np.random.default_rng(8)
    z = rng.normal(0.0, 0.01, (grid.rows, grid.cols))
    row, col = grid.rows // 2, grid.cols // 2
    z[:, : col - 60] += 2.0
    z[: row - 60] -= 2.0
    z[:, col - 60] = z[row - 60] = np.nan
    points = rng.random(z.shape) < 0.005
    points[row - 40 : row + 40, col - 40 : col + 40] = False  # known around the target
    z[points] = np.nan
    terrain = Terrain(Heightfield(grid, z.astype(np.float32)))
    bounded = WorldPool.rasterize(scenario, 1, [World(terrain, 1.62)])
    assert np.isfinite(bounded.max_slopes).all() and bounded.max_slopes[0] < 5.0
    found = []
    for worlds in (bounded, replace(bounded, max_slopes=np.full(1, np.inf))):
        lanes = lanes_of(worlds, 400, True, scenario=scenario)
        lanes.starts[:, :3] = [0.0, 0.0, 6.0]
        lanes.starts[:, 3:6] = [0.0, 0.0, -2.0]
        lanes.starts[:, 6:] = [5.0, 0.1]
        lanes.begin(np.ones(400, bool))
        for _ in range(80):
            lanes.move(np.tile([0.0, 0.0, 1.5], (400, 1)))
        found.append((lanes.y, lanes.ended, lanes.failed, lanes.touchdown_values))
    _, ended, failed, _ = found[0]
    unknown = (ended == LANDED) & (failed & 1 == 1)
    assert unknown.sum() > 20 and ((ended == LANDED) & ~unknown).sum() > 20
    for first, second in zip(*found, strict=True):
        assert np.array_equal(first, second, equal_nan=True)


@pytest.mark.parametrize("guided", [True, False])
def test_descents_are_those_flown_plainly(worlds, guided):
    lanes = against_plain(worlds, guided, 3)
    assert (lanes.ended == LANDED).any()


@pytest.mark.parametrize("guided", [True, False])
def test_descents_of_landers_that_are_drawn_are_those_flown_plainly(worlds, guided):
    lanes = against_plain(worlds, guided, 4, VARIED)
    assert (lanes.ended == LANDED).any()
    assert (lanes.params[:, 4] != 1500.0).all()


@pytest.mark.slow
def test_a_hundred_descents_are_those_flown_plainly(worlds):
    lanes = against_plain(worlds, True, 100)
    assert 0 < lanes.safe.sum() < 100
    assert (lanes.ended == LANDED).sum() > 80


def test_starts_are_those_drawn_plainly(worlds):
    lanes = lanes_of(worlds, 40, True)
    c, key = lanes.craft, (np.arange(11, 51, dtype=np.uint64) * np.uint64(977)).tolist()
    for flight in range(3):
        for i in range(40):
            world, target, off, velocity = plain.begun(key[i], flight, c.start, c.target_area, 2)
            assert lanes.world[i] == world
            assert lanes.target[i, :2] == pytest.approx(target, abs=1e-12)
            frame = worlds.rock_free_frame
            relief = RasterGround(worlds.rock_free_terrains[world], frame).elevation(target)
            assert lanes.target[i, 2] == pytest.approx(relief[0], abs=1e-9)
            assert lanes.y[i, :3] - lanes.target[i] == pytest.approx(off, abs=1e-9)
            assert lanes.y[i, 3:6] == pytest.approx(velocity, abs=1e-12)
            assert lanes.y[i, 13:] == pytest.approx([1500.0, 1500.0 * 1.622])
        lanes.begin(np.ones(40, bool))


def test_landers_are_those_drawn_plainly(worlds):
    """With every range open, flight after flight; another flight of the same start."""
    keys = {"sensing_delay_s": 1.0, "actuation_delay_s": 0.5}
    table = {key: value for key, value in VARIED.to_dict()["domain_randomization"].items() if value}
    lanes = lanes_of(worlds, 60, True, scenario=ROUGH.changed(domain_randomization=table | keys))
    alike = lanes_of(worlds, 60, True)
    varied, every = lanes.craft.domain_randomization, np.ones(60, bool)
    seen = []
    for flight in range(2):
        for i in range(60):
            wanted = plain.varied((11 + i) * 977, flight, varied)
            assert dict(zip(RANDOM_QUANTITIES, lanes.randomized[i], strict=True)) == pytest.approx(
                wanted, rel=1e-12
            )
            params = lanes.params[i]
            assert params[1] == pytest.approx(9.80665 * (311.0 + wanted["specific_impulse_s"]))
            assert params[2] == pytest.approx(0.1 + wanted["thrust_lag_s"])
            assert params[3:] == pytest.approx([1100.0 + wanted["payload_kg"], lanes.y[i, 13]])
        assert np.array_equal(lanes.y[:, :13], alike.y[:, :13])
        seen.append(lanes.randomized.copy())
        lanes.begin(every)
        alike.begin(every)
    drawn = np.vstack(seen)
    assert not (seen[0] == seen[1])[:, :6].any()
    # As often, and as evenly, as it says.
    engine = RANDOM_QUANTITIES.index("engine_effectiveness")
    assert abs((drawn[:, engine] < 1.0).mean() - 0.5) < 0.15
    torque = RANDOM_QUANTITIES.index("torque_effectiveness_x")
    weak = drawn[:, torque : torque + 3] < 1.0
    assert abs(weak.any(axis=1).mean() - 0.6) < 0.15 and weak.sum(axis=1).max() == 1
    assert weak.any(axis=0).all()
    most = [80.0, 15.0, 0.05, 0.05, 0.01, 0.01]
    spread = drawn[:, :6] / most
    assert (np.abs(spread) <= 1.0).all() and np.abs(spread.mean(axis=0)).max() < 0.2
    assert spread.std(axis=0) == pytest.approx(np.full(6, 3.0**-0.5), abs=0.1)


@pytest.mark.parametrize("guided", [True, False])
def test_a_lane_flies_the_same_bits_in_any_company_and_on_any_threads(worlds, guided):
    threads = numba.get_num_threads()
    kept = []
    try:
        for count, allowed in ((5, 1), (64, threads)):
            numba.set_num_threads(allowed)
            lanes, rng = lanes_of(worlds, count, guided), np.random.default_rng(4)
            for _ in range(30):
                lanes.move(random_actions(lanes, rng))
            kept.append(
                (lanes.y[:5].copy(), lanes.ended[:5].copy(), lanes.touchdown_values[:5].copy())
            )
    finally:
        numba.set_num_threads(threads)
    for first, second in zip(*kept, strict=True):
        assert np.array_equal(first, second, equal_nan=True)


def test_a_flight_ends_at_its_limit_or_off_the_map(worlds):
    lanes = lanes_of(worlds, 2, True)
    lanes.y[1, :2] += 500.0  # beyond all terrain that is stored
    lanes.max_distance[1] = np.inf
    for step in range(70):
        hover = np.tile([0.0, 0.0, 1.622], (2, 1))
        hover[1, 2] = 0.3
        lanes.move(hover - [0.0, 0.0, 0.5] * lanes.y[:, 5:6])
        if step == 58:
            assert lanes.ended[0] == FLYING
    assert lanes.ended.tolist() == [LATE, LOST]
    assert lanes.time[0] == pytest.approx(12.0)
    assert lanes.failure_causes(0) == ("time-limit",) and lanes.failure_causes(1) == ("off-map",)
    before = lanes.y.copy()
    lanes.move(np.zeros((2, 3)))
    assert np.array_equal(lanes.y, before)


@pytest.mark.parametrize(
    ("tables", "field"),
    [
        ({"legs": {}}, "legs"),
        ({"moon": {}}, "moon"),
        ({"faults": {"engine_stuck_from_s": 5.0}}, "faults"),
        ({"control": {"kind": "ideal"}}, "control.kind"),
        ({"vehicle": {"kind": "jet-lander"}, "control": {"kind": "phase-plane"}}, "vehicle.kind"),
    ],
)
def test_what_only_the_whole_simulation_flies_is_refused(tables, field):
    with pytest.raises(InputError) as caught:
        VehicleParams.of(Scenario.from_dict(TABLES | tables))
    assert caught.value.field == field


def test_stored_terrain_is_as_wide_as_the_lander_needs():
    wide = ROUGH.changed(
        vehicle={"leg_radius_m": 60.0}, mappers={"dem": {"size_m": 250.0}},
        terrain={"size_m": 260.0}, rocks={"cover": 0.01},
    )  # fmt: skip
    pool = WorldPool.of(wide, 1, 1)
    rows, cols = pool.terrains.shape[-2:]
    west, south, posting = pool.frame
    assert west <= 3.0 - 6.0 - 60.3 and west + (cols - 1) * posting >= 3.0 + 6.0 + 60.3 - posting
    assert south <= -2.0 - 4.0 - 60.3 and south + (rows - 1) * posting >= 2.0 + 60.3 - posting


def test_worlds_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="worlds"):
        WorldPool.of(ROUGH, 0, 1)
    with pytest.raises(InputError, match="GiB"):
        WorldPool.of(ROUGH, 10_000, 1)
    far = Scenario.from_dict(TABLES | {"target": {"position_m": [75.0, 0.0], "scatter_m": [9, 0]}})
    with pytest.raises(InputError, match=r"target\.position_m\[0\]: .*with its scatter"):
        WorldPool.of(far, 1, 1)


def test_worlds_are_those_of_a_campaign(worlds):
    """World k is that of flight k."""
    from lunarsim.rng import RandomStreams, flight_seed
    from lunarsim.simulation.worlds import build_world

    terrain = build_world(ROUGH, RandomStreams(flight_seed(5, 1))).terrain
    x, y, p = worlds.frame
    for row, col in ((10, 20), (300, 400), (500, 77)):
        height = terrain.elevation([x + p * col, y + p * row])
        assert worlds.terrains[1][row, col] == pytest.approx(float(height), abs=1e-5)
    assert not np.array_equal(worlds.terrains[0], worlds.terrains[1])
