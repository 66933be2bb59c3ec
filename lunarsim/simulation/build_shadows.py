"""From a scenario's tables to navigation and mapping by camera."""

from __future__ import annotations

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.shadows import (
    HazardPrior,
    ProbabilityMap,
    RockTracker,
    ShadowMapper,
    TrackerSettings,
)
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.rng import Streams
from lunarsim.rocks.field import RockModel
from lunarsim.scenario import Scenario
from lunarsim.simulation import build
from lunarsim.simulation.build_inertial import started
from lunarsim.vehicle import State


def shadow_mapper_of(
    scenario: Scenario, lander: Lander, centre: np.ndarray, rocks: RockFilter
) -> ShadowMapper:
    """Return the mapper that sees rocks by their shadows, its grid centred on the target.

    Raises
    ------
    InputError
        If the Sun is too low or too high for shadows, or the map too small or too coarse.
    """
    s = scenario.mapper
    grid = build.map_grid(scenario, lander, centre)
    light = build.light_of(scenario)
    shapes = RockModel(
        s.expected_shape,
        scenario.rocks.height_ratio,
        scenario.rocks.burial if s.expected_shape != "hemisphere" else (0.0, 0.0),
        scenario.rocks.axis_ratio,
    )
    model = ShadowModel(light.elevation, shapes)
    west, east, south, north = grid.extent
    margin = 3.0
    tracker = RockTracker(
        rocks,
        model,
        settings=TrackerSettings(
            least_radius=0.42 * s.hazard_diameter_m,
            region=(west - margin, east + margin, south - margin, north + margin),
        ),
    )
    probability = ProbabilityMap(
        grid, model, HazardPrior(s.expected_cover, s.hazard_diameter_m), ground=rocks.ground
    )
    reach = lander.leg_radius + 0.5 * lander.pad_diameter
    return ShadowMapper(tracker, probability, light.direction, reach, refresh=s.refresh_s)


def navigation_of(scenario: Scenario, state: State, ground: float, streams: Streams) -> RockFilter:
    """Return navigation by instruments, started with errors of the scenario's budget.

    `ground` is the elevation of the site in the true frame; the filter's ground is as far off as
    its first height, so that both stay in the estimated frame.
    """
    inertial, errors, offset = started(scenario, state, streams)
    return RockFilter(inertial, errors, ground=ground + offset[2])
