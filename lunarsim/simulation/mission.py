"""Plan the mission: target, start, and the briefing of the onboard computer.

This module is on the plant's side: it knows the truth, and adds the errors of the mission's data.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.errors import InputError
from lunarsim.frames import attitude_from_thrust, quat_from_rotation_vector, quat_multiply
from lunarsim.messages.briefing import Briefing, FlightSoftware, InitialStateEstimate
from lunarsim.models.gravity import UniformGravity
from lunarsim.models.lander import Lander
from lunarsim.onboard.component_errors import checked_command
from lunarsim.onboard.control.thrust import thrust_to_command
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.rng import RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.scenario.mission import InitialUncertainty, PlannedSite, Start
from lunarsim.simulation.reachability_error import unreachable
from lunarsim.typing import Array
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.terrain import Terrain


def draw_target(
    target: PlannedSite, terrain: Terrain, lander: Lander, streams: RandomStreams
) -> Array:
    """Sample the target of a flight within its scatter on the true terrain (3,), m.

    Raises
    ------
    InputError
        If the target may lie outside the terrain, or its elevation is unknown.
    """
    offset = streams.get("target").uniform(-1.0, 1.0, 2) * np.asarray(target.scatter)
    xy = np.asarray(target.position) + offset
    check_target_area(target, terrain, lander)
    # The mission knows the terrain elevation at its site, but not the rocks.
    elevation = float(Terrain(terrain.relief).elevation(xy))
    if not np.isfinite(elevation):
        raise InputError("target.position_m", xy.tolist(), "must be a point with known elevation")
    return np.array([xy[0], xy[1], elevation])


def check_target_area(target: PlannedSite, terrain: Terrain, lander: Lander) -> None:
    """Check that a lander at every possible target stands on the terrain.

    Raises
    ------
    InputError
        If the target may be too close to the edge of the terrain, or outside.
    """
    west, east, south, north = terrain.bounds
    margin = lander.leg_radius + lander.pad_diameter
    for i, (low, high) in enumerate(((west + margin, east - margin),
                                     (south + margin, north - margin))):  # fmt: skip
        position, scatter = target.position[i], abs(target.scatter[i])
        if 2.0 * scatter > high - low:
            raise InputError(
                f"target.scatter_m[{i}]", scatter,
                f"must be at most {0.5 * (high - low):.1f} m, so that every target is on the "
                "terrain",
            )  # fmt: skip
        if position - scatter < low or position + scatter > high:
            raise InputError(
                f"target.position_m[{i}]", position,
                f"must be between {low + scatter:.1f} and {high - scatter:.1f} m, so that the "
                "target with its scatter is on the terrain",
            )  # fmt: skip


def draw_start(
    start: Start, world: World, lander: Lander, streams: RandomStreams, site: Array
) -> State:
    """Sample the true, upright state of the lander at the start of a flight.

    `site` is the target (3,), m, from which the start position is measured.

    Raises
    ------
    InputError
        If the start lies below the terrain.
    """
    rng = streams.get("start")
    position = site + np.asarray(start.position) + start.position_sigma * rng.standard_normal(3)
    velocity = np.asarray(start.velocity) + start.velocity_sigma * rng.standard_normal(3)
    elevation, level = float(world.terrain.elevation(position[:2])), position[2]
    if not np.isfinite(elevation):
        elevation, level = world.terrain.z_range[1], float(world.height(position))
    if level - lander.com_height <= elevation:
        raise InputError(
            "start.position_m[2]",
            start.position[2],
            f"must be above {elevation - site[2] + lander.com_height:.1f} m after the random start "
            "error is added, otherwise the lander starts inside the terrain",
        )
    mass = lander.wet_mass
    up = attitude_from_thrust([0.0, 0.0, 1.0], start.heading)
    return State(position, velocity, up, np.zeros(3), mass, mass * world.gravity)


def plan_time_to_go(
    state: State, target: Array, software: FlightSoftware, lander: Lander, gravity: float
) -> float:
    """Compute the time-to-go of guidance at the planned start of a flight, s.

    `state` is the planned start, `target` is (3,), m, and `gravity` is in m/s^2. `software` has the
    settings of guidance and approach.

    Raises
    ------
    InputError
        If the target is not reachable; the error names the limiting fields.
    """
    approach: Approach = software.approach
    if software.braking is not None:
        return float(software.braking.time_to_go)
    if approach.time_to_go is not None:
        return approach.time_to_go
    here = _as_estimate(state)
    end = approach.end(target[None, :], lander)
    time_to_go = software.guidance.cost(here, end, lander, gravity, approach.limits).time_to_go[0]
    if not np.isfinite(time_to_go):
        raise unreachable(here, target, software, lander, gravity)
    return float(time_to_go)


def _as_estimate(state: State) -> Estimate:
    """Return a true state as an estimate at time 0, with zero covariance."""
    return Estimate(
        0.0,
        state.position,
        state.velocity,
        state.attitude,
        state.rate,
        state.mass,
        np.zeros((9, 9)),
    )


def trimmed_start_state(state: State, briefing: Briefing) -> State:
    """Return the start state with the attitude and thrust that guidance commands.

    `briefing` has the data that the onboard computer knows before the flight.
    """
    software, lander = briefing.software, briefing.lander
    braking = software.braking
    part = software.guidance if braking is None else braking.law_settings()
    # External software is started only for the flight.
    build = getattr(part, "start_law", part.build)
    law = build(briefing, software.control.response_time + lander.thrust_lag)
    end = (
        software.approach.end(briefing.target, lander)
        if braking is None
        else braking.end(briefing.target)
    )
    wanted = law.command(_as_estimate(state), end, 0.0, briefing.time_to_go)
    if braking is not None:
        command = braking.build_command(wanted, state.mass, lander, briefing.heading, 0.0)
    else:
        wanted = checked_command("guidance", part, wanted, 0.0)
        tilt = software.approach.max_tilt
        command = thrust_to_command(wanted, state.mass, lander, briefing.heading, tilt)
    return replace(state, attitude=command.attitude, thrust=command.thrust)


def perturbed_start_estimate(
    state: State, knowledge: InitialUncertainty, rng: np.random.Generator, scale: float = 1.0
) -> InitialStateEstimate:
    """Return the initial navigation estimate: the true start with random errors.

    `knowledge` has the stated standard deviations; the true ones are `scale` times as large.
    """
    drawn = scale * rng.standard_normal((3, 3))
    turn = quat_from_rotation_vector(knowledge.attitude * drawn[2])
    return InitialStateEstimate(
        state.position + knowledge.position * drawn[0],
        state.velocity + knowledge.velocity * drawn[1],
        quat_multiply(state.attitude, turn),
        knowledge.position,
        knowledge.velocity,
        knowledge.attitude,
        knowledge.target_elevation,
    )


def plan(scenario: Scenario, world: World, streams: RandomStreams) -> tuple[State, Briefing]:
    """Compute the true start of a flight and the data that its computer knows before.

    Raises
    ------
    InputError
        If the scenario cannot be flown.
    """
    if world.gravity != scenario.gravity_m_s2:
        # The computer uses the gravity of the scenario.
        raise InputError(
            "world.gravity", world.gravity,
            f"must equal gravity_m_s2 of the scenario ({scenario.gravity_m_s2})",
        )  # fmt: skip
    lander: Lander = scenario.vehicle.make()
    true_lander = scenario.true_lander()
    scenario.check_hover()
    start: Start = scenario.start.make()
    target = draw_target(scenario.target.make(), world.terrain, lander, streams)
    state = draw_start(start, world, lander, streams, target)
    planned = replace(
        state,
        position=target + np.asarray(start.position),
        velocity=np.asarray(start.velocity, dtype=np.float64),
    )
    software: FlightSoftware = scenario.software()
    time_to_go = plan_time_to_go(planned, target, software, lander, world.gravity)
    prior = None
    if scenario.prior_map is not None:
        middle = scenario.target.make().position
        prior = scenario.prior_map.make().build(world.terrain, middle, streams.get("prior"))
    clock = scenario.simulation.make()
    upright = Briefing(
        software=software,
        lander=lander,
        instruments={name: s.make().calibration() for name, s in scenario.sensors.items()},
        gravity=world.moon or UniformGravity(scenario.gravity_m_s2),
        target=target,
        heading=start.heading,
        start=perturbed_start_estimate(
            planned, InitialUncertainty(0.0, 0.0, 0.0), np.random.default_rng(0)
        ),
        time_to_go=time_to_go,
        sun=world.light.direction,
        rocks=scenario.expected_rocks.make(),
        prior_map=prior,
        step=clock.step,
        cycle=clock.cycle,
    )
    state = trimmed_start_state(state, upright)
    state = replace(
        state, mass=true_lander.wet_mass, thrust=true_lander.thrust_scale * state.thrust
    )
    knowledge = (
        InitialUncertainty()
        if scenario.initial_uncertainty is None
        else scenario.initial_uncertainty.make()
    )
    rng = streams.get("navigation")
    scale = scenario.truth.make().initial_error_scale
    start_estimate = perturbed_start_estimate(state, knowledge, rng, scale)
    # The elevation of the terrain at the target is known only with an error.
    known_target = target + np.array([0.0, 0.0, knowledge.target_elevation * rng.standard_normal()])
    return state, replace(upright, start=start_estimate, target=known_target)
