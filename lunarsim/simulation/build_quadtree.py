"""From a scenario's tables to navigation by LiDAR on a prior map, and to the quadtree mapper."""

from __future__ import annotations

import numpy as np

from lunarsim.grid import Grid
from lunarsim.messages.prior_map import PriorMap
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.quadtree import InterestMap, QuadtreeMapper, SiteSettings
from lunarsim.onboard.navigation.lidar_inertial import LidarInertialFilter
from lunarsim.rng import Streams
from lunarsim.scenario import Scenario
from lunarsim.simulation import build
from lunarsim.simulation.build_inertial import started
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.survey import survey


def prior_map_of(scenario: Scenario, world: World, streams: Streams) -> PriorMap:
    """Return the map that the lander brings along.

    Raises
    ------
    InputError
        If its section is wrong.
    """
    s = scenario.prior
    grid = Grid.centred(scenario.target.position_m, s.size_m, s.posting_m)
    made = survey(
        world.terrain,
        grid,
        streams.get("prior"),
        sigma=s.sigma_m,
        stale_share=s.stale_share,
        stale_side=s.stale_side_m,
        stale_sigma=s.stale_sigma_m,
    )
    east, north, up = s.offset_m
    moved = Grid(grid.x0 + east, grid.y0 + north, grid.posting, grid.rows, grid.cols)
    return PriorMap(moved, made.elevation + up, made.sigma)


def lidar_inertial_of(
    scenario: Scenario, state: State, prior: PriorMap, streams: Streams
) -> LidarInertialFilter:
    """Return navigation on a map, started with errors of the scenario's budget."""
    inertial, errors, _ = started(scenario, state, streams)
    return LidarInertialFilter(inertial, errors, prior)


def settings_of(scenario: Scenario) -> SiteSettings:
    """Return tolerances, weights and sizes of cells."""
    s = scenario.sites
    return SiteSettings(
        slope_limit=np.deg2rad(s.slope_limit_deg),
        roughness_limit=s.roughness_limit_m,
        density=s.density_m2,
        exception_limit=s.exception_limit,
        zone=s.zone_m,
        weight_interest=s.weight_interest,
        weight_slope=s.weight_slope,
        weight_roughness=s.weight_roughness,
        mesh_band=s.mesh_band_m,
        hazard_band=s.hazard_band_m,
        site_band=s.site_band_m,
        count=s.count,
        separation=s.separation_m,
        roughness=s.roughness,
    )


def quadtree_mapper_of(scenario: Scenario, lander: Lander, centre: np.ndarray) -> QuadtreeMapper:
    """Return the mapper, its grid centred on the target.

    Raises
    ------
    InputError
        If the map is smaller than the lander's footprint or its posting is too coarse.
    """
    s = scenario.sites
    return QuadtreeMapper(
        build.map_grid(scenario, lander, centre),
        settings_of(scenario),
        elevation=float(centre[2]),
        least=s.least_m,
        split_count=s.split_count,
        interest=None if s.interest_path is None else InterestMap.load(s.interest_path),
        hold_sigma=s.hold_sigma_m,
        interval=scenario.sweep.update_s,
    )
