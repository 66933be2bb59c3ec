"""Flights to chosen sites against the computer's own laws flown plainly, maps against NumPy."""

from __future__ import annotations

from types import SimpleNamespace

import numba
import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.candidates import candidate_sites
from lunarsim_envs.descent.batch import FLYING, LANDED
from lunarsim_envs.sites import _choice_kernels as choice
from lunarsim_envs.sites import _flight_kernels as f
from lunarsim_envs.sites import _map_kernels as m
from lunarsim_envs.sites.batch import SiteDescentBatch
from lunarsim_envs.sites.field_of_view import in_view
from lunarsim_envs.sites.flights import observation_of_lane
from lunarsim_envs.sites.sparse_batch import SparseDescentBatch, without_site_decisions
from tests.envs.site_scene import SMALL, lanes
from tests.reference.descent import normal
from tests.reference.site_flight import SiteFlight

_DRIFT = 0xA0761D6478BD642F


def on(many, sites=None, time_scales=None):
    """Fly all lanes to their next decisions."""
    goal = np.full((many.count, 3), np.nan) if sites is None else sites
    many.decide(goal, np.ones(many.count, bool), time_scales)


@pytest.fixture(scope="module", params=[False, True], ids=["", "rescaled"])
def flown(request):
    """Return lanes, and of each its decisions with where it stood, and when it scanned.

    Sites are drawn, and time_scales too or none.
    """
    high = SMALL.changed(tasking={"flash": {"altitudes_m": [180.0, 110.0]}})
    told, scans = [[] for _ in range(4)], [[] for _ in range(4)]

    class Noted(SiteDescentBatch):
        def scan(self, due):
            super().scan(due)
            for i in np.flatnonzero(due):
                scans[i].append((self.time[i], self.guidance.site[i, 2]))

    many = lanes(4, kind=Noted, scenario=high)
    rng, drawn = np.random.default_rng(3), np.random.default_rng(4)
    while (many.ended == FLYING).any():
        goal, time_scales = np.full((4, 3), np.nan), np.full(4, np.nan)
        for i in range(4):
            if many.ended[i] != FLYING:
                continue
            n = many.candidates.number[i]
            good = np.flatnonzero(np.isfinite(many.candidates.propellant[i, :n]))
            if len(good) and rng.random() < 0.4:
                goal[i] = many.candidates.position[i, rng.choice(good)]
            if request.param and drawn.random() < 0.6:
                time_scales[i] = drawn.uniform(0.7, 1.4)
            told[i].append([many.time[i], many.y[i].copy(), goal[i].copy(), time_scales[i]])
        flying = np.flatnonzero(many.ended == FLYING)
        on(many, goal, time_scales)
        for i in flying:
            told[i][-1].append(many.time_scale_refused[i])
    if request.param:
        every = [one for lane in told for one in lane]
        asked = sum(np.isfinite(time_scale) for *_, time_scale, _ in every)
        refused = sum(time_scale_refused for *_, time_scale_refused in every)
        assert asked > 10 and 2 < refused < asked - 5
    return many, told, scans


@pytest.mark.parametrize("lane", range(4))
def test_flights_are_those_of_the_computers_laws(flown, lane):
    many, told, scans = flown
    fresh = lanes(4, scenario=SMALL.changed(decisions={"first_altitude_m": 1e4}))
    # With a window that high the first decision is due before anything has moved.
    assert fresh.time[lane] == 0.0
    craft = many.craft
    plain = SiteFlight(
        fresh.y[lane].copy(),
        many.target[lane],
        many.guidance.drift_velocity[lane],
        SMALL,
        craft.dynamics,
    )
    plain.steered()
    assert plain.plain.y[:15] == pytest.approx(fresh.y[lane], rel=1e-12, abs=1e-12)
    first, heights = True, list(scans[lane])
    assert len(heights) == 2

    def fly_on(until):
        while plain.time < until - 1e-6:
            if heights and plain.time > heights[0][0] - 1e-6:
                plain.site[2] = heights.pop(0)[1]
            for _ in plain.cycle(many.law.cycle_steps):
                pass
        if heights and plain.time > heights[0][0] - 1e-6:
            plain.site[2] = heights.pop(0)[1]

    for time, y, goal, time_scale, time_scale_refused in told[lane]:
        fly_on(time)
        assert plain.plain.y == pytest.approx(y, abs=1e-6, rel=1e-9)
        asked = (
            goal if np.isfinite(goal[0]) else None,
            time_scale if np.isfinite(time_scale) else None,
        )
        assert plain.decide(*asked, first) == time_scale_refused
        first = False
    fly_on(many.time[lane] - many.law.cycle_steps * craft.dynamics.step)
    assert many.ended[lane] == LANDED and plain.low
    assert np.linalg.norm(plain.plain.y[:3] - many.y[lane, :3]) < 0.3


def test_drift_is_drawn_by_the_key(flown):
    many = flown[0]
    for i in range(many.count):
        key = int(many.keys[i]) ^ _DRIFT
        wanted = [many.drift_sigma[k] * normal(key, 2 * k) for k in range(2)]
        assert many.guidance.drift_velocity[i] == pytest.approx(wanted, rel=1e-12)


def test_any_company_and_threads_give_the_same_bits():
    threads = numba.get_num_threads()
    found = []
    for count, own in ((1, 1), (4, 1), (33, threads)):
        numba.set_num_threads(own)
        some = lanes(count)
        for _ in range(3):
            on(some)
        found.append((some.y[0].copy(), some.candidates.position[0].copy(), some.maps.p[0].copy()))
    numba.set_num_threads(threads)
    for other in found[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(found[0], other, strict=True))


def test_what_sites_cost_is_what_the_computer_says():
    many = lanes(1)
    on(many)
    approach, guidance = SMALL.approach.make(), SMALL.guidance.make()
    lander = many.craft.dynamics.lander
    rng = np.random.default_rng(2)
    sites = many.target[0] + np.column_stack((rng.uniform(-900, 900, (200, 2)), np.zeros(200)))
    state, out = np.empty((2, 3)), np.empty((200, 4))
    f.estimate_state(many.y[0], many.guidance.drift_velocity[0], many.time[0], state)
    f.compute_divert_costs(state, many.y[0, 13], sites, many.law, out)
    e = Estimate(0.0, state[0], state[1], np.zeros(4), np.zeros(3), many.y[0, 13], np.zeros((9, 9)))
    cost = guidance.cost(e, approach.end(sites, lander), lander, 1.622, approach.limits)
    assert 20 < cost.feasible.sum() < 190
    assert np.array_equal(np.isfinite(out[:, 0]), cost.feasible)
    good = cost.feasible
    assert out[good, 0] == pytest.approx(cost.propellant[good], rel=1e-9)
    assert out[good, 1] == pytest.approx(cost.time_to_go[good], rel=1e-9)


def test_what_a_given_time_breaks_is_what_the_computer_says():
    """Also of tanks that are nearly dry, and of a lander at its end already."""
    many = lanes(1)
    approach, guidance = SMALL.approach.make(), SMALL.guidance.make()
    lander = many.craft.dynamics.lander
    rng = np.random.default_rng(7)
    told = []
    for mass in (lander.wet_mass, lander.dry_mass + approach.reserve + 25.0):
        state = np.array([[-150.0, 20.0, 160.0], [14.0, -2.0, -10.0]])
        sites = np.column_stack((rng.uniform(-200, 200, (150, 2)), np.zeros(150)))
        times = rng.uniform(5.0, 60.0, 150)
        # The last is half a second off, at the speed that is wanted there.
        for own, site, time in (
            (state, sites, times),
            (np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -2.0]]),
             -approach.end(np.zeros((1, 3)), lander).position - [0.0, 0.0, 1.0], np.array([0.5])),
        ):  # fmt: skip
            e = Estimate(0.0, *own, np.zeros(4), np.zeros(3), mass, np.zeros((9, 9)))
            end = approach.end(site, lander)
            cost = guidance.cost(e, end, lander, 1.622, approach.limits, time)
            mine = [
                f.is_feasible(own, mass, *one, many.law) for one in zip(site, time, strict=True)
            ]
            assert np.array_equal(mine, cost.feasible)
            told.append(cost.feasible.mean())
    assert told[1] == told[3] == 0.0
    assert 0.03 < told[2] < told[0] - 0.03 < 0.9


# --- maps -----------------------------------------------------------------------------------


def scanned(perception):
    """Return a lane just before its first scan and after it, and what the scan was drawn from."""
    before = lanes(1, scenario=SMALL.changed(decisions={"first_altitude_m": 1e4}))
    many = lanes(1, perception=perception)
    kept = {}
    scan = many.scan

    def noted(due):
        if not kept:
            kept.update(y=many.y[0].copy(), time=many.time[0], site=many.guidance.site[0].copy())
            kept["slip"] = many.guidance.drift_velocity[0].copy()
        scan(due)
        kept.setdefault("p", many.maps.p[0].copy())
        kept.setdefault("seen", many.maps.seen[0].copy())
        kept.setdefault("height", many.maps.height[0].copy())

    many.scan = noted
    while not kept:
        on(many)
    assert before.time[0] == 0.0
    return many, SimpleNamespace(**kept)


@pytest.mark.parametrize("perception", ["truth", "surrogate"])
def test_a_map_is_what_numpy_draws(perception):
    many, kept = scanned(perception)
    maps, layers = many.maps, many.pool.layers
    rows, cols = kept.p.shape
    grid = Grid(*map(float, maps.corner[0]), maps.posting, rows, cols)
    drift = kept.slip * kept.time
    xy = grid.centres() - drift
    truth = Grid(*map(float, layers.frame), *layers.hazard_class.shape[1:])
    world = int(many.world[0])
    row, col = truth.cell(xy)
    inside = truth.contains(xy)
    row, col = np.clip(row, 0, truth.rows - 1), np.clip(col, 0, truth.cols - 1)
    kind, height = layers.hazard_class[world][row, col], layers.height[world][row, col]
    way = kept.site - kept.y[:3] - np.array([*drift, 0.0])
    seen = in_view(xy, height.astype(float), kept.y[:3], way, many.view) & inside & (kind != 255)
    assert np.array_equal(seen, kept.seen)
    assert 0.05 < seen.mean() < 1.0
    assert np.array_equal(kept.height[seen], height[seen])
    if perception == "truth":
        wanted = layers.safe[world][row, col].astype(np.float32)
    else:
        e = many.errors
        key, first = m.map_stream(many.keys[0], many.flight_counts[0])
        places, draw, axes = np.empty((2, 5), np.int64), np.empty(3), np.empty((3, 3))
        course = f.GuidanceState(*many.guidance[:5], np.zeros(1, np.int64), *many.guidance[6:])
        m.sample_scan(0, key, first, kept.y, kept.time, world, course, e, places, draw, axes)
        field = e.noise[e.terrain_index[world], 0, places[0, 0]]
        side = field.shape[0]
        r = (places[0, 1] + places[0, 3] * np.arange(rows)) % side
        c = (places[0, 2] + places[0, 4] * np.arange(cols)) % side
        z = draw[0] + draw[1] * field[np.ix_(r, c)].astype(float)
        steps = np.linspace(-e.max_score, e.max_score, e.tables.shape[3])
        wanted = np.zeros((rows, cols))
        for one in np.unique(kind[seen]):
            own = kind == one
            wanted[own] = np.interp(z[own], steps, e.tables[world, 0, one])
        assert draw[1] == pytest.approx(np.sqrt(0.7))
        assert wanted[seen].std() > 0.1
    assert kept.p[seen] == pytest.approx(wanted[seen], abs=1e-6)
    assert not kept.p[~seen].any()


def test_a_spread_map_is_that_of_the_computer():
    rng = np.random.default_rng(4)
    p = rng.random((60, 50)).astype(np.float32)
    seen = rng.random(p.shape) < 0.9
    p[~seen] = 0.0
    held = HazardMap(Grid(0.0, 0.0, 0.4, 60, 50), p, seen)
    for miss in (0.1, 0.3, 0.9, 3.0, 12.0):
        out, line = np.empty_like(p), np.full(300, np.nan, np.float32)
        choice.average_map(p, seen, miss / 0.4, out, line, np.empty(200, np.float32))
        assert out == pytest.approx(held.dispersed_p_safe(miss), abs=2e-6)


def test_sites_are_those_that_the_computer_proposes():
    many = lanes(3)
    for _ in range(4):
        on(many)
    decisions = many.decisions
    lander, approach = many.craft.dynamics.lander, SMALL.approach.make()
    for lane in range(3):
        seen = observation_of_lane(many, lane)
        miss = seen.expected_miss
        assert miss > decisions.touchdown_sigma

        def cost_of(sites, seen=seen):
            return SMALL.guidance.make().cost(
                seen.estimate, approach.end(sites, lander), lander, 1.622, approach.limits
            )

        def miss_of(left, seen=seen, lane=lane):
            until = np.where(np.isfinite(left), left, seen.time_to_go)
            since = seen.time - many.maps.map_time[lane]
            drift = many.maps.miss_params[1] * (since + until + many.maps.miss_params[2])
            return np.hypot(decisions.touchdown_sigma, drift)

        plain = candidate_sites(
            seen.hazard_map, many.maps.averaged[lane].copy(), seen.site, cost_of,
            count=decisions.candidates, separation=decisions.separation, miss_of=miss_of,
        )  # fmt: skip
        assert len(plain) == len(seen.candidates) > 10
        mine = {tuple(np.round(one, 6)) for one in seen.candidates.position}
        assert len(mine & {tuple(np.round(one, 6)) for one in plain.position}) >= len(plain) - 1
        assert np.sort(seen.candidates.p_safe) == pytest.approx(np.sort(plain.p_safe), abs=1e-3)
        assert (np.diff(seen.candidates.p_safe) <= 0.0).all()
        assert np.isfinite(plain.propellant).sum() == seen.candidates.reachable.sum()


def test_a_lattice_receives_the_values_of_maps():
    """The sparse choice sees the cells of the dense map: its site is one of them, told alike."""
    dense = lanes(6)
    # A map of as many cells as the lattice spans, so that both number them alike.
    once = SMALL.changed(
        tasking={"flash": {"altitudes_m": [180.0]}}, mappers={"dem": {"size_m": 48.4}}
    )
    sparse = lanes(6, kind=SparseDescentBatch, scenario=without_site_decisions(once))
    assert (sparse.ended == LANDED).all()
    moved = compared = 0
    for i in range(6):
        # The dense lane's first map, before its second scan.
        one = lanes(i + 1, scenario=once)
        while one.guidance.scan_count[i] < 1:
            on(one)
        cell = m.map_cell(i, *sparse.guidance.site[i, :2], one.maps)
        r, c = cell
        moved += not np.allclose(sparse.guidance.site[i, :2], sparse.target[i, :2])
        last = one.maps.p.shape[1] - 1
        if not (0 < r < last and 0 < c < last):
            # The dense map ends here; the lattice sees the ground beyond as well.
            continue
        compared += 1
        near = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
        p = np.mean([one.maps.p[i, r + a, c + b] for a, b in near])
        assert sparse.site_p_safe[i] == pytest.approx(p, abs=1e-5)
    assert moved >= 2 and compared >= 3 and dense.count == 6
