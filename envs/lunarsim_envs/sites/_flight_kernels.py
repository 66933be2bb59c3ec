# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled flights to a site: guidance, cost of diverts, and the next event."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np

from lunarsim._jit import kernel
from lunarsim.core.divert import DivertParams, costs_at_times, divert_costs
from lunarsim.core.guidance import (
    COMMANDED,
    MAX_VIOLATION_S,
    VIOLATION_SLACK,
    VerticalDescentParams,
    advance_response,
    exceeds_limits,
    fallback_time,
    predict_response,
    vertical_descent_command,
)
from lunarsim.core.path_cost import power_terms
from lunarsim.onboard.control._kernels import limited_thrust_attitude
from lunarsim_envs.descent import _kernels as d

# Events that stop a lane: none, a scan, a decision.
NOTHING, SCAN, DECIDE = 0, 1, 2
APPROACH, VERTICAL = 0, 1
# State of a lane that waits while others of its block fly.
_WAITING = 9
# Random stream of the drift.
_DRIFT = np.uint64(0xA0761D6478BD642F)
_divert_costs = cast(Any, divert_costs).compiled
_costs_at_times = cast(Any, costs_at_times).compiled
_advance = cast(Any, d.advance).compiled


class GuidanceParams(NamedTuple):
    """Guidance parameters of a scenario, SI.

    `paths`: paths of the guidance law and limits. `has_feedback`, `formula`, `gains`: feedback
    formula (`core.feedback`) and its parameters. `end_offset` (3,): position of the end of the
    approach relative to the site. `vertical_start` (2,): altitude and time-to-go at which the
    vertical descent starts. `vertical`, `vertical_velocity`: parameters and nominal velocity of the
    vertical descent. `decision_window` (3,): minimum and maximum altitude of decisions, and their
    interval. `scans`: altitudes of LiDAR scans, descending. `lag`: time constant of attitude and
    thrust. `min_time_to_go`: minimum time-to-go for replanning. `com_height`: height of the centre
    of mass above the pads. `cycle_steps`: integration steps per control cycle.
    """

    paths: DivertParams
    has_feedback: bool
    formula: Any
    gains: np.ndarray
    end_offset: np.ndarray
    vertical_start: np.ndarray
    vertical: VerticalDescentParams
    vertical_velocity: float
    decision_window: np.ndarray
    scans: np.ndarray
    lag: float
    min_time_to_go: float
    max_tilt: float
    max_thrust: float
    com_height: float
    cycle_steps: int


class GuidanceState(NamedTuple):
    """Guidance state of n landers.

    `site` (n, 3): current site, local frame, m. Times, s (n,): `arrival` at the end of the
    approach, `due` of the next decision, `exceeds_since` since which commands exceed limits (NaN:
    they do not). `phase`: APPROACH or VERTICAL; `scan_count`: number of scans; `event` that stops
    the lander; `decided`: whether a decision was made. `response` (n, 7): lagged and commanded
    acceleration, and the time of the command. `path` (n, 8): start time, duration and coefficients
    of the current path. `drift_velocity` (n, 2): rate of the position error of navigation, m/s.
    """

    site: np.ndarray
    arrival: np.ndarray
    due: np.ndarray
    exceeds_since: np.ndarray
    phase: np.ndarray
    scan_count: np.ndarray
    event: np.ndarray
    decided: np.ndarray
    response: np.ndarray
    path: np.ndarray
    drift_velocity: np.ndarray


@kernel(exact=True)
def estimate_state(y, drift_velocity, time, out):
    """Compute the estimated position and velocity of a lander, into `out` (2, 3).

    They are the true state `y` (15,) plus a drift with constant `drift_velocity` (2,), m/s, since
    the start of the flight, `time` seconds ago.
    """
    for k in range(3):
        out[0, k] = y[k]
        out[1, k] = y[3 + k]
    for k in range(2):
        out[0, k] += drift_velocity[k] * time
        out[1, k] += drift_velocity[k]


@kernel()
def compute_divert_costs(state, mass, sites, law, out):
    """Compute propellant (kg) and time-to-go (s) of minimum-propellant paths to sites.

    `state` (2, 3) is the estimated position and velocity, and `sites` (m, 3) are positions, m. The
    first two columns of `out` (m, 4) get the results: inf and NaN for sites out of reach.
    """
    targets = sites + law.end_offset
    _divert_costs((0, 1), state, mass, targets, np.zeros(len(sites)), law.paths, out)


@kernel()
def is_feasible(state, mass, site, time_to_go, law):
    """Return whether the path to a site (3,) with a time-to-go (s) is feasible.

    A feasible path is within the limits of thrust, tilt, glideslope and propellant. `state` (2, 3)
    is the estimated position and velocity.
    """
    target, times, out = np.empty((1, 3)), np.empty(1), np.empty((1, 4))
    target[0], times[0] = site + law.end_offset, time_to_go
    _costs_at_times((0, 1), state, mass, target, times, law.paths, out)
    return np.isfinite(out[0, 0])


@kernel()
def optimal_time_to_go(y, drift_velocity, time, site, law):
    """Return the minimum-propellant time-to-go to a site (3,), s; NaN if out of reach.

    `y` (15,) is the true state at `time`, s; its estimate drifts with `drift_velocity` (2,), m/s.
    """
    state, out = np.empty((2, 3)), np.empty((1, 4))
    estimate_state(y, drift_velocity, time, state)
    compute_divert_costs(state, y[13], site.reshape((1, 3)), law, out)
    return out[0, 1]


@kernel(exact=True)
def _approach_command(i, time, guidance, law, command, scratch):
    """Compute the commanded thrust acceleration of the approach, into `command` (3,).

    It is the same computation as `PathGuidance.command`, and updates `guidance.response` and
    `guidance.path`. `i` is the lander; the first two rows of `scratch` (7, 3) are its estimated
    position and velocity.
    """
    powers, final = law.paths.powers, law.paths.final
    state, ahead, x, target = scratch[:2], scratch[2:4], scratch[4:6], scratch[6]
    response, path = guidance.response[i], guidance.path[i]
    advance_response(response, time, law.lag)
    time_to_go = guidance.arrival[i] - time - law.lag
    if time_to_go >= law.min_time_to_go or np.isnan(path[0]):
        predict_response(state, response, law.lag, ahead)
        for k in range(3):
            target[k] = guidance.site[i, k] + law.end_offset[k]
        time_to_go = max(time_to_go, law.min_time_to_go)
        power_terms(ahead, target, final, time_to_go, powers, x)
        path[0], path[1] = time, time_to_go
        for k in range(3):
            path[2 + k] = (powers[0] + 1.0) * x[0, k]
            path[5 + k] = (powers[1] + 1.0) * x[1, k]
        if law.has_feedback:
            gravity = law.vertical.gravity
            law.formula(ahead, target, final, time_to_go, gravity, law.gains, command)
            for k in range(3):
                response[COMMANDED + k] = command[k]
            command[2] += gravity
            return
    fraction = max(path[1] - (time - path[0]), 0.0) / path[1]
    low, high = fraction ** powers[0], fraction ** powers[1]
    for k in range(3):
        command[k] = final[1, k] + path[2 + k] * low + path[5 + k] * high
        response[COMMANDED + k] = command[k]
    command[2] += law.vertical.gravity


@kernel(exact=True)
def _exceeds_duration(i, command, mass, time, guidance, law):
    """Return whether commands of a lander have exceeded tilt or thrust for 0.5 s.

    `command` (3,) is the commanded thrust acceleration, m/s^2. Updates `guidance.exceeds_since`.
    """
    if not exceeds_limits(command, mass, law.max_tilt, law.max_thrust, VIOLATION_SLACK):
        guidance.exceeds_since[i] = np.nan
        return False
    if np.isnan(guidance.exceeds_since[i]):
        guidance.exceeds_since[i] = time
    if time - guidance.exceeds_since[i] < MAX_VIOLATION_S - 1e-9:
        return False
    guidance.exceeds_since[i] = np.nan
    return True


@kernel(exact=True)
def compute_command(i, y, time, guidance, law, command, scratch):
    """Compute the commanded thrust acceleration of a lander, into `command` (3,).

    `i` is the lander; the acceleration is in m/s^2. Returns whether the commands of the approach
    have exceeded limits for 0.5 s, so that a longer time-to-go is needed; false in the vertical
    descent. Updates `guidance`. `y` (15,) is the true state; `scratch` is (7, 3).
    """
    state = scratch[:2]
    drift_velocity, site = guidance.drift_velocity[i], guidance.site[i]
    estimate_state(y, drift_velocity, time, state)
    altitude = state[0, 2] - site[2] - law.com_height
    time_to_go = guidance.arrival[i] - time
    if guidance.phase[i] == APPROACH and (
        altitude <= law.vertical_start[0] or time_to_go <= law.vertical_start[1]
    ):
        guidance.phase[i] = VERTICAL
    if guidance.phase[i] == APPROACH:
        _approach_command(i, time, guidance, law, command, scratch)
        return _exceeds_duration(i, command, y[13], time, guidance, law)
    end = scratch[6]
    for k in range(3):
        end[k] = site[k]
    end[2] += law.com_height
    vertical_descent_command(state, end, law.vertical_velocity, y[13], law.vertical, command)
    return False


@kernel()
def _extend_time_to_go(i, y, time, guidance, law):
    """Delay the arrival of lander `i` if the minimum-propellant path takes longer.

    The kernel is called when the current path exceeds limits. Writes `guidance.arrival`.
    """
    longer = optimal_time_to_go(y, guidance.drift_velocity[i], time, guidance.site[i], law)
    if longer > guidance.arrival[i] - time:
        guidance.arrival[i] = time + longer


@kernel(exact=True)
def due_event(i, y, time, guidance, law):
    """Return the event that is due for lander `i` now: SCAN, DECIDE or NOTHING.

    Scans are due at the altitudes `law.scans`; decisions at intervals within the altitudes of
    `law.decision_window`.
    """
    altitude = y[2] - guidance.site[i, 2] - law.com_height
    done = guidance.scan_count[i]
    if done < len(law.scans) and altitude <= law.scans[done]:
        return SCAN
    if (
        guidance.phase[i] == APPROACH
        and law.decision_window[0] <= altitude <= law.decision_window[1]
        and time >= guidance.due[i] - 1e-9
    ):
        return DECIDE
    return NOTHING


@kernel(shared=True)
def begin(
    thread_slice, mask, keys, flight_counts, y, target, drift_sigma, control, heading, guidance, law
):
    """Initialise guidance, drift and attitude of the started flights of `mask` (n,).

    Writes `guidance`, and thrust and attitude in the states `y`. `drift_sigma` (2,) is the standard
    deviation of the drift velocity of navigation, m/s; `control` is `Vehicle.control`.
    `thread_slice` is (thread, number of threads).
    """
    command, attitude, scratch = np.empty(3), np.empty(4), np.empty((7, 3))
    for i in range(thread_slice[0], len(y), thread_slice[1]):
        if not mask[i]:
            continue
        key = np.uint64(keys[i]) ^ _DRIFT
        for k in range(2):
            guidance.drift_velocity[i, k] = drift_sigma[k] * d.normal(
                key, 4 * (flight_counts[i] - 1) + 2 * k
            )
        for k in range(3):
            guidance.site[i, k] = target[i, k]
        guidance.phase[i], guidance.scan_count[i], guidance.event[i] = APPROACH, 0, NOTHING
        guidance.decided[i] = False
        guidance.due[i] = 0.0
        guidance.exceeds_since[i] = np.nan
        for k in range(7):
            guidance.response[i, k] = 0.0
        guidance.response[i, 6] = np.nan
        guidance.path[i, 0] = np.nan
        time = optimal_time_to_go(y[i], guidance.drift_velocity[i], 0.0, guidance.site[i], law)
        distance = np.sqrt(np.sum((guidance.site[i] + law.end_offset - y[i, :3]) ** 2))
        speed = np.sqrt(np.sum(y[i, 3:6] ** 2))
        guidance.arrival[i] = time if np.isfinite(time) else fallback_time(distance, speed)
        # Start with the attitude and the thrust that guidance commands.
        if compute_command(i, y[i], 0.0, guidance, law, command, scratch):
            _extend_time_to_go(i, y[i], 0.0, guidance, law)
        y[i, 14] = limited_thrust_attitude(
            command, y[i, 13], control[0], control[1], heading, control[2], attitude
        )
        for k in range(4):
            y[i, 6 + k] = attitude[k]
        for k in range(7):
            guidance.response[i, k] = 0.0
        guidance.response[i, 6] = np.nan
        guidance.path[i, 0] = np.nan
        guidance.exceeds_since[i] = np.nan


@kernel()
def scaled_time_to_go(y, drift_velocity, time, site, factor, law):
    """Return the time-to-go to a site (3,), s, and whether `factor` was applied.

    The minimum-propellant time-to-go is multiplied by `factor` (NaN: none), which is ignored if its
    path would violate a limit.
    """
    time_to_go = optimal_time_to_go(y, drift_velocity, time, site, law)
    if np.isnan(factor) or not np.isfinite(time_to_go):
        return time_to_go, np.isnan(factor)
    state = np.empty((2, 3))
    estimate_state(y, drift_velocity, time, state)
    if is_feasible(state, y[13], site, factor * time_to_go, law):
        return factor * time_to_go, True
    return time_to_go, False


@kernel(shared=True)
def decide(
    thread_slice, mask, time, y, sites, time_factors, guidance, law, refused, factor_ignored
):
    """Apply site decisions of the landers of `mask` (n,).

    `sites` (n, 3) are new sites (NaN keeps the site) and `time_factors` (n,) factors on the
    minimum-propellant time-to-go (NaN: none). Writes the new sites and arrival times to `guidance`,
    and to `refused` and `factor_ignored` (n,) whether the site was out of reach (the site is kept
    then) and whether the factor was ignored. `thread_slice` is (thread, number of threads).
    """
    for i in range(thread_slice[0], len(y), thread_slice[1]):
        if not mask[i]:
            continue
        guidance.due[i] = time[i] + law.decision_window[2]
        guidance.event[i] = NOTHING
        first = not guidance.decided[i]
        guidance.decided[i] = True
        refused[i] = factor_ignored[i] = False
        keeps = np.isnan(sites[i, 0])
        if keeps and not first and np.isnan(time_factors[i]):
            continue
        goal = guidance.site[i] if keeps else sites[i]
        time_to_go, flown = scaled_time_to_go(
            y[i], guidance.drift_velocity[i], time[i], goal, time_factors[i], law
        )
        factor_ignored[i] = not flown
        if not np.isfinite(time_to_go):
            refused[i] = not keeps
            continue
        for k in range(3):
            guidance.site[i, k] = goal[k]
        guidance.arrival[i] = time[i] + time_to_go


@kernel(shared=True)
def fly(thread_slice, y, rate, width, dt, time_limit, vehicle, terrains, flights, guidance, law):
    """Fly all flying landers until a scan or a decision is due, or to their end.

    Updates `y`, `rate`, `flights` and `guidance`, whose `event` is what is due. Landers are flown
    in blocks of `width`; a lander whose event is due waits for its block. `dt` is the integration
    step, s. `thread_slice` is (thread, number of threads).
    """
    command, scratch = np.zeros((width, 3)), np.empty((7, 3))
    n = len(y)
    for b in range(thread_slice[0], (n + width - 1) // width, thread_slice[1]):
        low, high = b * width, min((b + 1) * width, n)
        block_vehicle = d.Vehicle(
            vehicle.params[low:high], vehicle.randomized[low:high], vehicle.inertia, vehicle.rig,
            vehicle.control, vehicle.heading, vehicle.pads, vehicle.disc, vehicle.spacing,
            vehicle.limits, vehicle.com_height, vehicle.known_inertia, vehicle.mass_deviation,
            vehicle.thrust_scale, vehicle.torque_scale,
        )  # fmt: skip
        block_flights = d.Flights(
            flights.world[low:high], flights.time[low:high], flights.ended[low:high],
            flights.failed[low:high], flights.touchdown_values[low:high],
            flights.target[low:high], flights.max_distance[low:high],
        )  # fmt: skip
        while True:
            flying = 0
            for i in range(low, high):
                if flights.ended[i] != d.FLYING:
                    continue
                if guidance.event[i] == NOTHING:
                    guidance.event[i] = due_event(i, y[i], flights.time[i], guidance, law)
                if guidance.event[i] != NOTHING:
                    flights.ended[i] = _WAITING
                    continue
                flying += 1
                time = flights.time[i]
                if compute_command(i, y[i], time, guidance, law, command[i - low], scratch):
                    _extend_time_to_go(i, y[i], time, guidance, law)
            if flying > 0:
                # Same argument types as for descents, so that no second version is compiled.
                _advance(
                    (np.int64(0), np.int64(1)), y[low:high], rate[low:high], command,
                    np.bool_(True), law.cycle_steps, dt, time_limit, width, block_vehicle, terrains,
                    block_flights,
                )  # fmt: skip
            for i in range(low, high):
                if flights.ended[i] == _WAITING:
                    flights.ended[i] = d.FLYING
            if flying == 0:
                break
