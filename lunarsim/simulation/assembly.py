"""From a scenario to a plant and an onboard computer that share nothing but messages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.computer import Approach, Decisions, OnboardComputer
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.navigation.estimate import Navigation
from lunarsim.onboard.navigation.fixes import FixNavigation
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.tasking import Tasking
from lunarsim.onboard.tasking.schedules import AtAltitudes, Periodic, Sweep
from lunarsim.rng import Streams
from lunarsim.scenario import Scenario
from lunarsim.sensors.altimeter import RadarAltimeter
from lunarsim.sensors.imu import Imu
from lunarsim.sensors.navigation_fix import FixInstrument
from lunarsim.simulation import build
from lunarsim.simulation.build_quadtree import (
    lidar_inertial_of,
    prior_map_of,
    quadtree_mapper_of,
)
from lunarsim.simulation.build_shadows import navigation_of, shadow_mapper_of
from lunarsim.simulation.plant import Instrument, Plant
from lunarsim.vehicle import State
from lunarsim.world import World

Array = NDArray[np.float64]


def assemble(
    scenario: Scenario,
    world: World,
    lander: Lander,
    state: State,
    target: Array,
    streams: Streams,
    before: OnboardComputer | None,
) -> tuple[Plant, OnboardComputer]:
    """Return both sides of the loop; `before` is the computer that chose the start attitude."""
    kind = scenario.mapper.kind
    instruments: dict[str, Instrument] = {}
    imu: tuple[str, Imu] | None = None
    navigation: Navigation
    if kind == "gaussian-dem":
        rng = streams.get("navigation")
        fixes = FixInstrument(build.budget_of(scenario), rng)
        instruments["navigation"] = Instrument(fixes, rng, False)
        instruments["lidar"] = Instrument(build.lidar_of(scenario), streams.get("lidar"), True)
        navigation = FixNavigation()
    else:
        imu = ("imu", Imu(streams.get("imu"), 1.0 / scenario.simulation.step_s))
        if kind == "shadow":
            instruments["altimeter"] = Instrument(RadarAltimeter(), streams.get("altimeter"), False)
            camera = build.camera_of(scenario)
            instruments["camera"] = Instrument(camera, streams.get("camera"), True)
            navigation = navigation_of(scenario, state, float(target[2]), streams)
        else:
            instruments["lidar"] = Instrument(build.lidar_of(scenario), streams.get("lidar"), True)
            prior = prior_map_of(scenario, world, streams)
            navigation = lidar_inertial_of(scenario, state, prior, streams)
    dynamics = build.dynamics_of(scenario, lander)
    plant = Plant(
        world, dynamics, state, instruments=instruments, imu=imu,
        steps=round(scenario.simulation.cycle_s / scenario.simulation.step_s),
        max_time=scenario.simulation.max_time_s,
    )  # fmt: skip
    site = target if before is None else before.site
    if before is None and kind != "quadtree":
        navigation_first = navigation
        for _, measurement in plant.sense().items:
            navigation_first.take(measurement, 0.0)
        estimate = navigation_first.estimate(0.0, state.mass)
        site = target + (estimate.position - state.position)
    mapper: HazardMapper
    if kind == "gaussian-dem":
        mapper = build.mapper_of(scenario, lander, site)
    elif kind == "shadow":
        assert isinstance(navigation, RockFilter)
        mapper = shadow_mapper_of(scenario, lander, site, navigation)
    else:
        mapper = quadtree_mapper_of(scenario, lander, site)
    sensor = "camera" if kind == "shadow" else "lidar"
    g, d = scenario.guidance, scenario.decisions
    computer = OnboardComputer(
        lander=lander,
        gravity=scenario.gravity_m_s2,
        site=site,
        navigation=navigation,
        mappers={"map": mapper},
        takes={"map": sensor},
        tasking=[_tasking_of(scenario, sensor, site)],
        approach=Approach(
            g.vertical_altitude_m, g.vertical_speed_m_s, g.arrival_acceleration_m_s2,
            g.time_to_go_s, float(np.deg2rad(scenario.start.heading_deg)),
        ),
        limits=build.limits_of(scenario),
        decisions=Decisions(
            d.first_altitude_m, d.last_altitude_m, d.interval_s, d.candidates, d.separation_m,
            d.touchdown_sigma_m,
        ),
        response_time=dynamics.response_time,
    )  # fmt: skip
    if before is None:
        for _, measurement in plant.sense().items if kind == "quadtree" else ():
            navigation.take(measurement, 0.0)
        computer._estimate = navigation.estimate(0.0, state.mass)
        computer.guidance.arrival = first_arrival(scenario, computer)
    else:
        computer.guidance.arrival = before.guidance.arrival
    return plant, computer


def first_arrival(scenario: Scenario, computer: OnboardComputer) -> float:
    """Return the time at which the site is to be reached first, s."""
    fixed = scenario.guidance.time_to_go_s
    if fixed is not None:
        return fixed
    time_to_go = float(computer.cost_of(computer.site[None, :]).time_to_go[0])
    if not np.isfinite(time_to_go):
        raise InputError(
            "start.position_m",
            scenario.start.position_m,
            "a start from which the target can be reached within thrust, tilt, glideslope and "
            "propellant: no time-to-go is admissible",
        )
    return time_to_go


def _tasking_of(scenario: Scenario, sensor: str, site: Array) -> Tasking:
    kind = scenario.mapper.kind
    if kind == "gaussian-dem":
        s = scenario.lidar
        limit = np.deg2rad(s.gimbal_limit_deg)
        return AtAltitudes(sensor, s.scan_altitudes_m, s.boresight == "site", limit)
    if kind == "shadow":
        c = scenario.camera
        limit = np.deg2rad(c.gimbal_limit_deg)
        return Periodic(sensor, c.rate_hz, c.first_altitude_m, limit)
    w = scenario.sweep
    for name in ("rate_hz", "dwell_rate_hz"):
        rate, cycle = getattr(w, name), scenario.simulation.cycle_s
        if rate * cycle > 1.0 + 1e-9:
            raise InputError(
                f"sweep.{name}", rate, f"at most {1.0 / cycle:g}, one flash a control cycle"
            )
    return Sweep(
        sensor, site, size=w.size_m, duration=w.duration_s, rate=w.rate_hz,
        dwell_rate=w.dwell_rate_hz, last_altitude=w.last_altitude_m,
        limit=np.deg2rad(scenario.lidar.gimbal_limit_deg),
    )  # fmt: skip
