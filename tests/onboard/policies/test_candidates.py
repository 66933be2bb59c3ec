from __future__ import annotations

import numpy as np

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.divert import divert_cost
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.candidates import best_cells, candidate_sites

G = 1.622

LANDER = Lander()


def estimate(position=(-300.0, 0.0, 300.0), velocity=(20.0, 0.0, -15.0), mass=1480.0) -> Estimate:
    return Estimate(
        0.0, np.array(position), np.array(velocity), np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


def test_best_cells_are_apart_and_best():
    rng = np.random.default_rng(1)
    aim = rng.random((60, 60)).astype(np.float32)
    cells = best_cells(aim, np.zeros((60, 60)), 0.5, 10, 3.0)
    gap = np.hypot(*(cells[:, None] - cells[None]).transpose(2, 0, 1)) * 0.5
    np.fill_diagonal(gap, np.inf)
    assert gap.min() >= 3.0
    values = aim[cells[:, 0], cells[:, 1]]
    assert values[0] == aim.max()
    assert (np.diff(values) <= 0.0).all()


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
    assert np.array_equal(asked[0], c.position)
    assert c.reachable.all()
    nothing = candidate_sites(empty, empty.p_safe, np.zeros(3), cost_of, count=4, separation=3.0)
    assert len(nothing) == 0
