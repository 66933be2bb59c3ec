"""Terrain under a path: a majorant lies above it, planes about the path do better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.optimal.cone_program import FallbackSolver
from lunarsim.optimal.errors import InfeasibleError, SolverError
from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.terrain_constraint import TerrainRaster, minimize_propellant_over_terrain
from tests.optimal.cases import moon

GRID = Grid.centred((0.0, 0.0), 1500.0, 10.0)


def hill(height: float, west: float, width: float) -> TerrainRaster:
    east, north = np.meshgrid(GRID.x, GRID.y)
    gap = (east + west) ** 2 + north**2
    return TerrainRaster(GRID, height * np.exp(-0.5 * gap / width**2))


def test_the_majorant_lies_above_all_terrain_and_touches_in_every_sector():
    rng = np.random.default_rng(1)
    terrain = TerrainRaster(GRID, rng.normal(0.0, 20.0, GRID.shape))
    end = np.array([3.0, -4.0, 5.0])
    cone = terrain.majorant(end, 12, clearance=2.0)
    lift = np.array([0.0, 0.0, 2.0])
    above = (terrain.posts + lift - end) @ cone.normals.T
    assert above.min(axis=1).max() < 1e-9, "each post lies under one plane at least"
    steep = np.hypot(cone.normals[:, 0], cone.normals[:, 1])
    for plane in np.flatnonzero(steep > 0.0):
        assert np.abs(above[:, plane]).min() < 1e-9, "and each plane that rises touches one"
    flat = TerrainRaster(GRID, np.zeros(GRID.shape)).majorant(end)
    assert np.allclose(flat.normals, [0.0, 0.0, 1.0]), "what lies below asks for nothing"


def test_heights_are_bilinear_and_missing_off_the_posts():
    east, north = np.meshgrid(GRID.x, GRID.y)
    terrain = TerrainRaster(GRID, 0.1 * east - 0.2 * north + 1e-3 * east * north)
    at = np.random.default_rng(2).uniform(-740.0, 740.0, (50, 2))
    wanted = 0.1 * at[:, 0] - 0.2 * at[:, 1] + 1e-3 * at[:, 0] * at[:, 1]
    assert np.allclose(terrain.height(at), wanted)
    assert np.isnan(terrain.height([[800.0, 0.0]])[0])


def test_a_path_within_the_majorant_keeps_above_the_terrain_between_its_nodes():
    """A knoll 60 m before the site: the path over flat ground goes through it."""
    terrain, planner = hill(60.0, 60.0, 20.0), Planner(30)
    free = minimize_propellant(planner, moon())
    assert terrain.above(free) < 0.0
    cone = terrain.majorant(moon().end_position, 16, 1.0)
    kept = minimize_propellant(planner, replace(moon(), cone=cone))
    assert terrain.above(kept) > 0.9
    assert kept.delta_v > free.delta_v
    assert kept.half_space_multipliers.max() > 1e-3


def test_planes_about_the_path_undercut_a_majorant_that_blocks_the_way():
    """Posts beside the site make a wall of the knoll's foot; planes about the path lead over it."""
    fine = Grid.centred((0.0, 0.0), 1400.0, 5.0)
    east, north = np.meshgrid(fine.x, fine.y)
    knoll = 60.0 * np.exp(-0.5 * ((east + 60.0) ** 2 + north**2) / 20.0**2)
    terrain, planner = TerrainRaster(fine, knoll), Planner(24)
    kept = minimize_propellant(
        planner, replace(moon(), cone=terrain.majorant(moon().end_position, 12, 1.0))
    )
    found = minimize_propellant_over_terrain(planner, moon(), terrain, clearance=1.0, rounds=4)
    assert terrain.above(found) > 1.0 - 2e-3
    free = minimize_propellant(planner, moon())
    assert terrain.above(free) < 0.0
    assert free.delta_v * (1.0 - 1e-4) <= found.delta_v < kept.delta_v - 1.0


def test_a_wall_about_the_site_is_passed_by_the_short_way():
    """A site 100 m down a pit: a majorant leaves but the way straight down, and hovers for minutes.

    Planes about that path lead to more than 120 kg where the way over flat ground takes 34.
    """
    grid = Grid.centred((0.0, 0.0), 2400.0, 20.0)
    east, up = np.meshgrid(grid.x, grid.y)
    pit = TerrainRaster(grid, np.where(np.hypot(east, up) < 60.0, -100.0, 0.0))
    descent = moon(
        position=np.array([-600.0, 0.0, 400.0]), end_position=np.array([0.0, 0.0, -97.0]),
        glideslope=None,
    )  # fmt: skip
    planner = Planner(24)
    found = minimize_propellant_over_terrain(planner, descent, pit, clearance=1.0)
    assert pit.above(found) > 1.0 - 2e-3
    assert found.propellant < 1.2 * minimize_propellant(planner, descent).propellant


class Fails(FallbackSolver):
    """A solver that gives up from one program on."""

    at, met = 0, 0

    def solve(self, program):
        answer = super().solve(program)
        Fails.met += 1
        return replace(answer, status="failed") if Fails.met >= Fails.at else answer


@pytest.mark.parametrize("later", [1, 12])
def test_a_solver_that_gives_up_over_terrain_leaves_the_path_found_before(later):
    """Wherever it fails after that: what was found over the majorant is a path."""
    knoll = hill(60.0, 60.0, 20.0)
    planner = Planner(20)
    cone = knoll.majorant(moon().end_position, 12, 1.0)
    kept = minimize_propellant(planner, replace(moon(), cone=cone))
    Fails.met, Fails.at = 0, planner.solves + later
    path = minimize_propellant_over_terrain(Planner(20, Fails), moon(), knoll, clearance=1.0)
    assert path.delta_v <= kept.delta_v


def test_where_no_terrain_rises_nothing_changes():
    planner = Planner(30)
    over = minimize_propellant_over_terrain(
        planner, moon(), TerrainRaster(GRID, np.zeros(GRID.shape))
    )
    assert over.delta_v == pytest.approx(minimize_propellant(planner, moon()).delta_v, rel=1e-4)


def test_bad_terrain_is_refused():
    with pytest.raises(InputError, match="elevation"):
        TerrainRaster(GRID, np.zeros((3, 3)))
    holed = np.zeros(GRID.shape)
    holed[3, 4] = np.nan
    with pytest.raises(InputError, match="infinite values is 1"):
        TerrainRaster(GRID, holed)
    with pytest.raises(InputError, match="end_position"):
        minimize_propellant_over_terrain(
            Planner(20), moon(), TerrainRaster(GRID, np.full(GRID.shape, 20.0))
        )
    small = Grid.centred((0.0, 0.0), 100.0, 5.0)
    with pytest.raises(InputError, match="terrain"):
        TerrainRaster(small, np.zeros(small.shape)).above(minimize_propellant(Planner(20), moon()))


def test_no_way_at_all_is_infeasible_not_a_failure():
    with pytest.raises(InfeasibleError):
        flat = TerrainRaster(GRID, np.zeros(GRID.shape))
        minimize_propellant_over_terrain(Planner(10), moon(dry_mass=1495.0), flat)


def test_a_start_under_the_terrain_is_refused():
    grid = Grid.centred((0.0, 0.0), 2000.0, 20.0)
    east, north = np.meshgrid(grid.x, grid.y)
    hill = TerrainRaster(grid, 200.0 * np.exp(-((east + 600.0) ** 2 + north**2) / (2.0 * 150.0**2)))
    low = moon(position=np.array([-600.0, 0.0, 150.0]), velocity=np.array([28.0, 0.0, 5.0]))
    with pytest.raises(InputError, match=r"optimal\.position"):
        minimize_propellant_over_terrain(Planner(20), low, hill, clearance=1.0)


def test_a_path_off_the_posts_is_refused():
    small = Grid.centred((0.0, 0.0), 100.0, 5.0)
    with pytest.raises(InputError, match="must lie within the terrain"):
        minimize_propellant_over_terrain(
            Planner(20), moon(), TerrainRaster(small, np.zeros(small.shape))
        )


@pytest.mark.parametrize("sectors", [0, 1, 2, 2.5, "a", None])
def test_sectors_too_wide_for_a_plane_are_refused(sectors):
    flat = TerrainRaster(grid := Grid.centred((0.0, 0.0), 1500.0, 50.0), np.zeros(grid.shape))
    with pytest.raises(InputError, match=r"optimal\.sectors"):
        flat.majorant(moon().end_position, sectors)


@pytest.mark.parametrize("sectors", [3, 5])
def test_few_sectors_keep_above_the_terrain_too(sectors):
    knoll, planner = hill(60.0, 60.0, 20.0), Planner(20)
    path = minimize_propellant_over_terrain(
        planner, moon(), knoll, clearance=1.0, sectors=sectors, rounds=4
    )
    assert knoll.above(path) > 1.0 - 2e-3


def test_a_path_that_the_terrain_does_not_let_pass_is_not_returned(monkeypatch):
    monkeypatch.setattr(TerrainRaster, "above", lambda self, path: 0.5)
    with pytest.raises(SolverError, match="above the terrain"):
        minimize_propellant_over_terrain(
            Planner(16), moon(), hill(60.0, 60.0, 20.0), clearance=1.0, rounds=2
        )


def test_planes_lie_above_the_posts_about_each_piece_and_its_neighbours():
    terrain = hill(60.0, 60.0, 20.0)
    path = minimize_propellant(Planner(16), moon())
    half_spaces = terrain.half_spaces(path, 3.0)
    control = path.position[:-1] + 0.5 * path.step * path.velocity[:-1]
    for k in range(16):
        near = terrain.posts[np.hypot(*(terrain.posts[:, :2] - control[k, :2]).T) < 20.0]
        from_end = near - path.descent.end_position
        under = from_end @ half_spaces.normals[k, 1] - half_spaces.offsets[k, 1]
        assert under.max() < -3.0 + 1e-9, "each post lies the clearance under its plane"
    for of, at in ((half_spaces.normals[:, :, :], 0), (half_spaces.offsets[:, :, None], 0)):
        assert np.array_equal(of[1:, at], of[:-1, 1])
        assert np.array_equal(of[:-1, 2], of[1:, 1])


@pytest.mark.parametrize("value", [np.nan, -5.0, np.inf, "a", None])
def test_a_clearance_that_is_no_height_is_refused(value):
    flat = TerrainRaster(GRID, np.zeros(GRID.shape))
    with pytest.raises(InputError, match=r"optimal\.clearance"):
        minimize_propellant_over_terrain(Planner(8), moon(), flat, clearance=value)
    with pytest.raises(InputError, match=r"optimal\.clearance"):
        flat.majorant(moon().end_position, 12, value)


def test_what_is_no_terrain_is_refused():
    with pytest.raises(InputError, match=r"optimal\.terrain"):
        minimize_propellant_over_terrain(Planner(8), moon(), None)
    with pytest.raises(InputError, match=r"optimal\.grid"):
        TerrainRaster(None, np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"optimal\.elevation"):
        TerrainRaster(GRID, np.full(GRID.shape, "a"))
    flat = TerrainRaster(GRID, np.zeros(GRID.shape))
    with pytest.raises(InputError, match=r"optimal\.end_position"):
        flat.majorant([np.nan, 0.0, 0.0])
    for rounds in (0, -1, 2.5):
        with pytest.raises(InputError, match=r"optimal\.rounds"):
            minimize_propellant_over_terrain(Planner(8), moon(), flat, rounds=rounds)
