from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.divert_cost import divert_cost
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.candidates import (
    SAFETY_LEVELS,
    candidate_sites,
    proposed_cells,
)
from tests.reference.candidates import best_cells, nearest_cell

G = 1.622

LANDER = Lander()


def estimate(position=(-300.0, 0.0, 300.0), velocity=(20.0, 0.0, -15.0), mass=1480.0) -> Estimate:
    return Estimate(
        0.0, np.array(position), np.array(velocity), np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


def test_unobserved_cells_are_not_proposed():
    aim = np.full((9, 9), np.nan, np.float32)
    aim[4, 4], aim[0, 8], aim[7, 0] = 0.5, 0.0, 0.2
    cells, rules = proposed_cells(aim, Grid.centred((0.0, 0.0), 9.0, 1.0), np.zeros(3), 5, 2.0)
    assert cells.tolist() == [[4, 4], [7, 0]]
    assert rules == ["safest", "safest"]  # the nearest cell at 0.5 is already one of them


@pytest.mark.parametrize(("rows", "cols"), [(40, 61), (30, 9), (17, 16), (9, 33)])
@pytest.mark.parametrize("separation", [0.3, 2.0, 3.7])
def test_proposed_cells_are_those_of_the_reference(rows, cols, separation):
    rng = np.random.default_rng(rows + cols)
    aim = rng.random((rows, cols)).astype(np.float32)
    aim[rng.random(aim.shape) < 0.3] = 0.0
    aim[: rows // 2] *= np.float32(1e-4)
    aim[-1, -1] = 0.95  # exactly a level, rounded
    grid, site = Grid(-3.0, 2.0, 0.4, rows, cols), np.array([1.3, 4.1, 0.0])
    distance = np.hypot(grid.x[None, :] - site[0], grid.y[:, None] - site[1])
    cells, rules = proposed_cells(aim, grid, site, 16, separation)
    safest = best_cells(aim, distance, 0.4, 16, separation)
    assert np.array_equal(cells[: len(safest)], safest)
    assert rules[: len(safest)] == ["safest"] * len(safest)
    own = {rule: tuple(cell) for cell, rule in zip(cells, rules, strict=True) if rule != "safest"}
    known = {tuple(cell) for cell in safest}
    for level in SAFETY_LEVELS:
        nearest = nearest_cell(aim, distance, level)
        if nearest is not None and nearest not in known:
            assert own.pop(f"nearest at {level}") == nearest
            known.add(nearest)
    assert not own
    values = aim[safest[:, 0], safest[:, 1]]
    assert values[0] == pytest.approx(aim.max(), rel=1e-3)


def test_uncertain_maps_propose_the_cells_of_certain_ones():
    rng = np.random.default_rng(2)
    aim, grid = rng.random((60, 60)).astype(np.float32), Grid.centred((0.0, 0.0), 30.0, 0.5)
    site = np.array([4.0, -7.0, 0.0])
    sure, _ = proposed_cells(aim, grid, site, 10, 3.0)
    weak, _ = proposed_cells(aim * np.float32(2.0**-12), grid, site, 10, 3.0)
    assert np.array_equal(weak, sure[:10])
    # Of equally safe cells, the nearest one is proposed.
    alike, _ = proposed_cells(np.full((60, 60), 2.0**-12, np.float32), grid, site, 1, 3.0)
    distance = np.hypot(grid.x[None, :] - site[0], grid.y[:, None] - site[1])
    assert distance[tuple(alike[0])] == pytest.approx(distance.min(), abs=0.01)


def test_candidates_hold_the_nearest_safe_cell():
    grid = Grid.centred((0.0, 0.0), 60.0, 1.0)
    p = np.zeros(grid.shape, np.float32)
    p[5, 5:50] = 1.0
    p[32, 30] = 0.96
    hazard_map = HazardMap(grid, p, np.ones(grid.shape, bool), np.zeros(grid.shape, np.float32))
    asked = []

    def cost_of(sites):
        asked.append(sites)
        return divert_cost(estimate(), Approach().end(sites, LANDER), LANDER, G)

    c = candidate_sites(hazard_map, p, np.zeros(3), cost_of, count=4, separation=3.0)
    assert (np.diff(c.p_safe) <= 0.0).all()
    row, col = grid.cell(c.position[:, :2])
    assert (32, 30) in set(zip(row.tolist(), col.tolist(), strict=True))
    assert np.allclose(c.distance, np.hypot(c.position[:, 0], c.position[:, 1]))
    empty = HazardMap.unobserved(grid)
    assert len(asked[0]) == len(c)
    assert np.array_equal(c.propellant, cost_of(c.position).propellant)
    assert c.reachable.all()
    nothing = candidate_sites(empty, empty.p_safe, np.zeros(3), cost_of, count=4, separation=3.0)
    assert len(nothing) == 0


def test_no_candidate_lies_where_the_mission_forbids_and_each_reports_its_source():
    rng = np.random.default_rng(4)
    grid = Grid.centred((0.0, 0.0), 60.0, 1.0)
    p = rng.uniform(0.3, 1.0, grid.shape).astype(np.float32)
    eligible = rng.random(grid.shape) < 0.3
    value = rng.random(grid.shape).astype(np.float32)
    ones = np.ones(grid.shape, bool)
    hazard_map = HazardMap(grid, p, ones, eligible=eligible, value=value)
    inside = np.argwhere(eligible)[[7, 100]]
    outside = np.argwhere(~eligible)[[7]]
    cells = np.concatenate((inside, outside))
    ranked = np.column_stack((grid.centre_of(cells[:, 0], cells[:, 1]), [1.0, 2.0, 3.0]))
    board = Scoreboard(ranked, np.array([5.0, 6.0, 4.0]))

    def cost_of(sites):
        return divert_cost(estimate(), Approach().end(sites, LANDER), LANDER, G)

    site = np.array([3.0, 4.0, 0.5])
    c = candidate_sites(
        hazard_map, p, site, cost_of, count=6, separation=3.0, mapper="dem", scoreboard=board
    )
    row, col = grid.cell(c.position[:, :2])
    assert eligible[row, col].all()
    assert np.array_equal(c.value, value[row, col].astype(float))
    assert np.array_equal(c.p_safe, p[row, col].astype(float))
    assert set(c.source) <= {"dem: safest", "dem: ranked"} | {
        f"dem: nearest at {level}" for level in (0.99, 0.95, 0.8, 0.5)
    }
    assert c.source.count("dem: safest") == 6
    safest = [float(v) for v, s in zip(c.p_safe, c.source, strict=True) if s == "dem: safest"]
    assert max(safest) == p[eligible].max()
    for i, source in enumerate(c.source):
        level = float(source.rpartition(" ")[2]) if "nearest" in source else None
        if level is not None:
            good = eligible & (p >= np.float32(level))
            far = np.hypot(grid.x[None, :] - 3.0, grid.y[:, None] - 4.0)
            assert c.distance[i] == pytest.approx(far[good].min())
    # Ranked sites keep place, height and score; the one that is not eligible is left out.
    mine = [i for i, s in enumerate(c.source) if s == "dem: ranked"]
    assert sorted(c.score[mine]) == [5.0, 6.0]
    for i in mine:
        assert np.array_equal(c.position[i], ranked[int(c.score[i]) - 5])
    others = [i for i in range(len(c)) if i not in mine]
    assert np.isnan(c.score[others]).all()


def test_a_site_that_takes_longer_to_reach_is_missed_by_more():
    """Each candidate's p is that of the map spread by its own miss."""
    rng = np.random.default_rng(9)
    grid = Grid.centred((0.0, 0.0), 80.0, 1.0)
    p = rng.uniform(0.0, 1.0, grid.shape).astype(np.float32)
    seen = rng.random(grid.shape) < 0.9
    hazard_map = HazardMap(grid, np.where(seen, p, np.float32(0.0)), seen)
    rate = 0.08

    def cost_of(sites):
        return divert_cost(estimate(), Approach().end(sites, LANDER), LANDER, G)

    found = candidate_sites(
        hazard_map, hazard_map.dispersed_p_safe(1.0), np.zeros(3), cost_of,
        count=12, separation=3.0, miss_of=lambda seconds: rate * seconds,
    )  # fmt: skip
    miss = rate * cost_of(found.position).time_to_go
    assert np.ptp(miss) > 0.1
    row, col = grid.cell(found.position[:, :2])
    plain = [hazard_map.dispersed_p_safe(s)[r, c] for s, r, c in zip(miss, row, col, strict=True)]
    assert found.p_safe == pytest.approx(plain, abs=1e-6)
    assert np.ptp(found.propellant) > 0.1
    assert np.array_equal(found.propellant, cost_of(found.position).propellant)
    assert (np.diff(found.p_safe) <= 0.0).all()
